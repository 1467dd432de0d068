"""Orders from the page to a boat: signed, sent, repeated word for word until the boat answers or time is up.

The boat obeys an order once, however often it receives it (docs/telemetry.md), so repeating is safe; a stop is repeated
for longer than the others. What the page shows is what the boat answered, or that no answer came.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Literal

import msgspec

from companion.core.telemetry.order_gate import Command, MissionFile, OrderOutcome, Sender, read_outcome

ANSWER_S = 1.0
"""How long to wait for an answer before the order is sent again (assumed)."""
PAUSE_S = 0.2
"""Pause between attempts where the network reports at once that nobody answers (assumed)."""
PATIENCE_S = {"stop": 10.0, "hold": 5.0, "start": 5.0, "load_mission": 5.0}
"""How long an order is repeated. Others than a stop are not believed when older than 5 s, and should not be."""
MAX_TOLD = 50

Ask = Callable[[str, bytes, bytes | None, float], Awaitable[bytes | None]]
"""ask(boat, payload, attachment, timeout [s]) -> the reply's payload, or None: no answer."""


class SentOrder(msgspec.Struct, kw_only=True):
    """One order as the page sees it. `asked_ms`: on the console's clock; `after_ms`: so much later came the answer.

    `state`: `sending`; `answered`, `outcome` is the boat's; `no_answer`; `not_sent`, `why` says the reason.
    """

    type: Literal["order"] = "order"
    number: int
    boat: str
    command: Command
    state: Literal["sending", "answered", "no_answer", "not_sent"]
    asked_ms: float
    tries: int = 0
    after_ms: float | None = None
    why: str = ""
    outcome: OrderOutcome | None = None


class Orders:
    """Sends orders. `tell` is called with every change of each."""

    def __init__(self, sender: Callable[[str], Sender | None], ask: Ask, tell: Callable[[SentOrder], None]) -> None:
        self.last: dict[int, SentOrder] = {}
        self._sender, self._ask, self._tell = sender, ask, tell
        self._number = 0

    async def give(self, boat: str, command: Command, mission: MissionFile | None = None) -> SentOrder:
        """Send one order until it is answered or its time is up."""
        begun_s = time.monotonic()
        self._number += 1
        order = SentOrder(number=self._number, boat=boat, command=command, state="sending", asked_ms=begun_s * 1e3)
        self.last[order.number] = order
        if len(self.last) > MAX_TOLD:
            del self.last[next(iter(self.last))]
        sender = self._sender(boat)
        if sender is None:
            return self._end(order, "not_sent", "this console has no command key for this boat")
        self._tell(order)
        signed: tuple[bytes, bytes | None] | None = None
        while (left_s := begun_s + PATIENCE_S[command] - time.monotonic()) > 0:
            signed = signed or _signed(sender, command, mission)
            if signed:
                order.tries += 1
                reply = await self._ask(boat, *signed, min(ANSWER_S, left_s))
                if reply is not None and self._read(order, reply, begun_s):
                    return order
                signed = None if order.outcome else signed
                if order.tries > 1:
                    self._tell(order)
            await asyncio.sleep(PAUSE_S)
        if order.outcome:
            return self._end(order, "answered", "")
        if signed is None:
            return self._end(order, "not_sent", f"nothing was heard of {boat}: which run it is in is not known")
        return self._end(order, "no_answer", f"no answer in {PATIENCE_S[command]:g} s: the boat may not have heard it")

    def _read(self, order: SentOrder, reply: bytes, begun_s: float) -> bool:
        """Note the boat's answer; False: it is still on its way to the pilot, or is none, or the boat's program was
        started anew and a stop is to be made out for the new run.
        """
        try:
            outcome = read_outcome(reply)
        except ValueError:
            return False
        if outcome.repeated and outcome.code == "busy":
            return False
        order.outcome, order.after_ms = outcome, round((time.monotonic() - begun_s) * 1e3, 1)
        if outcome.code == "wrong_run" and order.command == "stop":
            return False
        self._end(order, "answered", "")
        return True

    def _end(self, order: SentOrder, state: Literal["answered", "no_answer", "not_sent"], why: str) -> SentOrder:
        order.state, order.why = state, why
        self._tell(order)
        return order


def _signed(sender: Sender, command: Command, mission: MissionFile | None) -> tuple[bytes, bytes | None] | None:
    """Payload and attachment; None: no sample of the boat was received yet, as just after start."""
    try:
        return sender.order(command, mission)
    except ValueError:
        return None
