"""Runs as CSV and Parquet files, which are read back bit for bit.

CSV: lines `# key = JSON` with the metadata, a header, then numbers in shortest round-trip form; blank: unknown.
Parquet: the same metadata as JSON under `aritra_run`. Both hold a hash of the data; a run whose data has been edited
since gets a note. A CSV without metadata lines is valid too. `.gz` is unpacked.
"""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import polars as pl

from companion.core.configuration.file_kinds import UTF16_MARKS
from companion.logs.runs.columns import column_error
from companion.logs.runs.outliers import blanked_where, without_outliers
from companion.logs.runs.run import LogProblem, Run, RunError, RunMeta, check
from companion.logs.unpack import most_bytes

FORMAT = 1
MOST_CELLS = 250_000_000
"""Numbers in a Parquet file, which may take no room there: 2 GB in memory, a day at 50 Hz; assumed."""
_PARQUET_KEY = "aritra_run"


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
    return _run(table, metadata, str(path), lambda row: f"row {row}")


def read_csv(path: Path) -> Run:
    """Run of a CSV file. Raises RunError naming file, line and column, OSError."""
    lines = csv_lines(path)
    metadata: dict[str, Any] = {}
    first = 0
    while first < len(lines) and lines[first].startswith(b"#"):
        key, equals, value = lines[first][1:].decode(errors="replace").partition("=")
        name = key.strip()
        if name in metadata:
            raise RunError(f"{path}: line {first + 1}: {name}: is there twice")
        if equals:
            metadata[name] = _json(value, f"{path}: line {first + 1}: {name}")
        first += 1
    texts = text_columns(lines, first, str(path))
    if wrong := column_error(texts.columns):
        raise RunError(f"{path}: line {first + 1}: {wrong}")
    table = numbers(texts, str(path), first + 2)
    return _run(table, metadata, str(path), lambda row: f"line {row + first + 2}")


def csv_lines(path: Path) -> list[bytes]:
    """Lines of a text file, unpacked where its name ends in .gz, without line ends and blank lines at the end."""
    if path.suffix.lower() == ".gz":
        most = most_bytes(path.stat().st_size)
        try:
            with gzip.open(path) as file:
                data = file.read(most + 1)
        except (OSError, EOFError, zlib.error) as error:
            raise RunError(f"{path}: cannot be unpacked: {error}") from None
        if len(data) > most:
            raise RunError(f"{path}: unpacks to more than {most / 1e6:.4g} MB, 100 times its size: unpack it yourself")
    else:
        data = path.read_bytes()
    if data.startswith(UTF16_MARKS):
        raise RunError(f"{path}: is UTF-16 text: save it as UTF-8, which spreadsheets call CSV UTF-8")
    lines = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").rstrip(b"\n").split(b"\n")
    return lines


def text_columns(lines: list[bytes], header: int, name: str) -> pl.DataFrame:
    """Fields, as text, of the table whose header is line `header` (0-based). RunError for a line of another length."""
    if header >= len(lines) or not lines[header].strip():
        raise RunError(f"{name}: line {header + 1}: no header")
    for mark, what in ((b";", "semicolons"), (b"\t", "tabs")):
        if mark in lines[header] and b"," not in lines[header]:
            raise RunError(
                f"{name}: line {header + 1}: {what} between the columns; expected commas, and decimal points"
            )
    columns = [c.strip().strip('"') for c in lines[header].decode(errors="replace").split(",")]
    commas = len(columns) - 1
    for number, line in enumerate(lines[header + 1 :], header + 2):
        if line.count(b",") != commas:
            raise RunError(f"{name}: line {number}: {line.count(b',') + 1} fields; the header has {commas + 1}")
        if not _is_text(line):
            raise RunError(f"{name}: line {number}: is not UTF-8 text")
    duplicate = column_error(columns) or ""
    if duplicate.endswith("is there twice"):
        raise RunError(f"{name}: line {header + 1}: {duplicate}")
    if len(lines) == header + 1:
        return pl.DataFrame({column: [] for column in columns}, schema=dict.fromkeys(columns, pl.String))
    body = io.BytesIO(b"\n".join(lines[header + 1 :]) + b"\n")
    table = pl.read_csv(body, has_header=False, new_columns=columns, infer_schema=False, quote_char=None)
    return table


def _is_text(line: bytes) -> bool:
    try:
        line.decode()
    except UnicodeDecodeError:
        return False
    return True


def numbers(texts: pl.DataFrame, name: str, first_line: int) -> pl.DataFrame:
    """Texts as numbers; blank becomes null. RunError names line and column of a text that is no number."""
    columns = {}
    for column in texts.columns:
        text = texts[column].str.strip_chars().replace("", None)
        values = text.cast(pl.Float64, strict=False)
        wrong = (values.is_null() & text.is_not_null()).to_numpy()
        if wrong.any():
            row = int(wrong.argmax())
            raise RunError(f"{name}: line {row + first_line}: {column}: {text[row]!r} is not a number")
        columns[column] = values
    return pl.DataFrame(columns)


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


def _run(table: pl.DataFrame, metadata: Mapping[str, Any], name: str, place: Any) -> Run:
    """The run of a table and its metadata as read; RunError for another format version or unknown metadata."""
    fields = dict(metadata)
    stated, version = fields.pop("data_hash", None), fields.pop("aritra_run", FORMAT)
    if version != FORMAT:
        raise RunError(f"{name}: aritra_run = {version}: this program reads {FORMAT}")
    try:
        meta = msgspec.convert(fields, RunMeta)
    except msgspec.ValidationError as error:
        raise RunError(f"{name}: metadata: {error}") from None
    for column, dtype in table.schema.items():
        if not dtype.is_numeric():
            raise RunError(f"{name}: column {column}: expected numbers, found {dtype}")
    table, notes = blanked(table)
    table, slips = without_outliers(table)
    notes += slips
    check(table, name, place)
    run = Run(table, meta if "source" in fields else msgspec.structs.replace(meta, source=name))
    if stated not in (None, run.data_hash):
        notes.append(LogProblem(kind="edited", text=f"{name}: the data is not what was written with its hash"))
    return run.with_notes(notes) if notes else run


def _json(text: str, where: str) -> Any:
    try:
        return msgspec.json.decode(text.strip())
    except msgspec.DecodeError as error:
        raise RunError(f"{where}: {error}") from None
