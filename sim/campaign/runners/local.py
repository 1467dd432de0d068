"""Cases in processes on this machine: one process for each lane, each with one case at a time.

Processes are spawned: a fork beside the threads of a library hangs. A lane whose process dies is made anew, and its
case is run again, up to `DEATHS` times. They watch a pipe that only the campaign holds: when it ends, however it ends,
they end. numpy and what needs it must not be imported here: workers set their thread counts first.
"""

from __future__ import annotations

import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from multiprocessing.connection import Connection

from sim.campaign.runners.job import DEATHS, CaseOutcome, RunnerLost, Work, died

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "POLARS_MAX_THREADS")


class Local:
    """A `Runner` with `jobs` processes. Use as a context manager: they live until it ends."""

    def __init__(self, jobs: int):
        self._context = get_context("spawn")
        self._jobs = jobs
        self._listening, self._held = self._context.Pipe(duplex=False)
        self._lanes: list[ProcessPoolExecutor] = []

    def __enter__(self) -> Local:
        return self

    def __exit__(self, *exc: object) -> None:
        """End the processes at once, also in the middle of a case."""
        self._held.close()
        for lane in self._lanes:
            lane.shutdown(wait=True, cancel_futures=True)
        self._listening.close()

    def __call__(self, works: Sequence[Work]) -> Iterator[CaseOutcome]:
        """Outcomes as they come. Raises RunnerLost where a process cannot even load this program."""
        while len(self._lanes) < min(self._jobs, len(works)):
            self._lanes.append(self._lane())
        waiting, free, deaths = deque(works), list(self._lanes), Counter[str]()
        running: dict[Future[CaseOutcome], tuple[ProcessPoolExecutor, Work]] = {}
        self._fill(free, waiting, running)
        while running:
            ended, _ = wait(running, return_when=FIRST_COMPLETED)
            outcomes = []
            for future in ended:
                lane, work = running.pop(future)
                try:
                    outcomes.append(future.result())
                except BrokenProcessPool:
                    lane = self._anew(lane)
                    deaths[work.id] += 1
                    if deaths[work.id] < DEATHS:
                        waiting.appendleft(work)
                    else:
                        outcomes.append(died(work))
                except Exception as error:
                    raise RunnerLost(f"a process cannot run cases: {error!r}") from error
                free.append(lane)
            self._fill(free, waiting, running)
            yield from outcomes

    def _fill(
        self,
        free: list[ProcessPoolExecutor],
        waiting: deque[Work],
        running: dict[Future[CaseOutcome], tuple[ProcessPoolExecutor, Work]],
    ) -> None:
        """Give each free lane a case."""
        while free and waiting:
            lane, work = free.pop(), waiting.popleft()
            try:
                future = lane.submit(_run, work)
            except BrokenProcessPool:  # its process died between two cases
                lane = self._anew(lane)
                future = lane.submit(_run, work)
            running[future] = lane, work

    def _lane(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, self._context, initializer=_begin, initargs=(self._listening,))

    def _anew(self, broken: ProcessPoolExecutor) -> ProcessPoolExecutor:
        broken.shutdown(wait=True)
        self._lanes[self._lanes.index(broken)] = lane = self._lane()
        return lane


def _begin(campaign: Connection) -> None:
    """In a new process: threads, Ctrl-C left to the campaign, and the end with it."""
    os.environ.update(dict.fromkeys(THREADS, "1"))
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        try:
            campaign.recv_bytes()
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _run(work: Work) -> CaseOutcome:
    from sim.campaign.runners.worker import run_work  # noqa: PLC0415 - heavy: in the worker alone

    return run_work(work)
