"""Interleaved rounds: every solver replays the same recorded states, in turn, again and again in one run.

A shared machine drifts. The reference is therefore the fastest of the baseline's rounds, ours the median of ours.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from companion.boat.solver_thread import REHEARSAL_S
from sim.bench.controller.solvers import Planner
from sim.bench.controller.worlds import STEPS, TICK_S, BenchWorld


class RecordedProblem(NamedTuple):
    """What a solver is asked at one tick: state, parameters by stage, parameters of the horizon."""

    x0: np.ndarray
    p: np.ndarray
    q: np.ndarray


def record(world: BenchWorld, planner: Planner, seed: int, steps: int = STEPS) -> tuple[list[RecordedProblem], float]:
    """One drive by `planner`: what it was asked at each tick, and what the drive cost by the stage cost."""
    drive, asked, cost = world.drive(seed), [], 0.0
    for tick in range(steps):
        p, q = drive.ask(tick)
        asked.append(RecordedProblem(drive.x.copy(), p.copy(), q.copy()))
        if tick == 0:
            planner.begin(*asked[0])
        c = np.clip(planner.solve(*asked[-1]).c[0], world.ocp.c_min, world.ocp.c_max)
        cost += float(world.stage_cost(drive.x, c, p[0], q))
        drive.go(c)
    return asked, cost


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Without the garbage collector."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


class BenchClock(NamedTuple):
    """A clock [s] that only goes forward, and how to wait on it [s]."""

    now: Callable[[], float]
    sleep: Callable[[float], object]


WALL = BenchClock(time.perf_counter, time.sleep)


def times_of(
    calls: Iterable[Callable[[], Any]],
    *,
    every_s: float = 0.0,
    rehearse: Callable[[], object] | None = None,
    clock: BenchClock = WALL,
) -> Iterator[tuple[float, Any]]:
    """Seconds and result of each call. `every_s`: at that cadence, asleep in between, so that caches are cold;
    `rehearse` is called as long before as the boat does, and asleep again after.
    """
    with _undisturbed():
        due = clock.now()
        for call in calls:
            if every_s:
                due += every_s
                if rehearse:
                    clock.sleep(max(0.0, due - REHEARSAL_S - clock.now()))
                    rehearse()
                clock.sleep(max(0.0, due - clock.now()))
            started = clock.now()
            result = call()
            yield clock.now() - started, result


class Replayed(NamedTuple):
    """One round of one solver: seconds of each solve (n,), first commands (n, nu), and which it calls solved (n,)."""

    seconds: np.ndarray
    first: np.ndarray
    solved: np.ndarray


def replay(
    planner: Planner,
    asked: Sequence[RecordedProblem],
    *,
    every_s: float = 0.0,
    rehearse: Callable[[], object] | None = None,
) -> Replayed:
    """What a planner does with recorded states, from its own plans; `every_s`, `rehearse` as in `times_of`."""
    planner.begin(*asked[0])
    seconds, first, solved = [], [], []
    for took, plan in times_of((partial(planner.solve, *one) for one in asked), every_s=every_s, rehearse=rehearse):
        seconds.append(took)
        first.append(plan.c[0].copy())
        solved.append(plan.solved)
    return Replayed(np.array(seconds), np.array(first), np.array(solved))


@dataclass
class Timed:
    """Rounds of one solver, or of anything else that was timed: seconds of each call."""

    rounds: list[np.ndarray] = field(default_factory=list)

    def fastest(self, percentile: float) -> float:
        """That percentile [s] of the round where it is least."""
        return float(min(np.percentile(r, percentile) for r in self.rounds))

    def median(self, percentile: float) -> float:
        """Median over the rounds [s]."""
        return float(np.median([np.percentile(r, percentile) for r in self.rounds]))

    @property
    def count(self) -> int:
        """Calls of all rounds."""
        return sum(r.size for r in self.rounds)


@dataclass
class Solved(Timed):
    """Rounds of one solver, and what it answered in the last of them."""

    first: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    unsolved: int = 0

    def add(self, one: Replayed) -> None:
        """One more round."""
        self.rounds.append(one.seconds)
        self.first, self.unsolved = one.first, self.unsolved + int(np.count_nonzero(~one.solved))

    def off(self, reference: Solved, percentile: float = 99) -> float:
        """How far its first command is off that of `reference` at the same states: largest control, percentile."""
        return float(np.percentile(np.abs(self.first - reference.first).max(axis=1), percentile))


def interleaved(
    makers: Mapping[str, Callable[[], float]], count: int, progress: Callable[[str], None] = lambda _: None
) -> dict[str, Timed]:
    """`count` rounds in turn of anything that gives the seconds of one call; `progress` gets a line for each round."""
    timed = {name: Timed() for name in makers}
    for k in range(count):
        for name, make in makers.items():
            progress(f"round {k + 1} of {count}: {name}")
            timed[name].rounds.append(np.array([make()]))
    return timed


def rounds(
    planners: Sequence[Planner],
    asked: Sequence[RecordedProblem],
    count: int,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Solved]:
    """`count` interleaved rounds of solvers over the same states. `progress` is called with the name of each round."""
    timed = {planner.name: Solved() for planner in planners}
    for k in range(count):
        for planner in planners:
            progress(f"round {k + 1} of {count}: {planner.name}")
            timed[planner.name].add(replay(planner, asked))
    return timed


CADENCE_S = TICK_S
"""The boat's own."""
