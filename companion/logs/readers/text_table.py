"""Text of a CSV file as people and spreadsheet programs save it: comment lines, header, and the fields of its rows.

Separators are commas, semicolons or tabs. Lines that cannot be read are left out where they are few. What is unlike our
own files is stated in notes.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import polars as pl

from companion.core.configuration.file_kinds import UTF16_MARKS
from companion.logs.runs.columns import column_error
from companion.logs.runs.outliers import is_few
from companion.logs.runs.run import LogProblem, RunError
from companion.logs.unpack import most_bytes

SEPARATORS = {b",": "commas", b";": "semicolons", b"\t": "tabs"}
_STATED = re.compile(rb'"?sep=([,;\t])"?[,;\t\s]*', re.IGNORECASE)
"""Excel's first line, which says what is between the columns."""
_BLANK = b' \t\r",;'
"""All that stands in a blank line, or in a blank row of a spreadsheet."""
_BARE_KEY = re.compile(r'([{,]\s*)([^\s"{}\[\],:]+):')


@dataclass(frozen=True)
class TextTable:
    """Fields of a CSV file.

    table     a text column for each name of the header
    header    line of the header, 1-based
    lines     line of each row, 1-based, shape (rows,)
    comments  line and text of what begins with #
    notes     what was left out, or read in another way than our own files
    """

    name: str
    table: pl.DataFrame
    header: int
    lines: np.ndarray
    separator: str
    comments: Sequence[tuple[int, str]]
    notes: Sequence[LogProblem]

    def place(self, row: int) -> str:
        """Where a row (0-based) stands in the file."""
        return f"line {self.lines[row]}"


def text_table(path: Path) -> TextTable:
    """Fields of the CSV file `path`. RunError names the line where it has no header, or many lines are malformed."""
    # 1. Header, and what is between the columns.
    name, lines = str(path), csv_lines(path)
    stated = _STATED.fullmatch(lines[0])
    numbered = [(n, line) for n, line in enumerate(lines, 1) if line.strip(_BLANK) and not (stated and n == 1)]
    comments = [(n, line.decode(errors="replace").strip()) for n, line in numbered if _is_comment(line)]
    numbered = [(n, line) for n, line in numbered if not _is_comment(line)]
    if not numbered:
        raise RunError(f"{name}: line {len(lines)}: no header")
    header, line = numbered[0]
    mark = stated[1] if stated else next((mark for mark in SEPARATORS if mark in line), b",")
    columns = [c.strip() for c in line.decode(errors="replace").replace('"', "").split(mark.decode())]
    if _is_number(columns[0]):
        raise RunError(f"{name}: line {header}: no header: expected the names of the columns")
    if (wrong := column_error(columns) or "").endswith("is there twice"):
        raise RunError(f"{name}: line {header}: {wrong}")
    # 2. Rows: malformed lines are left out. Quotes go: no number has a separator in it.
    rows, notes = _rows(numbered[1:], mark, len(columns), name)
    data = b"".join(line + b"\n" for _, line in rows).replace(b'"', b"")
    decimal_commas = mark != b"," and b"," in data and b"." not in data
    if mark != b",":
        text = f"{SEPARATORS[mark]} between the columns" + (", decimal commas" if decimal_commas else "")
        notes.append(LogProblem(kind="read as", text=f"line {header}: {text}"))
    if decimal_commas:
        data = data.replace(b",", b".")
    table = pl.DataFrame({column: [] for column in columns}, schema=dict.fromkeys(columns, pl.String))
    if rows:
        table = pl.read_csv(
            io.BytesIO(data), has_header=False, new_columns=columns, infer_schema=False, quote_char=None,
            separator=mark.decode(),
        )  # fmt: skip
    return TextTable(name, table, header, np.array([n for n, _ in rows], dtype=int), mark.decode(), comments, notes)


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
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n")
    if b"\n" not in data:
        data = data.replace(b"\r", b"\n")  # so old Macs, and Excel's "CSV (Macintosh)", end lines
    return data.rstrip(b"\n").split(b"\n")


def metadata_in(text: TextTable) -> tuple[dict[str, Any], list[LogProblem]]:
    """Metadata among the comment lines, and notes on those that are none. RunError for a malformed one, or one twice.

    Without `aritra_run` among them all are comments: other programs write what they like after a #.
    """
    keys = [_key(line) for _, line in text.comments]
    ours = "aritra_run" in keys
    ignored = [n for (n, _), key in zip(text.comments, keys, strict=True) if not (ours and key)]
    notes, metadata = [], {}
    if ignored:
        hint = "" if ours else "; they are metadata only with '# aritra_run = 1' among them"
        why = f"line {ignored[0]}: {len(ignored)} lines that begin with # are comments, ignored{hint}"
        notes.append(LogProblem(kind="comments", text=why))
    for (number, line), key in zip(text.comments, keys, strict=True):
        if not (ours and key):
            continue
        if key in metadata:
            raise RunError(f"{text.name}: line {number}: {key}: is there twice")
        try:
            metadata[key] = _value(line, text.separator)
        except msgspec.DecodeError as error:
            if not line.startswith('"') and not line.endswith(text.separator):
                raise RunError(f"{text.name}: line {number}: {key}: {error}") from None
            what = f"line {number}: {key}: cannot be read as a spreadsheet program saved it; left out"
            notes.append(LogProblem(kind="edited", text=what))
    return metadata, notes


def _is_comment(line: bytes) -> bool:
    return line.lstrip(b' \t"').startswith(b"#")


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _rows(
    numbered: Sequence[tuple[int, bytes]], mark: bytes, columns: int, name: str
) -> tuple[list[tuple[int, bytes]], list[LogProblem]]:
    """Lines that are rows of `columns` fields, and notes on those left out. RunError names the first of many."""
    faults = [(n, fault) for n, line in numbered if (fault := _fault(line, mark, columns))]
    wrong = {n for n, _ in faults}
    rows = [(n, line) for n, line in numbered if n not in wrong]
    notes = []
    if faults and faults[-1][0] == numbered[-1][0] and numbered[-1][1].count(mark) <= columns - 1:
        number, fault = faults.pop()
        notes.append(LogProblem(kind="garbage", text=f"line {number}, the last: cut off ({fault}); left out"))
    if faults:
        number, fault = faults[0]
        if not is_few(len(faults), len(faults) + len(rows)):
            raise RunError(f"{name}: line {number}: {fault}")
        notes.append(LogProblem(kind="garbage", text=f"line {number}: {fault}; {len(faults)} such lines are left out"))
    return rows, notes


def _fault(line: bytes, mark: bytes, columns: int) -> str:
    """Why a line is no row of `columns` fields; empty where it is one."""
    if b'"' in line and any(mark in part for part in line.split(b'"')[1::2]):
        return f"a quoted field with a separator in it: write decimal points, or {SEPARATORS[b';']} between the columns"
    if (fields := line.count(mark) + 1) != columns:
        between = "" if mark == b"," else f", with {SEPARATORS[mark]} between them"
        return f"{fields} fields; the header has {columns}{between}"
    try:
        line.decode()
    except UnicodeDecodeError:
        return "is not UTF-8 text"
    return ""


def _key(line: str) -> str:
    """Name before the = of a comment line; empty where it has none."""
    key, equals, _ = line.lstrip('"# \t').partition("=")
    return key.strip() if equals else ""


def _value(line: str, separator: str) -> Any:
    """JSON after the = of a metadata line. Raises msgspec.DecodeError where no version of the line has it."""
    error = msgspec.DecodeError("no value")
    for version in _versions(line, separator):
        try:
            return msgspec.json.decode(version.partition("=")[2].strip())
        except msgspec.DecodeError as found:
            error = found
    raise error


def _versions(line: str, separator: str) -> Iterator[str]:
    """A comment line as it stands, and as it was before a spreadsheet program quoted it and padded it with blank cells.

    Such a program takes the quotes of a cell that begins with one: so keys of JSON, from the second on, lose them.
    """
    yield line
    try:
        cells = next(csv.reader([line], delimiter=separator))
    except csv.Error:
        return
    joined = separator.join(cells).rstrip(separator + " ")
    yield joined
    yield _BARE_KEY.sub(r'\1"\2":', joined)
