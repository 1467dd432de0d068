"""One worker thread for the optimal control problem: a request in, a PlanResult back on the event loop.

The thread keeps the warm start. It takes one request at a time; while it is busy a new one is refused, and
the fallback ladder fills the gap. Between two requests the processor's caches go to others, and the next solve
takes several times as long: `rehearse`, called shortly before it, solves the last one once more and throws the plan
away. CasADi releases the interpreter lock while it solves. A solver that raises has failed, and one that never
returns is left behind: the thread is a daemon, so that neither can keep the boat from stopping.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from companion.core.messages import PlanResult, SolveRequest

CLOSE_S = 1.0
"""How long `close` waits for the solve under way; assumed: far above the solver's own time limit."""
REHEARSAL_S = 1.5e-3
"""How long before a request to rehearse: event loops wake up to 1 ms late, caches are lost within a few (measured)."""
REHEARSED_S = 3e-3
"""A solve that took longer is not rehearsed: the next request may have to wait for so much. Assumed."""


class Solver(Protocol):
    """What solves: should not raise, says in the result how it went."""

    def solve(self, request: SolveRequest, warm: Any) -> tuple[PlanResult, Any]:
        """The plan, and what may warm-start the next one."""
        ...


class SolverThread:
    """`on_result` is called on the event loop that called `submit`."""

    def __init__(self, solver: Solver, on_result: Callable[[PlanResult], None]):
        self._solver, self._on_result = solver, on_result
        self._busy = False
        self._closed = False
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._warm: Any = None
        self._last: tuple[SolveRequest, Any] | None = None
        self._thread = threading.Thread(target=self._run, name="nmpc", daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """Whether a request is being solved."""
        return self._busy

    def submit(self, request: SolveRequest) -> bool:
        """Start solving; False where the last request is still being solved."""
        if self._busy:
            return False
        self._busy = True
        self._work.put(partial(self._solve, request, asyncio.get_running_loop()))
        return True

    def rehearse(self) -> None:
        """Solve the last request once more, without a result, if it went well and quickly."""
        if not self._busy:
            self._work.put(self._repeat)

    def close(self) -> None:
        """End the thread, or leave it to its endless solve after `CLOSE_S`. No result comes any more."""
        self._closed = True
        self._work.put(None)
        self._thread.join(CLOSE_S)

    def _run(self) -> None:
        while work := self._work.get():
            work()

    def _solve(self, request: SolveRequest, loop: asyncio.AbstractEventLoop) -> None:
        asked = request, self._warm
        try:
            result, self._warm = self._solver.solve(*asked)
        except Exception as error:  # a bug in the solver is one more way to have no plan
            result, self._warm = _failed(request, error), None
        self._last = asked if result.status == "ok" and result.solve_time_s <= REHEARSED_S else None
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(self._finish, result)

    def _repeat(self) -> None:
        """Once for each request; what comes of it, an exception too, concerns nobody."""
        asked, self._last = self._last, None
        if asked:
            with contextlib.suppress(Exception):
                self._solver.solve(*asked)

    def _finish(self, result: PlanResult) -> None:
        self._busy = False
        if not self._closed:
            self._on_result(result)


def _failed(request: SolveRequest, error: Exception) -> PlanResult:
    return PlanResult(
        t_ns=request.t_ns,
        index=request.index,
        status="failed",
        reason=f"the solver raised {type(error).__name__}: {error}",
        solve_time_s=0.0,
        iterations=0,
        cost=None,
        f_n=(),
        x=(),
    )
