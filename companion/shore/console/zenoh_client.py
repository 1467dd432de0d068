"""The console's zenoh session: samples and liveliness tokens into a bounded queue, orders out.

Callbacks run on zenoh's threads and only append. An unreachable router is tried again for ever (a client's
session cannot even be opened without one); a session that was opened once looks after its connection itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections import deque
from pathlib import Path
from typing import NamedTuple

import zenoh
from zenoh.handlers import Callback

from companion.boat.uplink.zenoh_session import Setting, configured, join_callbacks
from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import read_outcome
from companion.shore import subscriber

QUEUE = 50_000
"""Samples that wait for the loop: half a minute of 50 boats (assumed)."""
RETRY_S = 2.0


class ZenohSample(NamedTuple):
    """A sample (`topic`), or a liveliness token that appeared or disappeared (`topic` None). `heard_ns`: our clock."""

    boat: str
    topic: str | None
    data: bytes
    there: bool
    heard_ns: int


def config_of(file: Path | None, connect: list[str], listen: list[str]) -> zenoh.Config:
    """Zenoh's configuration: its own file, or a program that scouts for nothing; endpoints given go before the file's.

    Raises ConfigError.
    """
    settings: list[Setting] = []
    if file is None:
        mode = "peer" if listen else "client"  # a peer receives nothing through a router, and a client cannot listen
        settings.append(Setting("mode", "--connect", mode))
        settings += [Setting(f"scouting/{way}/enabled", "--connect", False) for way in ("multicast", "gossip")]
    if connect or file is None:
        settings.append(Setting("connect/endpoints", "--connect", connect))
    if listen or file is None:
        settings.append(Setting("listen/endpoints", "--listen", listen))
    return configured(file, "--config", settings)


class ZenohClient:
    """Call `run` on the loop; `take` the received samples. `problem`: why there is no session; empty: connected.

    `dropped`: samples without room in the queue.
    """

    def __init__(self, config: zenoh.Config) -> None:
        self.dropped, self.problem = 0, "not connected yet"
        self._config, self._queue = config, deque[ZenohSample]()
        self._session: zenoh.Session | None = None

    def take(self) -> list[ZenohSample]:
        """Samples and tokens received since the last call."""
        return [self._queue.popleft() for _ in range(len(self._queue))]

    async def run(self) -> None:
        """Receive until cancelled."""
        before = set(threading.enumerate())
        try:
            while True:
                try:
                    self._session = await asyncio.to_thread(zenoh.open, self._config)
                    break
                except zenoh.ZError as error:
                    self.problem = f"{error}"
                    await asyncio.sleep(RETRY_S)
            subscription = self._declare(self._session)
            self.problem = ""
            await asyncio.Event().wait()
            del subscription
        finally:
            if session := self._session:
                self._session = None
                await asyncio.shield(asyncio.to_thread(session.close))
                join_callbacks(before)

    async def ask(self, boat: str, payload: bytes, attachment: bytes | None, timeout_s: float) -> bytes | None:
        """One query on a boat's command key, to all who answer there; the first reply, or None.

        "Meant for another run" counts only where there is no other answer: a program that was left over under the
        same name must not answer for the one that is meant.
        """
        session, loop = self._session, asyncio.get_running_loop()
        if session is None:
            return None
        answer: asyncio.Future[bytes | None] = loop.create_future()

        others: list[bytes] = []

        def settle(data: bytes | None) -> None:
            if data is not None and _wrong_run(data):
                others.append(data)
            elif not answer.done():
                answer.set_result(data if data is not None or not others else others[0])

        def on_loop(data: bytes | None) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(settle, data)

        def reply(answer: zenoh.Reply) -> None:
            if answer.ok:
                on_loop(bytes(answer.ok.payload))

        try:
            session.get(
                shore.command_key(boat),
                Callback(reply, lambda: on_loop(None)),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
                payload=payload,
                attachment=attachment,
                timeout=timeout_s,
            )
        except zenoh.ZError:
            return None
        with contextlib.suppress(TimeoutError):
            return await asyncio.wait_for(answer, timeout_s + 0.2)
        return None

    def _declare(self, session: zenoh.Session) -> list[object]:
        return subscriber.listen(session, self._receive, reach=self._reach)

    # --- zenoh's threads ---------------------------------------------------------------------------

    def _receive(self, sample: zenoh.Sample) -> None:
        _, boat, _, topic = str(sample.key_expr).split("/", 3)
        self._note(ZenohSample(boat, topic, bytes(sample.payload), True, time.monotonic_ns()))

    def _reach(self, boat: str, is_alive: bool) -> None:
        self._note(ZenohSample(boat, None, b"", is_alive, time.monotonic_ns()))

    def _note(self, sample: ZenohSample) -> None:
        if len(self._queue) >= QUEUE:
            self.dropped += 1
        else:
            self._queue.append(sample)


def _wrong_run(data: bytes) -> bool:
    try:
        return read_outcome(data).code == "wrong_run"
    except ValueError:
        return False
