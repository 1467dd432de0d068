"""Logs with fewer inertial samples: means of a few neighbours, which is all that a boat's motion needs.

A mean of n samples that are d apart is the motion's own mean over n d seconds. Thrust, the one thing that changes
within such a time, is averaged alike where it meets these samples (`Physics.forces`), so that no delay comes in.
"""

from __future__ import annotations

import numpy as np
import polars as pl

from sim.identify.run import Run
from sim.identify.run_columns import HELD

RATE_HZ = 10.0  # yaw, the fastest motion, has a time constant of about 2 s
GROUPED = ("psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2", "phi_rad", "theta_rad")
HOLE = 1.5  # times the usual time between samples: a mean does not reach across such a hole


def thinned(run: Run, rate_hz: float = RATE_HZ) -> tuple[Run, float]:
    """`run` with inertial columns averaged to about `rate_hz`, and the width of the means [s] (0: as it was)."""
    columns = [c for c in GROUPED if run.known(c)]
    if not columns:
        return run, 0.0
    stamps = run.samples(columns[0])[0]
    step = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    count = round(1 / (rate_hz * step)) if step > 0 else 1
    if count < 2:
        return run, 0.0
    means = [_means(run, column, count) for column in columns]
    table = run.table.drop(columns)
    for column, (t, values) in zip(columns, means, strict=True):
        mine = pl.DataFrame({"t_s": t, column: values})
        table = table.join(mine, on="t_s", how="full", coalesce=True)
    held = [c for c in table.columns if c.startswith(HELD)]
    table = table.sort("t_s").with_columns(pl.col(held).forward_fill())
    return Run(_bare(table, held).select(run.table.columns), run.meta), count * step


def _means(run: Run, column: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and values of the means; headings the short way round."""
    t, values = run.samples(column)
    if column == "psi_rad":
        values = np.unwrap(values)
    gap = np.diff(t, prepend=t[0]) > HOLE * np.median(np.diff(t))
    since = np.arange(len(t)) - np.maximum.accumulate(np.where(gap, np.arange(len(t)), 0))
    group = np.cumsum((since % count == 0) | gap) - 1
    size = np.bincount(group)
    mean = np.bincount(group, values) / size
    if column == "psi_rad":
        mean = (mean + np.pi) % (2 * np.pi) - np.pi
    return np.bincount(group, t) / size, mean


def _bare(table: pl.DataFrame, held: list[str]) -> pl.DataFrame:
    """Without rows in which nothing is known that was not in force before."""
    sampled = [c for c in table.columns if c != "t_s" and c not in held]
    known = pl.any_horizontal(pl.col(sampled).is_not_null())
    changed = pl.any_horizontal([pl.col(c) != pl.col(c).shift(1) for c in held]) if held else pl.lit(False)
    return table.filter(known | changed.fill_null(True))
