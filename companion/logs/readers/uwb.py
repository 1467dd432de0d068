"""UWB measurements as streams of a run: from messages, from a separate Aritra log, or from a text log.

A text log has one record a line: the host's stamp (Unix seconds, or ISO 8601 with its offset), white space or a comma,
and the line as the tag sent it, which is decoded by the codec of its wire format.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from companion.core.configuration.site_file import Site
from companion.core.messages import Message, UwbPosition, UwbRanges
from companion.logs.log_file import LogFile
from companion.logs.readers.join import Stream
from companion.logs.readers.positions import cycle_fixes
from companion.logs.readers.text_table import csv_lines
from companion.logs.runs.run import LogProblem, RunError
from drivers.uwb import uwb_codec

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_STAMPED = re.compile(rb"\s*(\S+?)(?:\s*,\s*|\s+)(.+)")
_LATEST_NS = 4_102_444_800_000_000_000
"""The year 2100: a later stamp is damaged, or not in seconds; assumed."""


@dataclass(frozen=True)
class UwbLog:
    """Streams of a UWB log, source of its columns as text, and notes on problems."""

    streams: list[Stream]
    columns: dict[str, str]
    notes: tuple[LogProblem, ...] = ()


def uwb_streams(
    messages: Iterable[Message], site: Site | None, tag_down_m: float, *, outside: bool = False
) -> tuple[list[Stream], dict[str, str]]:
    """Streams of positions and ranges of one tag, and the source of the positions as text, by column.

    The tag's own positions (x east, y north) where it sends any; else one position from each cycle of ranges.
    """
    positions: list[tuple[float, ...]] = []
    cycles: list[UwbRanges] = []
    for message in messages:
        if isinstance(message, UwbPosition):
            positions.append((message.t_ns, message.y_m, message.x_m))
        elif isinstance(message, UwbRanges):
            cycles.append(message)
    names = sorted({r.anchor for cycle in cycles for r in cycle.ranges})
    ranges = {name: np.full(len(cycles), np.nan) for name in names}
    for row, cycle in enumerate(cycles):
        for r in cycle.ranges:
            ranges[r.anchor][row] = r.range_m
    t_ns = np.array([cycle.t_ns for cycle in cycles], dtype=np.int64)
    streams = [Stream("UWB ranges", t_ns, {f"range_{_word(k)}_m": v for k, v in ranges.items()}, outside=outside)]
    source_text = "the UWB tag's own positions, as set up in the site's axes"
    if positions:
        streams.append(Stream.of("UWB positions", ("north_m", "east_m"), positions, outside=outside))
    elif site is not None and cycles:
        north, east = cycle_fixes(ranges, site, tag_down_m)
        fixed = np.isfinite(north)
        columns = {"north_m": north[fixed], "east_m": east[fixed]}
        streams.append(Stream("UWB positions", t_ns[fixed], columns, outside=outside))
        source_text = f"least squares from the ranges of each cycle ({int(fixed.sum())} of {len(cycles)} gave a fix)"
    else:
        return streams, {}
    return streams, {"north_m": source_text, "east_m": source_text}


def read_uwb(path: Path, wire_format: str | None, site: Site | None, tag_down_m: float, offset_ns: int) -> UwbLog:
    """UWB measurements of a log (.mcap) or text log; `offset_ns` is added to their Unix stamps.

    Raises RunError, LogError.
    """
    if path.suffix.lower() == ".mcap":
        log = LogFile(path)
        messages = list(log.messages(UwbRanges, UwbPosition))
        notes = tuple(LogProblem(kind="damaged", text=text) for text in log.damage)
        offset_ns += log.wall_offset_ns
    else:
        messages, notes = _text_log(path, wire_format)
    if not messages:
        raise RunError(f"{path}: no UWB measurement in it")
    streams, columns = uwb_streams(messages, site, tag_down_m, outside=True)
    moved = [Stream(s.name, s.t_ns + offset_ns, s.columns, outside=True) for s in streams]
    return UwbLog(moved, columns, notes)


def _text_log(path: Path, wire_format: str | None) -> tuple[list[Message], tuple[LogProblem, ...]]:
    """Messages of a text log, and notes on lines without stamp and damaged lines."""
    if wire_format is None:
        raise RunError(f"{path}: its wire format is not known: give the vessel file")
    codec = uwb_codec(wire_format, "tag", 1.0)
    messages: list[Message] = []
    unstamped: list[int] = []
    lines = csv_lines(path)
    for number, line in enumerate(lines, 1):
        match = _STAMPED.fullmatch(line)
        t_ns = _stamp(match[1]) if match else None
        if match is None or t_ns is None:
            unstamped.append(number)
        else:
            messages += codec.feed(match[2] + b"\n", t_ns)
    if unstamped and len(unstamped) == len(lines):
        finer = next((n for n, line in enumerate(lines, 1) if re.match(rb"\s*\d{13}", line)), None)
        found = ", found what looks like milliseconds or finer" if finer else ""
        raise RunError(
            f"{path}: line {finer or 1}: expected a stamp (Unix seconds or ISO 8601){found}, then the tag's line"
        )
    notes = []
    if unstamped:
        notes.append(
            LogProblem(kind="garbage", text=f"{path}: {len(unstamped)} lines without stamp; line {unstamped[0]}")
        )
    if codec.counters.garbage:
        why = ", ".join(f"{name} {count}" for name, count in sorted(codec.counters.reasons.items()))
        notes.append(LogProblem(kind="garbage", text=f"{path}: {codec.counters.garbage} damaged UWB lines ({why})"))
    return messages, tuple(notes)


def _stamp(text: bytes) -> int | None:
    """Unix time of a stamp [ns], None if invalid; decimal seconds are read digit by digit to keep all ns."""
    if match := re.fullmatch(rb"(\d{1,10})(?:\.(\d{1,9})\d*)?", text):
        t_ns = int(match[1]) * 1_000_000_000 + int((match[2] or b"0").ljust(9, b"0"))
    else:
        try:
            when = datetime.fromisoformat(text.decode())
        except (ValueError, UnicodeDecodeError):
            return None
        t_ns = (when - _EPOCH) // timedelta(microseconds=1) * 1000 if when.tzinfo else -1
    return t_ns if 0 <= t_ns <= _LATEST_NS else None


def _word(anchor: str) -> str:
    return re.sub(r"\W", "_", anchor)
