"""A few bad rows or impossible values never lose a log: they are left out, or left blank, and stated in notes."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable

import numpy as np
import polars as pl

from companion.logs.runs.columns import LIMITS, MOST_ANGLE_RAD
from companion.logs.runs.run import PAIRS, LogProblem

FEW, LEAST = 0.01, 10
"""Largest share of a column's values, or of the rows, that are taken for slips; more are another unit, or another
column. A single one is a slip among `LEAST` already: some channels come once a second. Both assumed."""


def is_few(bad: int, of: int) -> bool:
    """Whether `bad` of so many values, or rows, may be slips."""
    return bad <= FEW * of or (bad == 1 and of >= LEAST)


def sound_rows(t_s: np.ndarray, place: Callable[[int], str]) -> tuple[np.ndarray, list[LogProblem]]:
    """Mask (n,) of the rows whose stamps `t_s` (n,) [s] are there and increase, and notes on the others.

    Others are left out where they are few; where they are many they stay, and `check` refuses the table.
    """
    notes = []
    keep = np.isfinite(t_s)
    if not keep.all():
        blank = int((~keep).sum())
        if not is_few(blank, len(t_s)):
            return np.ones(len(t_s), dtype=bool), []
        text = f"{place(int((~keep).argmax()))}: t_s: no time; {blank} such rows are left out"
        notes.append(LogProblem(kind="garbage", text=text))
    rows = np.flatnonzero(keep)
    ordered = _increasing(t_s[rows])
    if not is_few(int((~ordered).sum()), len(t_s)):
        return keep, notes
    keep[rows[~ordered]] = False
    again = ~ordered & np.isin(t_s[rows], t_s[keep])
    for kind, which, what in (
        ("duplicate", again, "is there twice; the first row is kept"),
        ("out of order", ~ordered & ~again, "does not lie between the times of the rows around it"),
    ):
        if which.any():
            first = int(rows[which.argmax()])
            text = f"{place(first)}: t_s: {t_s[first]} {what}; {int(which.sum())} such rows are left out"
            notes.append(LogProblem(kind=kind, text=text, t_s=float(t_s[first]), length_s=0.0))
    return keep, notes


def _increasing(t_s: np.ndarray) -> np.ndarray:
    """Mask (n,) of the most stamps that increase; of equal ones the first. (Longest increasing subsequence.)"""
    if (np.diff(t_s) > 0).all():
        return np.ones(len(t_s), dtype=bool)
    ends: list[float] = []  # the least stamp at which a sequence of length 1, 2, ... ends
    last: list[int] = []  # its row
    before: list[int] = []  # of each row: the one before it in the sequence that it ends
    for row, t in enumerate(t_s.tolist()):
        length = bisect_left(ends, t)
        before.append(last[length - 1] if length else -1)
        if length == len(ends) or ends[length] > t:
            ends[length : length + 1], last[length : length + 1] = [t], [row]
    kept = np.zeros(len(t_s), dtype=bool)
    row = last[-1] if last else -1
    while row >= 0:
        kept[row] = True
        row = before[row]
    return kept


def without_halves(table: pl.DataFrame, place: Callable[[int], str]) -> tuple[pl.DataFrame, list[LogProblem]]:
    """`table` without values of a pair of columns that stand alone, where they are few, and a note for each pair."""
    notes = []
    for one, other in PAIRS:
        if one not in table.columns or other not in table.columns:
            continue
        blank = table.select(one, other).to_numpy()
        blank = np.isnan(blank)
        half = blank[:, 0] != blank[:, 1]
        if half.any() and is_few(int(half.sum()), int((~blank).any(axis=1).sum())):
            row = int(half.argmax())
            text = f"{place(row)}: {one}, {other}: one without the other; {int(half.sum())} such rows, left blank"
            notes.append(LogProblem(kind="not a number", text=text, t_s=float(table["t_s"][row]), length_s=0.0))
            table = blanked_where(table, one, half)
    return table, notes


def wrapped_headings(table: pl.DataFrame) -> tuple[pl.DataFrame, list[LogProblem]]:
    """`table` with headings of 0 to 2 pi wrapped to -pi..pi, and a note for each column of them."""
    notes = []
    for name in (name for name in ("psi_rad", "true_psi_rad") if name in table.columns):
        psi_rad = table[name].to_numpy()
        with np.errstate(invalid="ignore"):
            turned = (psi_rad > MOST_ANGLE_RAD) & (psi_rad <= MOST_ANGLE_RAD + np.pi)
            other = (psi_rad < 0.0) | (psi_rad > MOST_ANGLE_RAD + np.pi)
        if turned.any() and is_few(int(other.sum()), int(np.isfinite(psi_rad).sum())):
            notes.append(LogProblem(kind="read as", text=f"{name}: 0 to 2 pi; wrapped to -pi..pi"))
            wrapped = pl.Series(np.where(turned, psi_rad - 2 * np.pi, psi_rad))
            table = table.with_columns(wrapped.fill_nan(None).alias(name))
    return table, notes


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
        if not bad.any() or not is_few(int(bad.sum()), int(np.isfinite(values).sum())):
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
