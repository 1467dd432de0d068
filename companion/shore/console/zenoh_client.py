"""The console's zenoh session: samples and liveliness tokens into a bounded queue, orders out.

Callbacks run on zenoh's threads and only append. An unreachable router is tried again for ever (a client's
session cannot even be opened without one); a session that was opened once looks after its connection itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import NamedTuple

import zenoh
from zenoh.handlers import Callback

from companion.boat.uplink.zenoh_session import Setting, configured, join_callbacks
from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import read_outcome
from companion.core.telemetry.order_sender import SealedOrder
from companion.shore import subscriber
from companion.shore.console.answers import Believe, OrderAnswer

QUEUE = 50_000
"""Samples that wait for the loop: half a minute of 50 boats (assumed)."""
RETRY_S = 2.0
STRANGERS = 4
MAX_BYTES = 65_536
"""Longer answers are nobody's."""


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

    `dropped`: samples without room in the queue; `where`: the endpoints of `config`, in words.
    """

    def __init__(self, config: zenoh.Config) -> None:
        self.dropped, self.problem = 0, "not connected yet"
        self.where = " and ".join(
            f"{does} {', '.join(found)}"
            for key, does in (("listen", "listening on"), ("connect", "connecting to"))
            if (found := _endpoints(config, key))
        )
        self._config, self._queue = config, deque[ZenohSample]()
        self._session: zenoh.Session | None = None

    def take(self) -> Iterator[ZenohSample]:
        """Samples and tokens received since the last call, one after the other."""
        for _ in range(len(self._queue)):
            yield self._queue.popleft()

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

    def tell_sticks(self, boat: str, sample: SealedOrder) -> None:
        """Where somebody's sticks are. Never waits: on a bad network it is dropped, and the next one says more."""
        if session := self._session:
            with contextlib.suppress(zenoh.ZError):
                session.put(
                    shore.sticks_key(boat),
                    sample.payload,
                    attachment=sample.attachment,
                    encoding=zenoh.Encoding.APPLICATION_JSON,
                    congestion_control=zenoh.CongestionControl.DROP,
                    priority=zenoh.Priority.REAL_TIME,
                    express=True,
                )

    async def ask(
        self, boat: str, order: SealedOrder, timeout_s: float, believe: Believe
    ) -> AsyncIterator[OrderAnswer]:
        """One query on a boat's command key, to all who answer there: each answer as it comes, until there are no more.

        Those that are not the boat's cannot crowd it out: `STRANGERS` of them are given, to tell a person of.
        """
        session, loop = self._session, asyncio.get_running_loop()
        if session is None:
            return
        answers: asyncio.Queue[OrderAnswer | None] = asyncio.Queue()
        strangers = 0

        def on_loop(answer: OrderAnswer | None) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(answers.put_nowait, answer)

        def reply(answer: zenoh.Reply) -> None:
            nonlocal strangers
            if answer.ok is None or len(answer.ok.payload) > MAX_BYTES:
                return
            data, seal = bytes(answer.ok.payload), answer.ok.attachment
            outcome = believe(order.payload, data, None if seal is None else bytes(seal))
            if outcome is not None:
                on_loop(OrderAnswer(outcome, proven=True))
            elif strangers < STRANGERS:
                strangers += 1
                with contextlib.suppress(ValueError):
                    on_loop(OrderAnswer(read_outcome(data), proven=False))

        try:
            session.get(
                shore.command_key(boat),
                Callback(reply, lambda: on_loop(None)),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
                payload=order.payload,
                attachment=order.attachment,
                timeout=timeout_s,
            )
        except zenoh.ZError:
            return
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s + 0.2):
                while (answer := await answers.get()) is not None:
                    yield answer

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


def _endpoints(config: zenoh.Config, key: str) -> list[str]:
    """Endpoints to listen on or to connect to, in the configuration's mode."""
    found = json.loads(config.get_json(f"{key}/endpoints"))
    return found if isinstance(found, list) else found.get(json.loads(config.get_json("mode")) or "peer", [])
