"""Orders from the page to a boat: signed, sent, repeated word for word until the boat answers or time is up.

The boat obeys an order once, however often it receives it (docs/telemetry.md), so repeating is safe. A stop goes to
every program that answers under the name (`stop_chase`). Any other order goes to one: a `hello` asks who is there, and
what is sent is made out for the run and the clock that its signed answer tells; where two share the name, nothing is
sent. What the page shows is what the boat answered, or that no answer came.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterable
from typing import Literal

import msgspec

from companion.core.telemetry.order_gate import Command, MissionFile, OrderOutcome, Word
from companion.core.telemetry.order_sender import NOWHERE, Place, SealedOrder, Sender
from companion.shore.console.answers import Ask, Boats, OrderAnswer
from companion.shore.console.stop_chase import StopChase

ANSWER_S = 1.0
"""How long to wait for an answer before the order is sent again (assumed)."""
ALSO_S = 0.2
"""How long a second program of the name has to answer after the first (assumed)."""
PAUSE_S = 0.2
"""Pause between attempts where the network reports at once that nobody answers (assumed)."""
PATIENCE_S = {"stop": 10.0, "hold": 5.0, "start": 5.0, "manual": 5.0, "load_mission": 5.0}
"""How long an order is repeated. Others than a stop are not believed when older than 5 s, and should not be."""
OVERTAKEN = "a STOP was given after it: it is not sent any more"
STRANGER = "a program without this key"
MAX_TOLD = 50
TOLD = 8
"""Runs of a shared name that its programs are told of: as many as an order may carry."""


class SentOrder(msgspec.Struct, kw_only=True):
    """One order as the page sees it. `asked_ms`: on the console's clock; `after_ms`: so much later came the answer.

    `state`: `sending`; `answered`, `outcome` is the boat's; `no_answer`; `not_sent`, `why` says the reason.
    `missing`: of a stop that was answered, who else has the boat's name and refused it, did not answer, or has
    another key.
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
    missing: tuple[str, ...] = ()


class Orders:
    """Sends orders. `tell` is called with every change of each."""

    def __init__(self, boats: Boats, ask: Ask, tell: Callable[[SentOrder], None]) -> None:
        self.last: dict[int, SentOrder] = {}
        self._boats, self._ask, self._tell = boats, ask, tell
        self._number = 0

    def begin(self, boat: str, command: Command) -> SentOrder:
        """A new order, told as being sent: `send` it."""
        self._number += 1
        now_ms = time.monotonic() * 1e3
        order = SentOrder(number=self._number, boat=boat, command=command, state="sending", asked_ms=now_ms)
        self.last[order.number] = order
        if len(self.last) > MAX_TOLD:
            del self.last[next(iter(self.last))]
        self._tell(order)
        return order

    async def give(self, boat: str, command: Command, mission: MissionFile | None = None) -> SentOrder:
        """Send one order until it is answered or its time is up."""
        order = self.begin(boat, command)
        await self.send(order, mission)
        return order

    async def send(self, order: SentOrder, mission: MissionFile | None = None, run: str | None = None) -> None:
        """Send what was begun. Of a stop `order` says that it was answered as soon as one program did.

        `run`: another order than a stop goes to this run of the boat's program and to no other.
        """
        sender = self._boats.sender(order.boat)
        if isinstance(sender, str):
            return self.end(order, "not_sent", sender)
        if order.command == "stop":
            return await self._stop(order, sender)
        end_s = time.monotonic() + PATIENCE_S[order.command]
        if not (place := await self._find(order, sender, end_s)):
            return
        if run is not None and place.run != run:
            return self.end(order, "not_sent", f"the program of {order.boat} was started anew meanwhile")
        await self._repeat(order, sender, sender.order(order.command, mission, at=place), place.run, end_s)

    def newest(self, boat: str) -> SentOrder | None:
        """The order that was given to a boat last, from whichever page."""
        return next((order for order in reversed(self.last.values()) if order.boat == boat), None)

    async def warn(self, boat: str) -> None:
        """Tell the programs of a shared name of each other."""
        if not isinstance(sender := self._boats.sender(boat), str):
            async for answer in self._ask(boat, sender.order("hello", at=NOWHERE), ANSWER_S, sender.believe):
                if answer.proven:
                    at = Place(answer.outcome.run, answer.outcome.t_ns)
                    told = sender.order("hello", at=at, heard=self._boats.runs(boat)[:TOLD])
                    async for _ in self._ask(boat, told, ANSWER_S, sender.believe):
                        pass

    # --- a stop ------------------------------------------------------------------------------------

    async def _stop(self, order: SentOrder, sender: Sender) -> None:
        def note() -> None:
            order.tries = chase.tries
            if chase.stopped and order.outcome is None:
                order.outcome, order.state = next(iter(chase.stopped.values())), "answered"
                order.after_ms = self._after_ms(order)
            order.why = _stopped(chase, order)
            self._tell(order)

        chase = StopChase(order.boat, sender, self._ask, note)
        await chase.run(self._boats.place(order.boat), lambda: self._boats.runs(order.boat), PATIENCE_S["stop"])
        silent = [run for run in self._boats.runs(order.boat) if run not in {*chase.stopped, *chase.refused}]
        if order.outcome is None and chase.refused:
            order.outcome, order.after_ms = next(iter(chase.refused.values())), self._after_ms(order)
        if order.outcome is None:
            return self.end(order, "no_answer", _no_answer("stop", chase.strange))
        order.missing = (*chase.refused, *silent, *([STRANGER] if chase.strange else []))
        unheard = f" Heard under this name and without an answer: run {', '.join(silent)}." if silent else ""
        strange = f" {STRANGER.capitalize()} answered under this name, too." if chase.strange else ""
        self.end(order, "answered", f"{_stopped(chase, order)}{unheard}{strange}".strip())

    # --- other orders ------------------------------------------------------------------------------

    async def _find(self, order: SentOrder, sender: Sender, end_s: float) -> Place | None:
        """Run and clock of the one program that answers under the name; None: there is none, or more, which is told."""
        found: dict[str, OrderOutcome] = {}
        strange: OrderOutcome | None = None
        while not found and (left_s := end_s - time.monotonic()) > 0 and not self._overtaken(order):
            order.tries += 1
            hello = sender.order("hello", at=NOWHERE)
            async for answer in self._until_all(order.boat, hello, min(ANSWER_S, left_s), sender):
                if answer.proven:
                    found[answer.outcome.run] = answer.outcome
                else:
                    strange = answer.outcome
            if order.tries > 1:
                self._tell(order)
            if not found:
                await asyncio.sleep(PAUSE_S)
        if self._overtaken(order):
            self.end(order, "not_sent", OVERTAKEN)
            return None
        order.tries = 0
        runs = {*found, *self._boats.runs(order.boat)}
        if len(found) == 1 == len(runs):
            return Place(*next((run, outcome.t_ns) for run, outcome in found.items()))
        if len(runs) > 1 and found:
            self.end(order, "not_sent", shared(order.boat, runs))
        else:
            self.end(order, "not_sent", _no_answer(order.command, strange))
        return None

    async def _until_all(
        self, boat: str, hello: SealedOrder, timeout_s: float, sender: Sender
    ) -> AsyncIterator[OrderAnswer]:
        """Answers to one hello: all there are, but none later than `ALSO_S` after the first that is proven."""
        asking = self._ask(boat, hello, timeout_s, sender.believe)
        end_s = None
        while True:
            left_s = None if end_s is None else max(end_s - time.monotonic(), 0.0)
            try:
                answer = await asyncio.wait_for(anext(asking, None), left_s)
            except TimeoutError:
                return
            if answer is None:
                return
            if answer.proven and end_s is None:
                end_s = time.monotonic() + ALSO_S
            yield answer

    async def _repeat(self, order: SentOrder, sender: Sender, sealed: SealedOrder, run: str, end_s: float) -> None:
        """Word for word, until the run that it is made out for answers, or another says that it is there instead."""
        while (left_s := end_s - time.monotonic()) > 0 and not self._overtaken(order):
            order.tries += 1
            async for answer in self._ask(order.boat, sealed, min(ANSWER_S, left_s), sender.believe):
                outcome = answer.outcome
                if not answer.proven or (outcome.repeated and outcome.code == "busy"):
                    continue
                order.outcome, order.after_ms = outcome, self._after_ms(order)
                if outcome.run == run:
                    break
            if order.outcome:
                return self.end(order, "answered", "")
            if order.tries > 1:
                self._tell(order)
            await asyncio.sleep(PAUSE_S)
        self.end(order, "no_answer", OVERTAKEN if self._overtaken(order) else _no_answer(order.command, None))

    def _overtaken(self, order: SentOrder) -> bool:
        """Whether a stop was given to the boat after this order, which must not come to it later then."""
        return any(o.command == "stop" and o.boat == order.boat for n, o in self.last.items() if n > order.number)

    @staticmethod
    def _after_ms(order: SentOrder) -> float:
        return round(time.monotonic() * 1e3 - order.asked_ms, 1)

    def end(self, order: SentOrder, state: Literal["answered", "no_answer", "not_sent"], why: str) -> None:
        """Settle what was begun, and tell it."""
        order.state, order.why = state, why
        self._tell(order)


def shared(boat: str, runs: Iterable[str]) -> str:
    """Why nothing but a stop is sent to a name that several programs have."""
    names = ", ".join(sorted(runs))
    return (
        f"several programs call themselves {boat} (runs {names}): a stop goes to all of them, other orders to none. "
        "End all but one, or give each boat its own name (telemetry.boat in its run file)"
    )


def _stopped(chase: StopChase, order: SentOrder) -> str:
    if len(chase.stopped) < 2 and not (chase.stopped and chase.refused):
        return ""
    no = "".join(f" Run {run} refused it: {outcome.text}." for run, outcome in chase.refused.items())
    if len(chase.stopped) == 1:
        return f"1 program that calls itself {order.boat} has it.{no}"
    return f"{len(chase.stopped)} programs that call themselves {order.boat} have it.{no}"


def _no_answer(command: Word, strange: OrderOutcome | None) -> str:
    """`strange`: an answer that did not come from the boat."""
    patience = f"no answer in {PATIENCE_S[command]:g} s"
    if strange:
        return f"{patience} from a program with this key. One without it said “{strange.text}”: is the key the boat's?"
    return (
        f"{patience}: the boat may not have heard it" if command == "stop" else f"{patience}: the boat is out of reach"
    )
