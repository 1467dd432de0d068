"""A device link: one port, one codec, and the truth about whether anybody is there.

    port -> bytes -> codec.feed -> messages            (callbacks `on_bytes`, `on_messages`)
    searching -> online -> stale -> lost -> searching  (`drivers.link_state`, told as LinkStatus)

`DeviceLink.run` never ends by itself and never raises what the world does to it: a port that cannot be opened,
breaks or falls silent is closed and opened again, after a pause that grows from 0.1 s to 2 s. Only
messages make a link online: bytes that decode to nothing do not.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import Awaitable, Callable, Sequence
from typing import Protocol

from companion.core.messages import LinkState, LinkStatus, Message
from drivers.link_state import LinkObservations, LinkTiming, LinkVerdict, backoff_s, link_state, open_fault
from drivers.ports.port import Port

__all__ = ["Codec", "DeviceLink", "LinkTiming", "link_state"]


class Codec(Protocol):
    """Bytes in, messages out; keeps half a frame for the next call, counts garbage, never raises."""

    @property
    def understood(self) -> int:
        """How many frames or lines were sound so far, whoever they came from and whether they told anything or not."""
        ...

    def feed(self, data: bytes, t_ns: int) -> Sequence[Message]:
        """Messages that these bytes complete. `t_ns`: when they arrived, companion clock [ns]."""
        ...


class DeviceLink:
    """Joins a port and a codec; `run` it as a task.

    name         in every LinkStatus
    now_ns       companion clock [ns]
    sleep_until  waits for an instant of that clock
    rng          jitter of the backoff
    on_messages  gets decoded messages and every LinkStatus, with the clock's time [ns]
    on_bytes     gets what arrived, before it is decoded

    What a callback or the codec raises is a bug and leaves `run`, after the port was closed.
    """

    def __init__(
        self,
        name: str,
        port: Port,
        codec: Codec,
        *,
        now_ns: Callable[[], int],
        sleep_until: Callable[[int], Awaitable[None]],
        rng: random.Random,
        on_messages: Callable[[Sequence[Message], int], None],
        on_bytes: Callable[[bytes, int], None] | None = None,
        timing: LinkTiming | None = None,
    ) -> None:
        self.name = name
        self.port = port
        self.state: LinkState = "searching"
        self.refused_sends = 0
        """Sends that were dropped because the port was not open."""
        self._codec = codec
        self._now_ns = now_ns
        self._sleep_until = sleep_until
        self._rng = rng
        self._on_messages = on_messages
        self._on_bytes = on_bytes
        self._timing = timing or LinkTiming()
        self._fault = f"opening {port.name}"
        self._framed = False
        self._byte_ns = self._frame_ns = now_ns()
        self._babble_ns: int | None = None
        self._speaks = False
        self._told = ("", "")
        self._attempt = 0

    @property
    def is_open(self) -> bool:
        """The port is open: bytes may be sent, though nobody may be there."""
        return not self._fault

    def send(self, data: bytes) -> bool:
        """Hand bytes to the port without waiting. False: not open, and the bytes are gone, not queued."""
        if self.is_open:
            try:
                self.port.send(data)
            except OSError:
                pass
            else:
                return True
        self.refused_sends += 1
        return False

    async def run(self) -> None:
        """Keep the link for ever; cancelling closes the port."""
        self._judge()
        try:
            while True:
                await self._connect()
                await self._converse()
                await self._close()
                await self._pause()
        finally:
            self._fault = self._fault or "stopped"
            await self._close()

    async def _connect(self) -> None:
        """Open the port, as often as it takes."""
        while True:
            try:
                await self.port.open()
            except OSError as error:
                self._fault = open_fault(self.name, self.port.name, error)
                self._judge()
                await self._pause()
            else:
                self._fault, self._framed, self._babble_ns = "", False, None
                self._byte_ns = self._frame_ns = self._now_ns()
                self._judge()
                return

    async def _close(self) -> None:
        with contextlib.suppress(OSError):
            await self.port.close()

    async def _pause(self) -> None:
        delay_s = backoff_s(self._attempt, self._rng, self._timing)
        self._attempt += 1
        await self._sleep_until(self._now_ns() + round(delay_s * 1e9))

    async def _converse(self) -> None:
        """Until the port ends or the link is lost; afterwards the state says so."""
        tasks = [asyncio.create_task(self._listen()), asyncio.create_task(self._watch())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        for task in done:
            self._fault = task.result()
        if self.state != "lost":
            self._judge()

    async def _listen(self) -> str:
        """Receive and decode; returns why the port ended."""
        while True:
            try:
                data = await self.port.receive()
            except OSError as error:
                return f"{self.port.name} broke: {error.strerror or error}"
            if not data:
                return f"the other end of {self.port.name} is gone"
            self._take(data, self._now_ns())

    def _take(self, data: bytes, t_ns: int) -> None:
        if self._on_bytes is not None:
            self._on_bytes(data, t_ns)
        before = self._codec.understood
        messages = self._codec.feed(data, t_ns)
        speaks = self._codec.understood > before
        gap_ns, self._byte_ns = t_ns - self._byte_ns, t_ns
        if messages:
            self._frame_ns, self._framed, self._babble_ns, self._attempt = t_ns, True, None, 0
            self._judge()
            self._on_messages(messages, t_ns)
        elif self._babble_ns is None or gap_ns >= self._timing.stale_after_ns:
            self._babble_ns, self._speaks = t_ns, speaks
        else:
            self._speaks = self._speaks or speaks

    async def _watch(self) -> str:
        """Judge whenever silence may have become something else; returns why to start again."""
        while not (verdict := self._judge()).reopen:
            await self._sleep_until(self._next_judgement_ns())
        return verdict.reason

    def _next_judgement_ns(self) -> int:
        """When the state or its cause may change; after `stale_after_s` at the latest, for bytes may begin any time."""
        now_ns, timing = self._now_ns(), self._timing
        changes = [since_ns + timing.stale_after_ns for since_ns in (self._frame_ns, now_ns)]
        changes.append(self._frame_ns + timing.lost_after_ns)
        if self._babble_ns is not None:
            changes.append(self._babble_ns + timing.guess_after_ns)
        return min(t_ns for t_ns in changes if t_ns > now_ns)

    def _judge(self) -> LinkVerdict:
        """Apply `link_state` and tell about it where the state or its cause has changed."""
        t_ns = self._now_ns()
        babble_ns = 0 if self._babble_ns is None else t_ns - self._babble_ns
        silent_ns, frameless_ns = t_ns - self._byte_ns, t_ns - self._frame_ns
        seen = LinkObservations(self._fault, self._framed, silent_ns, frameless_ns, babble_ns, self._speaks)
        verdict = link_state(self.state, seen, self._timing)
        self.state = verdict.state
        if (verdict.state, verdict.cause) != self._told:
            self._told = (verdict.state, verdict.cause)
            status = LinkStatus(t_ns=t_ns, link=self.name, state=verdict.state, reason=verdict.reason)
            self._on_messages([status], t_ns)
        return verdict
