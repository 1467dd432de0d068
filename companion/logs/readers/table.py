"""Runs as CSV and Parquet files, which are read back bit for bit.

CSV: lines `# key = JSON` with the metadata, a header, then numbers in shortest round-trip form; blank: unknown.
Parquet: the same metadata as JSON under `aritra_run`. Both hold a hash of the data; a run whose data has been edited
since gets a note. A CSV without metadata lines is valid too. `.gz` is unpacked. A few bad rows, or values that are no
numbers, are left out or left blank, with a note.
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import polars as pl

from companion.logs.readers.text_table import metadata_in, text_table
from companion.logs.runs.columns import column_error
from companion.logs.runs.outliers import (
    blanked_where,
    is_few,
    sound_rows,
    without_halves,
    without_outliers,
    wrapped_headings,
)
from companion.logs.runs.run import LogProblem, Run, RunError, RunMeta, check

FORMAT = 1
MOST_CELLS = 250_000_000
"""Numbers in a Parquet file, which may take no room there: 2 GB in memory, a day at 50 Hz; assumed."""
_PARQUET_KEY = "aritra_run"
_BLANK_WORDS = ("na", "n/a", "none", "null", "-")
"""What other programs write for a value that is not known, in small letters."""
_DATE = re.compile(r"\d{4}-\d\d?-\d\d?.*|\d\d?[./]\d\d?[./]\d{2,4}.*|\d\d?:\d\d.*")
_DATES = (
    ": seconds are needed, counted from any instant: in Python, datetime.fromisoformat(text).timestamp() of an ISO date"
)


def write_run(run: Run, path: Path) -> None:
    """Write `run` to `path` (.csv, .csv.gz or .parquet by its name). Raises RunError, OSError."""
    head = {"aritra_run": FORMAT, "data_hash": run.data_hash, **msgspec.to_builtins(run.meta)}
    if not run.meta.late_s:
        del head["late_s"]  # older programs refuse what they do not know
    if path.suffix == ".parquet":
        run.table.write_parquet(path, metadata={_PARQUET_KEY: msgspec.json.encode(head).decode()})
    elif path.name.endswith((".csv", ".csv.gz")):
        lines = [f"# {key} = {msgspec.json.encode(value).decode()}\n" for key, value in head.items()]
        data = ("".join(lines) + run.table.write_csv()).encode()
        path.write_bytes(gzip.compress(data, 6, mtime=0) if path.suffix == ".gz" else data)
    else:
        raise RunError(f"{path}: a run is written as .csv, .csv.gz or .parquet")


def read_parquet(path: Path) -> Run:
    """Run of a Parquet file. Raises RunError naming file, row and column, OSError."""
    try:
        cells = int(pl.scan_parquet(path).select(pl.len()).collect().item()) * len(pl.read_parquet_schema(path))
        if cells > MOST_CELLS:
            raise RunError(f"{path}: {cells} numbers; expected at most {MOST_CELLS}: divide the log")
        table = pl.read_parquet(path)
        head = pl.read_parquet_metadata(path).get(_PARQUET_KEY, "{}")
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:  # it panics over some damaged footers
        raise RunError(f"{path}: not a Parquet file: {error}") from None
    try:
        metadata = msgspec.json.decode(head, type=dict[str, Any])
    except msgspec.DecodeError as error:
        raise RunError(f"{path}: metadata {_PARQUET_KEY}: {error}") from None
    if wrong := column_error(table.columns):
        raise RunError(f"{path}: {wrong}")
    return _run(table, metadata, str(path), lambda row: f"row {row}", [])


def read_csv(path: Path) -> Run:
    """Run of a CSV file. Raises RunError naming file, line and column, OSError."""
    text = text_table(path)
    metadata, notes = metadata_in(text)
    if wrong := column_error(text.table.columns):
        raise RunError(f"{path}: line {text.header}: {wrong}")
    return _run(text.table, metadata, str(path), text.place, [*text.notes, *notes])


def numbers(table: pl.DataFrame, name: str, place: Callable[[int], str]) -> tuple[pl.DataFrame, list[LogProblem]]:
    """`table` with its texts, and columns that are blank throughout, as numbers; and notes.

    A few texts that are no numbers become blank, with the other of a pair. RunError names place and column of the first
    of many.
    """
    texts = [column for column in table.columns if table[column].dtype == pl.String]
    empty = [column for column in table.columns if table[column].dtype == pl.Null]
    out, wrong, blanks = table.with_columns(pl.col(empty).cast(pl.Float64)), {}, []
    for column in texts:
        text = table[column].str.strip_chars().replace("", None)
        values, blank, bad = _parsed(text)
        blanks += [(int(row), column, int(blank.sum())) for row in np.flatnonzero(blank)[:1]]
        if bad.any():
            row, count = int(bad.argmax()), int(bad.sum())
            what = f"{place(row)}: {column}: {text[row]!r} is not a number"
            if not is_few(count, len(text) - text.null_count() - int(blank.sum())):
                raise RunError(f"{name}: {what}" + (_DATES if column == "t_s" and _DATE.fullmatch(text[row]) else ""))
            wrong[column] = bad, f"{what}; {count} such values, left blank"
        out = out.with_columns(values.alias(column))
    notes = []
    if blanks:
        row, column, _ = min(blanks, key=lambda blank: blank[0])
        count = sum(count for *_, count in blanks)
        what = f"{place(row)}: {column}: {table[column][row]!r} is read as blank; {count} such fields"
        notes.append(LogProblem(kind="read as", text=what))
    wrong.pop("t_s", None)  # its row is left out, which has a note of its own
    for column, (bad, what) in wrong.items():
        notes.append(LogProblem(kind="not a number", text=what))
        out = blanked_where(out, column, bad)
    return out, notes


def _parsed(text: pl.Series) -> tuple[pl.Series, np.ndarray, np.ndarray]:
    """Texts as numbers, and masks (rows,): which are words for a blank, and which are no numbers."""
    values = text.cast(pl.Float64, strict=False)
    odd = (values.is_null() & text.is_not_null()).to_numpy()
    blank = odd & text.str.to_lowercase().is_in(_BLANK_WORDS).fill_null(value=False).to_numpy()
    return values, blank, odd & ~blank


def blanked(table: pl.DataFrame) -> tuple[pl.DataFrame, list[LogProblem]]:
    """The table with NaN and infinity blank, with the other of a pair; and a note for each column that had any."""
    notes, given = [], table.cast(pl.Float64)
    table, t_s = given, given["t_s"].to_numpy()
    for column in given.columns:
        bad = ~np.isfinite(given[column].to_numpy()) & ~given[column].is_null().to_numpy()
        if column != "t_s" and bad.any():
            text = f"{column}: {int(bad.sum())} values are NaN or infinite; left blank"
            notes.append(LogProblem(kind="not a number", text=text, t_s=float(t_s[bad.argmax()]), length_s=0.0))
            table = blanked_where(table, column, bad)
    return table, notes


def _run(
    table: pl.DataFrame,
    metadata: Mapping[str, Any],
    name: str,
    place: Callable[[int], str],
    notes: list[LogProblem],
) -> Run:
    """The run of a table and its metadata as read; RunError for another format version or unknown metadata."""
    # 1. Metadata.
    fields = dict(metadata)
    stated, version = fields.pop("data_hash", None), fields.pop("aritra_run", FORMAT)
    if version != FORMAT:
        raise RunError(f"{name}: aritra_run = {version}: this program reads {FORMAT}")
    try:
        meta = msgspec.convert(fields, RunMeta)
    except msgspec.ValidationError as error:
        raise RunError(f"{name}: metadata: {error}") from None
    # 2. Numbers, in rows whose times increase.
    table, found = numbers(table, name, place)
    notes = [*notes, *found]
    for column, dtype in table.schema.items():
        if not dtype.is_numeric():
            remedy = _DATES if column == "t_s" and dtype.is_temporal() else ""
            raise RunError(f"{name}: column {column}: expected numbers, found {dtype}{remedy}")
    keep, found = sound_rows(table["t_s"].to_numpy(), place)
    notes += found
    rows, table = np.flatnonzero(keep), table.filter(pl.Series(keep))

    def kept_place(row: int) -> str:
        return place(int(rows[row]))

    # 3. Values that can be none of their column.
    table, found = blanked(table)
    notes += found
    for clean in (wrapped_headings, without_outliers):
        table, found = clean(table)
        notes += found
    table, found = without_halves(table, kept_place)
    notes += found
    check(table, name, kept_place)
    run = Run(table, meta if "source" in fields else msgspec.structs.replace(meta, source=name))
    if stated not in (None, run.data_hash):
        notes.append(LogProblem(kind="edited", text=f"{name}: the data is not what was written with its hash"))
    return run.with_notes(notes) if notes else run
