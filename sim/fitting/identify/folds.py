"""Two halves of the fitted logs, each to be predicted by what was fitted to the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run, RunError
from companion.logs.runs.splits import block_intervals, parts
from sim.fitting.engine.windows import SETTLE_S, StructuredFitError
from sim.fitting.identify.horizon import HORIZON_S, HorizonTarget, horizon_target, least_s, reaches

LOGS = 4
"""From so many logs on each is used whole; fewer are cut into blocks. Assumed."""
BLOCKS = 6
"""Blocks of a long log; assumed."""
HORIZONS_S = (HORIZON_S, 8.0, 5.0)
"""How far ahead to predict: the first that the logs are long enough for."""


@dataclass(frozen=True)
class Halves:
    """Both halves: their runs, and what is to be predicted of each, `horizon_s` ahead."""

    horizon_s: float
    runs: tuple[Sequence[Run], Sequence[Run]]
    targets: tuple[HorizonTarget, HorizonTarget]


def folds(runs: Sequence[Run], vessel: VesselFile) -> Halves | None:
    """Both halves; None where the logs are too short even for the shortest horizon."""
    for horizon_s in HORIZONS_S:
        first, second = _dealt(_pieces(runs, horizon_s))
        if first and second:
            try:
                targets = horizon_target(first, vessel, horizon_s), horizon_target(second, vessel, horizon_s)
                return Halves(horizon_s, (first, second), targets)
            except StructuredFitError:  # a piece without positions or heading
                continue
    return None


def _pieces(runs: Sequence[Run], horizon_s: float) -> list[Run]:
    """Whole logs, the longest first, or blocks of them in order of time; without what is too short to be judged by."""
    if len(runs) >= LOGS:
        return sorted((run for run in runs if reaches(run, horizon_s)), key=lambda run: -run.duration_s)
    block_s = least_s(horizon_s) + SETTLE_S + 1.0
    pieces = []
    for run in runs:
        try:
            pieces += parts(run, block_intervals(run, max(block_s, run.duration_s / BLOCKS)))
        except RunError:  # shorter than one block
            continue
    return [piece for piece in pieces if reaches(piece, horizon_s)]


def _dealt(pieces: Sequence[Run]) -> tuple[list[Run], list[Run]]:
    """In turns 0 1 1 0 0 1 ..: so neither half has all the longer ones, nor all the later."""
    halves: tuple[list[Run], list[Run]] = ([], [])
    for i, piece in enumerate(pieces):
        halves[(i + i // 2) % 2].append(piece)
    return halves
