"""The whole records of a damaged dataflash log, for pymavlink: it drops all that follows a type that it does not know.

A record is A3 95, its type, and its body, without a checksum; how long it is, the FMT record of its type said before.
Source: ArduPilot, libraries/AP_Logger/LogStructure.h
"""

from __future__ import annotations

import mmap
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain, pairwise
from pathlib import Path

from companion.logs.runs.run import LogProblem

MAGIC = b"\xa3\x95"
_HEAD_BYTES, _FMT, _FMT_BYTES = 3, 0x80, 89
_TAIL_BYTES = 528
"""Of so many at the end pymavlink says nothing, nor does it lose a record before them (`DFReader_binary`)."""
_PADDING = re.compile(rb"\0*|\xff*")
"""Bytes of a file or a flash memory that nothing was written to."""


@contextmanager
def whole_records(path: Path, notes: list[LogProblem]) -> Iterator[Path]:
    """A log of the whole records in `path`, itself where all else is at its end; what was damaged is in `notes`.

    A last record that was cut off, and padding after it, are no damage: a power cut leaves them.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        found, lengths = _stretches(data)
        bounds = [0, *chain.from_iterable(found), len(data)]
        lost = [(begin, end) for begin, end in list(pairwise(bounds))[::2] if end > begin]
        needs_copy = found and any(end < len(data) or end - begin >= _TAIL_BYTES for begin, end in lost)
        if lost and lost[-1][1] == len(data) and _is_unwritten(data, lost[-1][0], lengths):
            lost.pop()
        if lost:
            size = sum(end - begin for begin, end in lost)
            text = f"{path.name}: {size} bytes passed over, the first at byte {lost[0][0]}"
            notes.append(LogProblem(kind="damaged", text=text))
        if not needs_copy:
            yield path
            return
        with tempfile.NamedTemporaryFile(prefix="aritra-", suffix=".BIN") as copy:
            for begin, end in found:
                copy.write(data[begin:end])
            copy.flush()
            yield Path(copy.name)


def _stretches(data: mmap.mmap) -> tuple[list[tuple[int, int]], list[int]]:
    """Begin and end of stretches in which one whole record follows another, and the bytes of a record by type.

    Where a record is followed by none, and another begins within it, it lacks bytes itself: it is left out.
    """
    lengths = [0] * 256
    lengths[_FMT] = _FMT_BYTES
    found: list[tuple[int, int]] = []
    begin = before = at = 0
    while at < len(data):
        if end := _end(data, at, lengths):
            if data[at + 2] == _FMT:
                lengths[data[at + 3]] = data[at + 4]
            before, at = at, end
            continue
        resumes = _next(data, before + 1, lengths)
        if resumes < at:
            at = before
            if data[at + 2] == _FMT:
                lengths[data[at + 3]] = 0  # pymavlink is not given it
        if at > begin:
            found.append((begin, at))
        begin = before = at = resumes
    if at > begin:
        found.append((begin, at))
    return found, lengths


def _end(data: mmap.mmap, at: int, lengths: list[int]) -> int:
    """Where the record at `at` ends; 0: none of a known type is there, or the file ends within it."""
    if data[at : at + 2] != MAGIC or at + _HEAD_BYTES > len(data):
        return 0
    end = at + lengths[data[at + 2]]
    return end if at + _HEAD_BYTES <= end <= len(data) else 0


def _next(data: mmap.mmap, at: int, lengths: list[int]) -> int:
    """The next record from `at` on that is followed by another, or by the end; else the end."""
    while (at := data.find(MAGIC, at)) >= 0:
        end = _end(data, at, lengths)
        if end and (data[end : end + 2] == MAGIC or end + _HEAD_BYTES > len(data)):
            return at
        at += 1
    return len(data)


def _is_unwritten(data: mmap.mmap, at: int, lengths: list[int]) -> bool:
    """Whether what stands from `at` to the end is padding, or a record that was cut off."""
    if _PADDING.fullmatch(data, at) or at + _HEAD_BYTES > len(data):
        return True
    return data[at : at + 2] == MAGIC and at + lengths[data[at + 2]] > len(data)
