"""One stop, chased to every program that answers under a boat's name.

1. made out for the run and clock that telemetry shows (which may be wrong, or made up by a stranger), and sent to
   all of the name
2. a program that cannot tell how old it is, being another run or of another clock, says so in a signed answer,
   and with it run and clock: made out anew for that, and sent at once; once a program, unless what was made out
   for it is refused as well, so that a slow answer is no reason to stop it twice
3. said again, word for word, until all that were heard have it, or time is up
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable

from companion.core.telemetry.order_gate import OrderOutcome
from companion.core.telemetry.order_sender import NOWHERE, Place, SealedOrder, Sender
from companion.shore.console.answers import Ask, OrderAnswer

AGAIN_S = 0.1
"""Until the second try; from one to the next twice as long, up to `ANSWER_S`. The boat obeys once, so that a try costs
nothing but a few hundred bytes; but boats that are dead must not fill the network of the others (assumed)."""
ANSWER_S = 1.0
"""How long a try waits for answers (assumed)."""
MADE = 8
"""Programs of one name that it is made out for (assumed)."""


class StopChase:
    """`stopped`: outcome by run; `refused`: of those that do not obey; `strange`: an answer that is not the boat's.

    `note` is called with each change of these and with each try. `tries`: how often it was sent.
    """

    def __init__(self, boat: str, sender: Sender, ask: Ask, note: Callable[[], None]) -> None:
        self.stopped: dict[str, OrderOutcome] = {}
        self.refused: dict[str, OrderOutcome] = {}
        self.strange: OrderOutcome | None = None
        self.tries = 0
        self._boat, self._sender, self._ask, self._note = boat, sender, ask, note
        self._made: dict[str, SealedOrder] = {}
        self._made_s: dict[str, float] = {}
        self._over, self._news = False, asyncio.Event()
        self._asking: set[asyncio.Task[None]] = set()

    async def run(self, place: Place | None, runs: Callable[[], tuple[str, ...]], patience_s: float) -> None:
        """Until every run of `runs()` and every one that answered has it, or `patience_s` is over."""
        end_s, first, pause_s = time.monotonic() + patience_s, place or NOWHERE, AGAIN_S
        self._made[first.run] = self._sender.order("stop", at=first)
        try:
            while time.monotonic() < end_s:
                self.tries += 1
                self._note()
                for run, order in list(self._made.items()):
                    if run not in self.stopped:
                        self._send(order)
                if await self._settled(runs, min(time.monotonic() + pause_s, end_s)):
                    return
                pause_s = min(2 * pause_s, ANSWER_S)
        finally:
            for task in self._asking:
                task.cancel()

    async def _settled(self, runs: Callable[[], tuple[str, ...]], end_s: float) -> bool:
        """Whether all have it, before `end_s`."""
        while True:
            known = {*runs(), *self._made_s}
            if self._over and (self.stopped or self.refused) and known <= {*self.stopped, *self.refused}:
                return True
            if (left_s := end_s - time.monotonic()) <= 0:
                return False
            self._news.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._news.wait(), left_s)

    def _send(self, order: SealedOrder) -> None:
        task = asyncio.create_task(self._hear(order))
        self._asking.add(task)
        task.add_done_callback(self._asking.discard)

    async def _hear(self, order: SealedOrder) -> None:
        async for answer in self._ask(self._boat, order, ANSWER_S, self._sender.believe):
            self._take(order, answer)
            self._news.set()
        self._over = True
        self._news.set()

    def _take(self, order: SealedOrder, answer: OrderAnswer) -> None:
        outcome = answer.outcome
        if not answer.proven:
            self.strange = outcome
        elif outcome.run in self.stopped or outcome.code == "busy":
            return  # known, or on its way to the pilot: the next answer says more
        elif outcome.status != "refused":
            self.stopped[outcome.run] = outcome
            self.refused.pop(outcome.run, None)
        elif outcome.code in ("wrong_run", "late"):
            return self._make(order, outcome)
        else:
            self.refused[outcome.run] = outcome
        self._note()

    def _make(self, order: SealedOrder, refusal: OrderOutcome) -> None:
        """Anew, for run and clock of a refusal, where none is under way for that run; not oftener than it is sent."""
        run, now_s = refusal.run, time.monotonic()
        if self._made.get(run, order) is not order or (run not in self._made_s and len(self._made_s) >= MADE):
            return
        if now_s - self._made_s.get(run, -AGAIN_S) < AGAIN_S:
            return
        self._made_s[run] = now_s
        self._made[run] = self._sender.order("stop", at=Place(run, refusal.t_ns))
        self._send(self._made[run])
