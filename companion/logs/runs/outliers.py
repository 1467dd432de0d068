"""A few impossible values never lose a log: they are left blank, and told."""

from __future__ import annotations

import numpy as np
import polars as pl

from companion.logs.runs.columns import LIMITS
from companion.logs.runs.run import PAIRS, LogProblem

FEW = 0.01
"""Largest share of a column's values that are taken for slips; more are another unit, or another column; assumed."""


def without_outliers(table: pl.DataFrame) -> tuple[pl.DataFrame, list[LogProblem]]:
    """`table` with the values blank that are outside their column's limits, where they are few, and a note for each
    column that had any. The other of a pair of columns is blanked with it.
    """
    notes = []
    t_s = table["t_s"].to_numpy()
    for name in table.columns:
        limits = next((found for pattern, found in LIMITS if pattern.fullmatch(name)), None)
        if limits is None or not table[name].dtype.is_numeric():
            continue
        values = table[name].cast(pl.Float64).to_numpy()
        with np.errstate(invalid="ignore"):
            bad = (values < limits[0]) | (values > limits[1])
        if not 0 < bad.sum() <= FEW * np.isfinite(values).sum():
            continue
        first = int(bad.argmax())
        text = f"{name}: {int(bad.sum())} values outside {limits[0]:g} to {limits[1]:g}, {values[first]:g}; left blank"
        notes.append(LogProblem(kind="impossible", text=text, t_s=float(t_s[first]), length_s=0.0))
        table = blanked_where(table, name, bad)
    return table, notes


def blanked_where(table: pl.DataFrame, name: str, bad: np.ndarray) -> pl.DataFrame:
    """`table` with column `name`, and the other of its pair, blank in the rows where `bad` (n,) is true."""
    both = next((pair for pair in PAIRS if name in pair), (name,))
    keep = pl.Series(~bad)
    return table.with_columns(pl.when(keep).then(pl.col(one)).alias(one) for one in both if one in table.columns)
