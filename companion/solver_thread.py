"""One worker thread for the optimal control problem: a request in, a PlanResult back on the event loop.

The thread keeps the warm start. It takes one request at a time; while it is busy a new one is refused, and
the fallback ladder fills the gap. CasADi releases the interpreter lock while it solves.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol

from companion.core.messages import PlanResult, SolveRequest


class Solver(Protocol):
    """What solves: never raises, says in the result how it went."""

    def solve(self, request: SolveRequest, warm: Any) -> tuple[PlanResult, Any]:
        """The plan, and what may warm-start the next one."""
        ...


class SolverThread:
    """`on_result` is called on the event loop that called `submit`."""

    def __init__(self, solver: Solver, on_result: Callable[[PlanResult], None]):
        self._solver, self._on_result = solver, on_result
        self._warm: Any = None
        self._busy = False
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="nmpc")

    def submit(self, request: SolveRequest) -> bool:
        """Start solving; False where the last request is still being solved."""
        if self._busy:
            return False
        self._busy = True
        loop = asyncio.get_running_loop()
        self._pool.submit(self._solve, request).add_done_callback(
            lambda future: loop.call_soon_threadsafe(self._finish, future)
        )
        return True

    def close(self) -> None:
        """Wait for the solve under way and end the thread."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _solve(self, request: SolveRequest) -> PlanResult:
        result, self._warm = self._solver.solve(request, self._warm)
        return result

    def _finish(self, future: Future[PlanResult]) -> None:
        self._busy = False
        self._on_result(future.result())
