"""Outcomes as tables: figures in one that is the same whoever computed it, times and places in another."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import polars as pl

from sim.campaign.cases import Case
from sim.campaign.runners.job import CaseOutcome

RESULTS, TIMINGS, FAILED, REPORT = "results.parquet", "timings.parquet", "failed.json", "summary.html"


def results(cases: Sequence[Case], outcomes: Mapping[str, CaseOutcome]) -> pl.DataFrame:
    """A row for each case that has figures, by id: id, seed, what tells it from others, figures."""
    done = [case for case in cases if case.id in outcomes and not outcomes[case.id].error]
    shown = list(dict.fromkeys(key for case in cases for key in case.shown))
    names = list(dict.fromkeys(name for case in done for name in outcomes[case.id].figures))
    columns = {
        "case": _column([case.id for case in done], pl.String),
        "seed": _column([c.seed for c in done], pl.Int64),
    }
    columns |= {key: _column([case.shown.get(key) for case in done]) for key in shown}
    columns |= {name: _column([outcomes[case.id].figures.get(name) for case in done]) for name in names}
    return pl.DataFrame(columns)


def timings(cases: Sequence[Case], outcomes: Mapping[str, CaseOutcome]) -> pl.DataFrame:
    """Wall time of each case that was run, and who ran it."""
    ran = [outcomes[case.id] for case in cases if case.id in outcomes]
    return pl.DataFrame(
        {
            "case": _column([o.id for o in ran], pl.String),
            "seconds": _column([o.seconds for o in ran], pl.Float64),
            "worker": _column([o.worker for o in ran], pl.String),
        }
    )


def failures(cases: Sequence[Case], outcomes: Mapping[str, CaseOutcome]) -> list[tuple[Case, CaseOutcome]]:
    """Cases that ended in an error."""
    return [(case, outcomes[case.id]) for case in cases if case.id in outcomes and outcomes[case.id].error]


def outputs(cases: Sequence[Case], outcomes: Mapping[str, CaseOutcome]) -> dict[str, bytes]:
    """Bytes of the tables and of the list of failures, by file name."""
    failed = [
        {"case": case.id, "seed": case.seed, **case.shown, "error": outcome.error, "trace": outcome.trace.splitlines()}
        for case, outcome in failures(cases, outcomes)
    ]
    listed = msgspec.json.format(msgspec.json.encode(failed), indent=1) + b"\n"
    return {RESULTS: _parquet(results(cases, outcomes)), TIMINGS: _parquet(timings(cases, outcomes)), FAILED: listed}


def _column(values: Sequence[Any], kind: Any = None) -> pl.Series:
    """Whole numbers among fractions become fractions; a column without any value is one of numbers."""
    kinds = {type(v) for v in values if v is not None}
    if kind is None:
        kind = pl.Float64 if not kinds or kinds == {int, float} else None
    return pl.Series(values=values, dtype=kind, strict=False)


def _parquet(table: pl.DataFrame) -> bytes:
    buffer = io.BytesIO()
    table.write_parquet(buffer, compression="zstd")
    return buffer.getvalue()
