"""Values that stand in a log but say nothing: left out of a fit as if they were blank, and noted."""

from __future__ import annotations

from collections.abc import Collection

import polars as pl

from companion.core.constants import pack_range
from companion.logs.runs.columns import INERTIAL
from companion.logs.runs.problems import held_rows
from companion.logs.runs.run import LogProblem, Run

DEAD_SENSOR, HELD_READINGS = "dead sensor", "held readings"
"""Kinds of problems: columns are left out that no sensor wrote; readings are used where they were new."""


def without_dead_columns(run: Run, dead: Collection[str]) -> Run:
    """`run` without `dead`, columns that hold one value throughout, such as zeros for an IMU that is not there."""
    if not dead:
        return run
    text = f"{', '.join(dead)}: the same value in every sample, which no sensor gives: left out, as if blank"
    blank = run.table.with_columns(pl.lit(None, pl.Float64).alias(column) for column in dead)
    return Run(blank, run.meta, run.of).with_notes([LogProblem(kind=DEAD_SENSOR, text=text)])


def without_absurd_voltages(run: Run, nominal_v: float) -> Run:
    """`run` without voltages that a pack of `nominal_v` [V] cannot have, as the boat's battery monitor takes them: 0 V
    for none.
    """
    least_v, most_v = pack_range(nominal_v)
    seen = run.table["battery_v"]
    absurd = ~seen.is_between(least_v, most_v)  # null stays null
    count = int(absurd.sum())
    if not count:
        return run
    text = (
        f"battery_v: {count} of {seen.count()} samples (the first {seen.filter(absurd)[0]:g} V) are none of a pack of "
        f"{nominal_v:g} V: left out, as if blank"
    )
    blank = pl.when(absurd).then(None).otherwise(seen).alias("battery_v")
    return Run(run.table.with_columns(blank), run.meta, run.of).with_notes([LogProblem(kind=DEAD_SENSOR, text=text)])


def without_held_readings(run: Run) -> Run:
    """`run` with each reading where it was new: those that are only written again are late by up to a period."""
    sensors = (("north_m", "east_m"), *((name,) for name in INERTIAL if run.known(name)))
    again = {names: rows for names in sensors if (rows := held_rows(run, *names)).any()}
    if not again:
        return run
    shares = ", ".join(f"{', '.join(names)}: {100 * rows.mean():.0f} %" for names, rows in again.items())
    text = f"{shares} of the rows repeat the reading before, held until the next: each is used where it was new"
    blank = (
        pl.when(pl.Series(rows)).then(None).otherwise(pl.col(name)).alias(name)
        for names, rows in again.items()
        for name in names
    )
    return Run(run.table.with_columns(blank), run.meta, run.of).with_notes([LogProblem(kind=HELD_READINGS, text=text)])
