"""One file of a log, read whatever became of it: the records that are whole, and what was met on the way."""

from __future__ import annotations

import contextlib
import mmap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from companion.logs.metadata import config_sha256, files_in
from companion.logs.records import Found, Records
from companion.logs.schema import GOES_ON_NAME, METADATA_NAME


class LogError(Exception):
    """The file cannot be read as a log: path and reason."""


class Part:
    """Records of one file. While `records` is read: the places `lost` so far. After it is exhausted: `damage` (None:
    sound), bytes kept and lost, and what to say where it `goes_on` in a file that is not there.

    Raises LogError (with the path) for a file in which no record stands.
    """

    def __init__(self, path: Path):
        self.path = path
        self.damage: str | None = None
        self.lost: list[Found] = []
        self.goes_on = ""
        self.kept_bytes = 0
        self.lost_bytes = 0
        try:
            self.size = path.stat().st_size
            with path.open("rb") as file:
                magic = file.read(len(MCAP0_MAGIC))
        except OSError as error:
            raise LogError(f"{path}: {error.strerror}") from None
        if not magic:
            raise LogError(f"{path}: the file is empty")
        if magic != MCAP0_MAGIC and not self._holds_records():
            raise LogError(f"{path}: not an MCAP log (its first bytes are {magic.hex(' ')})")

    def declared(self) -> list[Schema | Channel]:
        """Schemas and channels outside of chunks, in the index at the end: needed where their chunk is damaged."""
        with self._open() as records:
            return list(records.summary())

    def records(self) -> Iterator[McapRecord]:
        """All readable records, those inside chunks included, in file order."""
        self.kept_bytes = min(len(MCAP0_MAGIC), self.size)
        self.lost = lost = []
        closed = False
        with self._open() as records:
            for found in records:
                if found.trouble:
                    lost.append(found)
                    continue
                self.kept_bytes += found.end - found.start
                closed = closed or found.closes
                for record in found.records:
                    if isinstance(record, Metadata) and record.name == GOES_ON_NAME:
                        self.goes_on = f"{self.path}: the log goes on in another part, which is not here"
                    else:
                        yield record
        if lost and lost[0].start == 0:
            self.kept_bytes -= len(MCAP0_MAGIC)
        self.lost_bytes = self.size - self.kept_bytes
        self.damage = _damage(self.path, self.size, lost, closed=closed)

    def stated(self) -> dict[str, str]:
        """What the file says of its log; nothing where that cannot be read."""
        for record in self.records():
            if isinstance(record, Message | Channel | Schema):
                break
            if isinstance(record, Metadata) and record.name == METADATA_NAME:
                return record.metadata
        return {}

    def _holds_records(self) -> bool:
        with self._open() as records:
            return next(iter(records)).end < self.size

    @contextlib.contextmanager
    def _open(self) -> Iterator[Records]:
        with self.path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield Records(data)


class PartFile(NamedTuple):
    """One file of a log; `part` is None where it is left out. `problem`: why, or what is missing before it."""

    path: Path
    part: Part | None
    problem: str = ""


def opened(paths: Sequence[Path]) -> Iterator[PartFile]:
    """The files of a log, by its names, in order. Every part states its number and the wall clock of its run, by which
    one that is missing or is another run's is known.
    """
    run, due = None, 0
    for path in paths:
        try:
            part = Part(path)
        except LogError as error:
            due += 1
            yield PartFile(path, None, str(error))
            continue
        stated = part.stated()
        clock, number = stated.get("wall_offset_ns", run), stated.get("part", "")
        if run and clock and _differ(run, clock):
            yield PartFile(path, None, f"{path}: is part of another run than {paths[0].name}: left out")
            continue
        at = int(number) if number.isdecimal() and len(number) < 9 else due
        missing = f"part {due}" if at == due + 1 else f"parts {due} to {at - 1}"
        problem = f"{path}: what comes before it ({missing} of the log) was not read"
        yield PartFile(path, part, problem if at > due else "")
        run, due = clock, at + 1


def _differ(clock: str, other: str) -> bool:
    """Whether these are the clocks of two runs. Of two in nanoseconds more than one digit differs; one is damage."""
    return len(clock) != len(other) or sum(a != b for a, b in zip(clock, other, strict=True)) > 1


def head_of(paths: Sequence[Path]) -> list[Metadata | Attachment]:
    """Metadata and attachments of a log of these parts, all of which repeat them before their first message: each from
    the first part in which it can be read, and in which the configuration has the SHA-256 that it states, if any has.

    Raises LogError, that of the first part, where no part can be read.
    """
    found: dict[tuple[type, str], Metadata | Attachment] = {}
    errors: list[str] = []
    for _, part, problem in opened(paths):
        if part is None:
            errors.append(problem)
            continue
        for record in part.records():
            if isinstance(record, Message | Channel | Schema):
                break
            if isinstance(record, Metadata | Attachment):
                key = type(record), record.name
                if key not in found or (_sound(record) and not _sound(found[key])):
                    found[key] = record
    if len(errors) == len(paths):
        raise LogError(errors[0])
    return list(found.values())


def _sound(record: Metadata | Attachment) -> bool:
    """Whether a configuration is the one whose SHA-256 stands beside it; of what has none nothing is known."""
    values = record.metadata if isinstance(record, Metadata) else {}
    return values.get("config_sha256") in (None, config_sha256(files_in(values)))


def _damage(path: Path, size: int, lost: list[Found], *, closed: bool) -> str | None:
    """What of a part was lost, in one line; None: nothing."""
    problems = []
    chunks = [found for found in lost if found.chunk]
    places = [found for found in lost if not found.chunk]
    if chunks:
        first = f"the first at byte {chunks[0].start}: {chunks[0].trouble}"
        problems.append(f"{len(chunks)} damaged chunk(s) left out ({first})")
    end = places.pop() if places and places[-1].end == size and not closed else None
    if places:
        first = f"the first from byte {places[0].start} to {places[0].end}: {places[0].trouble}"
        problems.append(f"{len(places)} damaged place(s) skipped ({first})")
    if not closed:
        after = f"after byte {end.start} ({end.trouble})" if end else f"after byte {size}"
        problems.append(f"ends without footer {after}")
    return f"{path}: {'; '.join(problems)}" if problems else None
