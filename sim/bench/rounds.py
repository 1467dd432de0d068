"""Interleaved rounds: every solver replays the same recorded states, in turn, again and again in one run.

A shared machine drifts. The reference is therefore the fastest of the baseline's rounds, ours the median of ours.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from sim.bench.solvers import Planner
from sim.bench.worlds import STEPS, TICK_S, World


class Asked(NamedTuple):
    """What a solver is asked at one tick: state, parameters by stage, parameters of the horizon."""

    x0: np.ndarray
    p: np.ndarray
    q: np.ndarray


def record(world: World, planner: Planner, seed: int, steps: int = STEPS) -> tuple[list[Asked], float]:
    """One drive by `planner`: what it was asked at each tick, and what the drive cost by the stage cost."""
    drive, asked, cost = world.drive(seed), [], 0.0
    for tick in range(steps):
        p, q = drive.ask(tick)
        asked.append(Asked(drive.x.copy(), p.copy(), q.copy()))
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


def replay(planner: Planner, asked: Sequence[Asked], *, every_s: float = 0.0) -> np.ndarray:
    """Seconds of each solve. `every_s`: at that cadence, asleep in between, so that caches are cold."""
    times = np.zeros(len(asked))
    planner.begin(*asked[0])
    with _undisturbed():
        due = time.monotonic()
        for k, one in enumerate(asked):
            if every_s:
                due += every_s
                time.sleep(max(0.0, due - time.monotonic()))
            started = time.perf_counter()
            planner.solve(*one)
            times[k] = time.perf_counter() - started
    return times


@dataclass
class Timed:
    """Rounds of one solver."""

    rounds: list[np.ndarray] = field(default_factory=list)

    def fastest(self, percentile: float) -> float:
        """That percentile [s] of the round where it is least."""
        return float(min(np.percentile(r, percentile) for r in self.rounds))

    def median(self, percentile: float) -> float:
        """Median over the rounds [s]."""
        return float(np.median([np.percentile(r, percentile) for r in self.rounds]))


def rounds(
    planners: Sequence[Planner], asked: Sequence[Asked], count: int, told: Callable[[str], None] = lambda _: None
) -> dict[str, Timed]:
    """`count` interleaved rounds. `told` hears of each."""
    timed = {planner.name: Timed() for planner in planners}
    for k in range(count):
        for planner in planners:
            told(f"round {k + 1} of {count}: {planner.name}")
            timed[planner.name].rounds.append(replay(planner, asked))
    return timed


CADENCE_S = TICK_S
"""The boat's own."""
