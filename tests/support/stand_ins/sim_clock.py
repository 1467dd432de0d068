"""A clock that stands still until it is advanced: an hour of waiting takes milliseconds, and each run is the same."""

from __future__ import annotations

import asyncio
import heapq

SETTLE_ROUNDS = 16
"""Event-loop rounds given to the tasks that a stepped clock woke: how many hand-overs one may cause."""


class SimClock:
    """A clock that moves only by `advance`. Sleepers wake by instant, then by arrival."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns
        self._sleepers: list[tuple[int, int, asyncio.Future[None]]] = []
        self._arrivals = 0
        self._advancing = False

    def now_ns(self) -> int:
        """The simulated instant [ns]."""
        return self._now_ns

    async def sleep_until(self, t_ns: int) -> None:
        """Wait until `advance` has reached `t_ns`."""
        if t_ns <= self._now_ns:
            await asyncio.sleep(0)
            return
        sleeper = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (t_ns, self._arrivals, sleeper))
        self._arrivals += 1
        await sleeper

    def stall(self, t_ns: int) -> None:
        """Nobody ran until `t_ns`: whoever was due before wakes with the next `advance`, none at the instant meant."""
        self._sleepers = sorted((max(due_ns, t_ns), k, sleeper) for due_ns, k, sleeper in self._sleepers)
        self._now_ns = t_ns

    async def advance(self, ns: int) -> None:
        """Move on by `ns`, stopping at every sleeper's instant to let it and what it causes run.

        Sleepers that arrive on the way are woken too if their instant lies within. Work handed to other
        threads or processes is not waited for. Raises ValueError for a step back, RuntimeError when two
        tasks advance at once.
        """
        if ns < 0:
            raise ValueError(f"time does not go back: {ns} ns")
        if self._advancing:
            raise RuntimeError("another task is advancing this clock")
        self._advancing = True
        target_ns = self._now_ns + ns
        try:
            await _settle()
            while self._sleepers and self._sleepers[0][0] <= target_ns:
                t_ns, _, sleeper = heapq.heappop(self._sleepers)
                if not sleeper.done():
                    self._now_ns = t_ns
                    sleeper.set_result(None)
                    await _settle()
            self._now_ns = target_ns
        finally:
            self._advancing = False


async def _settle() -> None:
    for _ in range(SETTLE_ROUNDS):
        await asyncio.sleep(0)
