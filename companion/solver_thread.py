"""One worker thread for the optimal control problem: a request in, a PlanResult back on the event loop.

The thread keeps the warm start. It takes one request at a time; while it is busy a new one is refused, and
the fallback ladder fills the gap. CasADi releases the interpreter lock while it solves. A solver that raises has
failed, and one that never returns is left behind: the thread is a daemon, so that neither can keep the boat from
stopping.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
from collections.abc import Callable
from typing import Any, Protocol

from companion.core.messages import PlanResult, SolveRequest

CLOSE_S = 1.0
"""How long `close` waits for the solve under way; assumed: far above the solver's own time limit."""


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
        self._work: queue.SimpleQueue[tuple[SolveRequest, asyncio.AbstractEventLoop] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="nmpc", daemon=True)
        self._thread.start()

    def submit(self, request: SolveRequest) -> bool:
        """Start solving; False where the last request is still being solved."""
        if self._busy:
            return False
        self._busy = True
        self._work.put((request, asyncio.get_running_loop()))
        return True

    def close(self) -> None:
        """End the thread, or leave it to its endless solve after `CLOSE_S`. No result comes any more."""
        self._closed = True
        self._work.put(None)
        self._thread.join(CLOSE_S)

    def _run(self) -> None:
        warm: Any = None
        while work := self._work.get():
            request, loop = work
            try:
                result, warm = self._solver.solve(request, warm)
            except Exception as error:  # a bug in the solver is one more way to have no plan
                result, warm = _failed(request, error), None
            with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                loop.call_soon_threadsafe(self._finish, result)

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
