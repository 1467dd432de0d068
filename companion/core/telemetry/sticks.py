"""Sticks from shore: where a person's hands are now, signed, and which of it the boat believes. Pure.

A sample is a zenoh put on `aritra/<boat>/sticks`: a `StickSample` as JSON; where the boat has a key, its attachment is

    HMAC-SHA256(key, "aritra-sticks-1" 0 boat 0 sample)

Believed is what is signed, of this run, of the session whose `manual` order the boat took last, newer than the last by
counter and by clock, and at most `FRESH_S` old **when the sticks stood so**: a sample that a bad radio held up moves
nothing. Its instant goes on to the pilot, whose dead man (`manual_control`) counts from it and not from the arrival.
Without the dead man's button (`held`) the sticks are at rest, whatever else the sample says. Nothing is answered: a
sample is worth nothing a moment later, and what the boat does is in its telemetry.
"""

from __future__ import annotations

import hmac
from typing import Annotated

import msgspec

from companion.core.messages import ManualInput
from companion.core.telemetry.order_gate import Instant, Order, OrderRefused
from companion.core.telemetry.shore_message import VERSION

MAX_BYTES = 1024
FRESH_S = 0.5
"""As the dead man's `control.manual_timeout_s` is by default (assumed)."""
AHEAD_S = 0.05
"""As much as the pilot lets pass (`manual_control.AHEAD_NS`): the sender's idea of the boat's clock may be off."""
Share = Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)]


class StickSample(msgspec.Struct, frozen=True, kw_only=True):
    """Shares of what the thrusters can give ahead, to starboard and clockwise, at `t_ns` of the boat's clock.

    `held`: the dead man's button; `session`, `counter`: as in `Order`, of one sequence with it.
    """

    v: int = VERSION
    run: str
    t_ns: Instant
    session: Annotated[str, msgspec.Meta(min_length=8, max_length=64)]
    counter: Instant
    held: bool
    surge: Share
    sway: Share
    yaw: Share


def seal_sticks(key: bytes, boat: str, payload: bytes) -> bytes:
    """Signature of a sample, 32 bytes."""
    return hmac.digest(key, b"\0".join((b"aritra-sticks-1", boat.encode(), payload)), "sha256")


class StickGate:
    """Which samples are believed. `key`: None: unsigned ones, too, as of orders. Nobody steers until `take`."""

    def __init__(self, boat: str, run: str, key: bytes | None) -> None:
        self._boat, self._run, self._key = boat, run, key
        self._order: Order | None = None
        self._counter = -1
        self._decoder = msgspec.json.Decoder(StickSample)

    @property
    def is_taken(self) -> bool:
        """Whether anybody on shore may steer."""
        return self._order is not None

    def take(self, order: Order) -> None:
        """The pilot has an order: `manual` gives the sticks to its session; any other takes them from everybody."""
        self._order, self._counter = (order, order.counter) if order.command == "manual" else (None, -1)

    def judge(self, payload: bytes, attachment: bytes | None, now_ns: int) -> ManualInput:
        """What the sticks say, for the pilot. Raises OrderRefused."""
        if len(payload) > MAX_BYTES:
            raise OrderRefused("too_long", f"longer than {MAX_BYTES} bytes")
        if self._key is not None and not hmac.compare_digest(
            attachment or b"", seal_sticks(self._key, self._boat, payload)
        ):
            raise OrderRefused("unsigned", "sticks that are not signed with this boat's command key")
        try:
            sample = self._decoder.decode(payload)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise OrderRefused("malformed", f"not sticks: {str(error)[:200]}") from None
        if sample.v > VERSION:
            raise OrderRefused("version", f"sticks of version {sample.v}, the boat knows {VERSION}")
        if sample.run != self._run:
            raise OrderRefused("wrong_run", "sticks meant for another run of the boat's program")
        order = self._order
        if order is None or sample.session != order.session:
            raise OrderRefused("not_now", "sticks of somebody who has not been given them")
        if sample.counter <= self._counter:
            raise OrderRefused("replayed", f"sticks {sample.counter}, and {self._counter} was heard already")
        age_s = (now_ns - sample.t_ns) * 1e-9
        if not -AHEAD_S <= age_s <= FRESH_S:
            raise OrderRefused("late", f"sticks {age_s:.2f} s old by the boat's clock; {FRESH_S:g} s are believed")
        self._counter = sample.counter
        shares = (sample.surge, sample.sway, sample.yaw) if sample.held else (0.0, 0.0, 0.0)
        return ManualInput(
            t_ns=min(sample.t_ns, now_ns),
            surge=shares[0],
            sway=shares[1],
            yaw=shares[2],
            source=f"shore, {order.sender}",
        )
