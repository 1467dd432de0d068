"""Run: the common form of all logs, whatever their source. Reference of columns and clocks: docs/run-format.md.

A run is a table with one row per instant `t_s` at which something was logged, and metadata. Two kinds of columns:

    held      pwm_<thruster>, battery_v: in force from their own stamp until the next; they stand in every row
    sampled   all others: a value stands in the row of its own stamp and nowhere else (blank = null)

No value is interpolated, filtered or shifted.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import msgspec
import numpy as np
import polars as pl

from companion.core.configuration.imu_filters import FilteredColumn
from companion.logs.runs.columns import HELD, LIMITS, column_error, other_unit

PAIRS = (("north_m", "east_m"), ("V_w_m_s", "beta_w_deg"), ("true_north_m", "true_east_m"))


class RunError(ValueError):
    """A file is no valid run. The text names file, place in it, and reason."""


class LogProblem(msgspec.Struct, frozen=True, kw_only=True):
    """A problem in the data that a fit should know of. `length_s` 0: at one instant; both None: the whole run."""

    kind: str
    text: str
    t_s: float | None = None
    length_s: float | None = None


class RunMeta(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Metadata of a run.

    zero_ns        the source's own stamp at t_s = 0
    latency_s      age of a position at its stamp, not corrected in the table; None: unknown
    late_s         age of a column's samples at their stamps, by column, not corrected in the table; left out: unknown
    tag_arm_m      forward, starboard from the body origin to the tag, not corrected
    anchors_m      north, east, down by anchor
    pwm_limits_us  least and largest pulse width by thruster
    columns        source of a column, as text
    notes          problems that the reader met
    """

    vessel: str = "not stated"
    source: str = "not stated"
    zero_ns: int = 0
    clock: str = "not stated"
    site: str = "not stated"
    anchors_m: dict[str, tuple[float, float, float]] = {}
    latency_s: float | None = None
    late_s: dict[FilteredColumn, Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]] = {}
    tag_arm_m: tuple[float, float] | None = None
    pwm_limits_us: dict[str, tuple[float, float]] = {}
    columns: dict[str, str] = {}
    notes: tuple[LogProblem, ...] = ()


@dataclass(frozen=True)
class Run:
    """One log. `table`: float columns as in docs/run-format.md, `t_s` strictly increasing, no NaN.

    `of`: the log that this one is a part of, or was made from, on the same clock. Raises RunError where the table
    breaks the form.
    """

    table: pl.DataFrame
    meta: RunMeta = field(default_factory=RunMeta)
    of: Run | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        check(self.table, self.meta.source, lambda row: f"row {row}")

    @property
    def thrusters(self) -> tuple[str, ...]:
        """Names of the thrusters, in the order of the columns."""
        return tuple(c.removeprefix("pwm_") for c in self.table.columns if c.startswith("pwm_"))

    @property
    def whole(self) -> Run:
        """The log that this one is a part of, or this one."""
        return self.of or self

    @property
    def duration_s(self) -> float:
        """From the first row to the last [s]."""
        t_s = self.table["t_s"]
        return float(t_s[-1] - t_s[0]) if len(t_s) else 0.0

    @cached_property
    def data_hash(self) -> str:
        """SHA-256 of names, blanks and values: the same for the same data in whatever file."""
        digest = hashlib.sha256()
        for name in sorted(self.table.columns):
            column = self.table[name]
            digest.update(f"{name} {len(column)}\n".encode())
            digest.update(np.packbits(column.is_null().to_numpy()).tobytes())
            digest.update(column.fill_null(0.0).to_numpy().astype("<f8").tobytes())
        return digest.hexdigest()

    @property
    def sampled(self) -> list[str]:
        """Names of the sampled columns, in their order."""
        return [c for c in self.table.columns if c != "t_s" and not c.startswith(HELD)]

    def measured_s(self) -> np.ndarray:
        """Stamps of the rows in which anything sampled is known, shape (k,) [s]."""
        return self.table.filter(pl.any_horizontal(pl.col(self.sampled).is_not_null()))["t_s"].to_numpy()

    def samples(self, *columns: str) -> tuple[np.ndarray, np.ndarray]:
        """Stamps (n,) [s] and values of the rows in which all `columns` are known: (n,), or (n, k) for k > 1."""
        t_s, *values = (self.table[name].to_numpy() for name in ("t_s", *columns))
        known = np.ones(len(t_s), dtype=bool)
        for column in values:
            known &= ~np.isnan(column)  # a blank
        kept = [column[known] for column in values]
        return t_s[known], kept[0] if len(kept) == 1 else np.stack(kept, axis=1) if kept else np.empty((known.sum(), 0))

    def commands(self) -> tuple[np.ndarray, np.ndarray]:
        """When pulse widths changed [s], shape (k,), and to what [us], (k, thrusters): zero-order hold between."""
        names = [f"pwm_{name}" for name in self.thrusters]
        t_s, pwm_us = self.samples(*names)
        pwm_us = pwm_us.reshape(len(t_s), len(names))
        changed = np.ones(len(t_s), dtype=bool)
        changed[1:] = (np.diff(pwm_us, axis=0) != 0).any(axis=1)
        return t_s[changed], pwm_us[changed]

    def rates_hz(self) -> dict[str, float]:
        """Median rate of each sampled column that has two samples or more."""
        rates = {}
        for name in self.sampled:
            t_s, _ = self.samples(name)
            if len(t_s) > 1:
                rates[name] = 1.0 / float(np.median(np.diff(t_s)))
        return rates

    def known(self, column: str) -> bool:
        """Whether `column` holds any value."""
        return column in self.table.columns and self.table[column].null_count() < len(self.table)

    def with_notes(self, notes: Iterable[LogProblem]) -> Run:
        """The run with further notes of a reader."""
        return Run(self.table, msgspec.structs.replace(self.meta, notes=(*self.meta.notes, *notes)), self.of)


def check(table: pl.DataFrame, name: str, place: Callable[[int], str]) -> None:
    """Raise RunError where the table breaks the form, naming `name`, the column and `place(row)`, row 0-based."""
    if wrong := column_error(table.columns):
        raise RunError(f"{name}: {wrong}")
    if not table.height:
        raise RunError(f"{name}: no rows")
    for column in table.columns:
        if table[column].dtype != pl.Float64:
            raise RunError(f"{name}: column {column}: expected numbers, found {table[column].dtype}")
    t_s = table["t_s"].to_numpy()  # a blank becomes NaN here
    bad = ~np.isfinite(t_s)
    if bad.any():
        raise RunError(f"{name}: {place(int(bad.argmax()))}: t_s: every row needs a time")
    late = np.diff(t_s) <= 0
    if late.any():
        row = int(late.argmax()) + 1
        raise RunError(f"{name}: {place(row)}: t_s: {t_s[row]} follows {t_s[row - 1]}; time must increase")
    for column in table.columns:
        _check_limits(table[column], name, place)
    for one, other in PAIRS:
        if one in table.columns and other in table.columns:
            half = (table[one].is_null() != table[other].is_null()).to_numpy()
            if half.any():
                where = place(int(half.argmax()))
                raise RunError(f"{name}: {where}: {one}, {other}: one is there without the other")


def _check_limits(column: pl.Series, name: str, place: Callable[[int], str]) -> None:
    """Raise RunError for the first value of a column outside its limits, or not finite."""
    limits = next((found for pattern, found in LIMITS if pattern.fullmatch(column.name)), None)
    if limits is None:
        limits = (-np.inf, np.inf, "")
    low, high, hint = limits
    values = column.to_numpy()
    with np.errstate(invalid="ignore"):
        outside = ~column.is_null().to_numpy() & ~((values >= low) & (values <= high) & np.isfinite(values))
    if outside.any():
        row = int(outside.argmax())
        expected = f"expected {low:g} to {high:g}" + (f": {hint}" if hint else "")
        finite = values[np.isfinite(values)]
        if len(finite):
            expected += other_unit(column.name, float(finite.min()), float(finite.max()))
        raise RunError(f"{name}: {place(row)}: {column.name}: {values[row]:g}; {expected}")
