"""Share of open-loop runs of a model that diverge on held-out logs, and how far the others depart, over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.fitting.engine.smoothing import RATE_HZ
from sim.fitting.validate.protocol import Simulator
from sim.fitting.validate.scores import SpeedBox, errors, simulated
from sim.fitting.validate.table import ScoreTable, percent
from sim.fitting.validate.windows import HeldOutWindows


@dataclass(frozen=True)
class Departure:
    """One model on m runs.

    t_s         (k,) 1, 2 .. s after the start, as far as any run reaches
    diverged    (k,) share of runs that have diverged by then
    first_s     (m,) time at which each run diverged; inf: never
    position_m  (k, 3) 10th, 50th and 90th percentile of the distance to the true position (inf where not finite)
    """

    name: str
    runs: int
    t_s: np.ndarray
    diverged: np.ndarray
    first_s: np.ndarray
    position_m: np.ndarray


def departure(name: str, states: np.ndarray, windows: HeldOutWindows, box: SpeedBox) -> Departure:
    """Divergence of a model's `states` (m, k, 6) on the windows.

    `box`: speeds in the training logs. A run that leaves `SPREAD` times that box, or is not finite, has diverged.
    """
    gone = np.maximum.accumulate(box.left(states[..., 3:]), axis=1)
    first = np.where(gone.any(axis=1), gone.argmax(axis=1) / RATE_HZ, np.inf)
    at = np.arange(round(RATE_HZ), states.shape[1], round(RATE_HZ))
    at = at[np.isfinite(windows.truth[:, at, 0]).any(axis=0)]
    distance = errors(states, windows.truth)[:, at, 0]
    quantiles = np.array([np.nanquantile(d, (0.1, 0.5, 0.9), method="nearest") for d in distance.T])
    return Departure(name, len(states), at / RATE_HZ, gone[:, at].mean(axis=0), first, quantiles)


def divergence_study(models: Sequence[Simulator], windows: HeldOutWindows, box: SpeedBox) -> list[Departure]:
    """Divergence of each model on the same held-out runs."""
    return [departure(model.name, simulated(model, windows), windows, box) for model in models]


def divergence_table(departures: Sequence[Departure], horizons_s: Sequence[int] = (1, 5, 10, 20, 30, 60)) -> ScoreTable:
    """By horizon: median distance from the true position, and share of runs diverged by then."""
    rows = []
    for d in departures:
        cells = [
            f"{d.position_m[h - 1, 1]:.2f} m, {percent(d.diverged[h - 1])}" if h <= len(d.t_s) else "-"
            for h in horizons_s
        ]
        rows.append((d.name, *cells))
    return ScoreTable(("model", *(f"{h} s" for h in horizons_s)), tuple(rows))
