"""Logs with fewer inertial samples: means of a few neighbours, which is all that a boat's motion needs.

A mean of n samples that are d apart is the motion's own mean over n d seconds. Thrust, the one thing that changes
within such a time, is averaged alike where it meets these samples (`thrust`, `diagnose.propelled`), so that no delay
comes in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import polars as pl

from companion.logs.runs.columns import HELD
from companion.logs.runs.run import Run

RATE_HZ = 10.0  # yaw, the fastest motion, has a time constant of about 2 s
GROUPED = ("psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2", "phi_rad", "theta_rad")
HOLE = 1.5  # times the usual time between samples: a mean does not reach across such a hole


class Decimated(NamedTuple):
    """A log with means for samples, the time that each spans [s] (0: as it was), and what they are means of.

    Means lie at `t_s` (m,); the samples of each so much away from it, `around_s` (m, n): in the middle where a hole has
    left fewer than n.
    """

    run: Run
    width_s: float
    t_s: np.ndarray
    around_s: np.ndarray


def decimated(run: Run, rate_hz: float = RATE_HZ) -> Decimated:
    """`run` with inertial columns averaged to about `rate_hz`."""
    as_it_is = Decimated(run, 0.0, np.empty(0), np.empty((0, 1)))
    columns = [c for c in GROUPED if run.known(c)]
    if not columns:
        return as_it_is
    stamps = run.samples(columns[0])[0]
    step = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    count = round(1 / (rate_hz * step)) if step > 0 else 1
    if count < 2:
        return as_it_is
    means = [_means(run, column, count) for column in columns]
    t_s, first = np.unique(np.concatenate([t for t, _, _ in means]), return_index=True)
    around_s = np.concatenate([around for _, _, around in means])[first]
    new = {column: np.full(len(t_s), np.nan) for column in columns}
    for column, (t, values, _) in zip(columns, means, strict=True):
        new[column][np.searchsorted(t_s, t)] = values
    mine = pl.DataFrame({"t_s": t_s, **new}).fill_nan(None)
    table = run.table.drop(columns).join(mine, on="t_s", how="full", coalesce=True)
    held = [c for c in table.columns if c.startswith(HELD)]
    table = table.sort("t_s").with_columns(pl.col(held).forward_fill())
    fewer = Run(_bare(table, held).select(run.table.columns), run.meta, run.whole)
    return Decimated(fewer, count * step, t_s, around_s)


def _means(run: Run, column: str, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps and values of the means, headings the short way round, and what is averaged, as `Decimated.around_s`."""
    t, values = run.samples(column)
    if column == "psi_rad":
        values = np.unwrap(values)
    gap = np.diff(t, prepend=t[0]) > HOLE * np.median(np.diff(t))
    since = np.arange(len(t)) - np.maximum.accumulate(np.where(gap, np.arange(len(t)), 0))
    group = np.cumsum((since % count == 0) | gap) - 1
    size = np.bincount(group)
    mean, middle = np.bincount(group, values) / size, np.bincount(group, t) / size
    around = np.zeros((len(size), count))
    around[group, since % count] = t - middle[group]
    if column == "psi_rad":
        mean = (mean + np.pi) % (2 * np.pi) - np.pi
    return middle, mean, around


def _bare(table: pl.DataFrame, held: list[str]) -> pl.DataFrame:
    """Without rows in which nothing is known that was not in force before."""
    sampled = [c for c in table.columns if c != "t_s" and c not in held]
    known = pl.any_horizontal(pl.col(sampled).is_not_null())
    changed = pl.any_horizontal([pl.col(c) != pl.col(c).shift(1) for c in held]) if held else pl.lit(False)
    return table.filter(known | changed.fill_null(True))
