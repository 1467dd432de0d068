"""The shore's side of orders (`order_gate`): makes and signs them, and tells the boat's answers from strangers'.

Telemetry is not signed. What it says of run and clock is good enough to try a stop with at once; an answer that is
signed says it for certain.
"""

from __future__ import annotations

import hmac
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from companion.core.telemetry.order_gate import (
    LATEST_NS,
    MissionFile,
    Order,
    OrderOutcome,
    Word,
    read_outcome,
    seal,
    seal_answer,
)
from companion.core.telemetry.sticks import StickSample, seal_sticks

REMEMBERED_NS = 5_000_000_000
"""What came quickest counts for so long, and once more; then another sample does (assumed)."""


class RunClock:
    """A boat's clock minus ours [ns], by the sample with the least transit time: none arrives before it was sent.

    What was quickest is forgotten after 5 to 10 s in which others came, and with it a clock that somebody made up.
    """

    def __init__(self, t_ns: int, heard_ns: int) -> None:
        self._best = self._before = t_ns - heard_ns
        self._since_ns = heard_ns

    @property
    def ahead_ns(self) -> int:
        """Its clock minus ours."""
        return max(self._best, self._before)

    def hear(self, t_ns: int, heard_ns: int) -> None:
        """A sample with the boat's stamp, received at `heard_ns` of our clock."""
        if heard_ns - self._since_ns >= REMEMBERED_NS:
            self._before, self._best, self._since_ns = self._best, t_ns - heard_ns, heard_ns
        self._best = max(self._best, t_ns - heard_ns)


class Place(NamedTuple):
    """What an order is made out for: a run of the boat's program, and its clock at this moment."""

    run: str
    t_ns: int


NOWHERE = Place("", 0)
"""Of a boat of which nothing was heard: the order is refused, and the refusal says run and clock."""


def _instant(place: Place) -> int:
    """As an order may carry it: telemetry, which is not signed, may say anything."""
    return min(max(place.t_ns, 0), LATEST_NS)


class SealedOrder(NamedTuple):
    """An order as it is sent."""

    payload: bytes
    attachment: bytes | None


class Sender:
    """Makes orders. `key`: None where the boat has none; `local_ns`: a monotonic clock."""

    def __init__(self, boat: str, session: str, sender: str, key: bytes | None, local_ns: Callable[[], int]) -> None:
        self._boat, self._session, self._sender, self._key, self._local_ns = boat, session, sender, key, local_ns
        self._counter = 0
        self._run: str | None = None
        self._clock = RunClock(0, 0)

    def hear(self, run: str, t_ns: int) -> None:
        """Note `run` and `t_ns` of telemetry: what came quickest says what time the boat has."""
        now = self._local_ns()
        if run == self._run:
            self._clock.hear(t_ns, now)
        else:
            self._run, self._clock = run, RunClock(t_ns, now)

    def order(
        self, command: Word, mission: MissionFile | None = None, *, at: Place | None = None, heard: tuple[str, ...] = ()
    ) -> SealedOrder:
        """A new order, `at` a run and its clock, or those heard last. Raises ValueError without either."""
        if at is None:
            if self._run is None:
                raise ValueError("no telemetry heard yet: which run of the boat, and what time it has, is not known")
            at = Place(self._run, self._local_ns() + self._clock.ahead_ns)
        self._counter += 1
        order = Order(
            run=at.run,
            t_ns=_instant(at),
            session=self._session,
            counter=self._counter,
            sender=self._sender,
            command=command,
            mission=mission,
            heard=heard,
        )
        payload = msgspec.json.encode(order)
        return SealedOrder(payload, None if self._key is None else seal(self._key, self._boat, payload))

    def sticks(self, at: Place, *, held: bool, surge: float, sway: float, yaw: float) -> SealedOrder:
        """Where the sticks stood `at` a run and its clock; shares, -1 to 1. `held`: the dead man's button."""
        self._counter += 1
        sample = StickSample(
            run=at.run,
            t_ns=_instant(at),
            session=self._session,
            counter=self._counter,
            held=held,
            surge=surge,
            sway=sway,
            yaw=yaw,
        )
        payload = msgspec.json.encode(sample)
        return SealedOrder(payload, None if self._key is None else seal_sticks(self._key, self._boat, payload))

    def believe(self, order: bytes, reply: bytes, attachment: bytes | None) -> OrderOutcome | None:
        """The boat's answer to an order (its payload); None: not signed with this boat's key, or not an answer."""
        if self._key is not None:
            right = seal_answer(self._key, self._boat, order, reply)
            if not hmac.compare_digest(attachment or b"", right):
                return None
        try:
            return read_outcome(reply)
        except ValueError:
            return None
