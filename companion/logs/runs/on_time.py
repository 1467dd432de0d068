"""A run whose inertial samples stand where they belong: earlier than their stamps by what filters made them late.

Rows of specific force move by its delay (of yaw rate, where no force was logged). What else stands in these rows with
another delay, heading and tilt without any, is interpolated to their new instants between its own samples: it turns
slowly, while force jumps with every command. So one row stays one row, and a fit needs no more steps.
"""

from __future__ import annotations

import numpy as np
import polars as pl
from msgspec.structs import replace

from companion.core.configuration.imu_filters import FILTERS
from companion.core.geometry.frames import wrapped
from companion.logs.runs.columns import HELD, INERTIAL
from companion.logs.runs.run import Run
from companion.logs.runs.unwrap import unwrapped


def on_time(run: Run) -> Run:
    """`run` with `meta.late_s` taken out of stamps, and none left; the run itself where nothing is late."""
    late_s = {c: s for c, s in run.meta.late_s.items() if s and run.known(c)}
    if not late_s:
        return run
    lead_s = next(late_s[c] for c in ("ax_m_s2", "ay_m_s2", *late_s) if c in late_s)
    # 1. The rows that move, and what of them moves along.
    table = run.table
    moves = pl.any_horizontal(pl.col(c).is_not_null() for c in FILTERS)
    columns = [c for c in INERTIAL if run.known(c)]
    moved = table.filter(moves).select("t_s", *columns).with_columns(pl.col("t_s") - lead_s)
    t_s = moved["t_s"].to_numpy()
    others = [c for c in columns if late_s.get(c, 0.0) != lead_s]
    new = {c: pl.Series(_at(run, c, late_s.get(c, 0.0), t_s, moved[c].is_null().to_numpy())) for c in others}
    moved = moved.with_columns(**new).fill_nan(None)
    # 2. All else stays at its stamp.
    stays = table.with_columns(pl.when(moves).then(None).otherwise(pl.col(c)).alias(c) for c in columns)
    both = pl.concat([stays, moved], how="diagonal").group_by("t_s").agg(pl.all().drop_nulls().first()).sort("t_s")
    held = [c for c in table.columns if c.startswith(HELD)]
    both = both.with_columns(pl.col(held).forward_fill().backward_fill()).select(table.columns)
    return Run(both, replace(run.meta, late_s={}), run.whole)


def _at(run: Run, column: str, late_s: float, t_s: np.ndarray, blank: np.ndarray) -> np.ndarray:
    """Values (k,) of a column at `t_s`, between samples `late_s` earlier; NaN where `blank`, or beyond its ends."""
    stamps, values = unwrapped(run) if column == "psi_rad" else run.samples(column)
    at = np.interp(t_s, stamps - late_s, values, left=np.nan, right=np.nan)
    at = wrapped(at) if column == "psi_rad" else at
    return np.where(blank, np.nan, at)
