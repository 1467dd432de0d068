"""Decimation: inertial samples averaged over a few neighbours, down to a rate that suffices for a boat's motion.

The mean of n samples, d seconds apart, measures the mean of the motion over n d seconds. The thrust may change within
that time; fits average their model's thrust over the same instants (`around_s`), so that no delay arises. Delays that
the samples have already are taken out before (`on_time`). Columns that come at another rate have another n; the thrust
is averaged as specific force is, which shows it at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import lcm
from typing import NamedTuple

import numpy as np
import polars as pl

from companion.core.geometry.frames import wrapped
from companion.logs.runs.columns import HELD, INERTIAL
from companion.logs.runs.on_time import on_time
from companion.logs.runs.run import Run

RATE_HZ = 10.0  # yaw, the fastest motion, has a time constant of about 2 s
ALIKE = 0.2  # sampling times that differ by a smaller share are the same, up to jitter; assumed
FORCE = ("ax_m_s2", "ay_m_s2")
HOLE = 1.5  # a gap longer than this many sampling times ends a mean


class Decimated(NamedTuple):
    """A decimated log.

    run       the log with means in place of inertial samples
    width_s   time that a mean of specific force spans, or of the first column where none is known [s]; 0: no mean
    t_s       (m,) stamps of the means, and of samples of columns that were left as they are
    around_s  (m, n) offsets of the averaged samples from their mean's stamp [s], in order of time, each as often as
              fills n; 0 where a gap left fewer, and for samples that are no means
    """

    run: Run
    width_s: float
    t_s: np.ndarray
    around_s: np.ndarray


def decimated(run: Run, rate_hz: float = RATE_HZ) -> Decimated:
    """`run` with inertial columns averaged to about `rate_hz`; as it is where it has no faster ones."""
    run = on_time(run)
    # 1. Number of samples of each mean, by column.
    columns = [c for c in INERTIAL if run.known(c)]
    steps = _steps(run, columns)
    counts = {c: max(1, round(1 / (rate_hz * step))) if step > 0 else 1 for c, step in steps.items()}
    averaged = [c for c in columns if counts[c] > 1]
    if not averaged:
        return Decimated(run, 0.0, np.empty(0), np.empty((0, 1)))
    # 2. Means of every column, in rows of their own; where several are of one instant, offsets are those of force.
    means = {column: _means(run, column, counts[column]) for column in columns}
    force_first, n = sorted(columns, key=lambda c: c not in FORCE), lcm(*counts.values())
    t_s, first = np.unique(np.concatenate([means[c][0] for c in force_first]), return_index=True)
    around_s = np.concatenate([np.repeat(means[c][2], n // counts[c], axis=1) for c in force_first])[first]
    new = {column: np.full(len(t_s), np.nan) for column in averaged}
    for column in averaged:
        t, values, _ = means[column]
        new[column][np.searchsorted(t_s, t)] = values
    mine = pl.DataFrame({"t_s": t_s, **new}).fill_nan(None)
    # 3. Merged with the other columns; rows in which nothing is left are dropped.
    table = run.table.drop(averaged).join(mine, on="t_s", how="full", coalesce=True)
    held = [c for c in table.columns if c.startswith(HELD)]
    table = table.sort("t_s").with_columns(pl.col(held).forward_fill())
    fewer = Run(_bare(table, held).select(run.table.columns), run.meta, run.whole)
    count = counts[force_first[0]]
    return Decimated(fewer, count * steps[force_first[0]] if count > 1 else 0.0, t_s, around_s)


def _steps(run: Run, columns: Sequence[str]) -> dict[str, float]:
    """Sampling time of each column [s], the same for columns of about the same; 0: a single sample."""
    steps: dict[str, float] = {}
    for column in columns:
        between = np.diff(run.samples(column)[0])
        own = float(np.median(between)) if len(between) else 0.0
        steps[column] = next((step for step in steps.values() if abs(own - step) < ALIKE * step), own)
    return steps


def _means(run: Run, column: str, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (m,), means (m,) and offsets (m, count) as `Decimated.around_s`; headings are averaged unwrapped."""
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
        mean = wrapped(mean)
    return middle, mean, around


def _bare(table: pl.DataFrame, held: list[str]) -> pl.DataFrame:
    """The rows in which something is sampled or a held column changes."""
    sampled = [c for c in table.columns if c != "t_s" and c not in held]
    known = pl.any_horizontal(pl.col(sampled).is_not_null())
    changed = pl.any_horizontal([pl.col(c) != pl.col(c).shift(1) for c in held]) if held else pl.lit(False)
    return table.filter(known | changed.fill_null(True))
