"""What has been done, one line a case, each on disk before the next: a killed campaign loses what was under way.

The file is locked while a campaign writes it. A last line that was cut short is dropped.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import TypeVar

import msgspec

from companion.core.configuration.tables import ConfigError
from sim.campaign.runners.job import CaseOutcome

NAME = "journal.jsonl"
T = TypeVar("T")


class _Head(msgspec.Struct, frozen=True, kw_only=True):
    """The first line. `program`: versions that computed what follows."""

    format: int = 1
    kind: str
    program: dict[str, str]


class Journal:
    """Outcomes by case id, the newest of each. `kind`, `program`: of the campaign that is going to write."""

    def __init__(self, folder: Path, kind: str, program: dict[str, str]):
        """Open, lock, read. Raises ConfigError where it cannot be gone on with."""
        self.path = folder / NAME
        self.outcomes: dict[str, CaseOutcome] = {}
        self._program = program
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._read(kind)
        except BlockingIOError:
            os.close(self._file)
            raise ConfigError(f"{self.path}: another campaign is writing it") from None
        except BaseException:
            os.close(self._file)
            raise

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *exc: object) -> None:
        os.close(self._file)

    def add(self, outcome: CaseOutcome) -> None:
        """Keep it, on disk. Raises ConfigError where another program than this one computed it."""
        if outcome.program and outcome.program != self._program:
            raise ConfigError(f"worker {outcome.worker}: {_difference(outcome.program, self._program)}")
        self.outcomes[outcome.id] = outcome  # first: Ctrl-C while it is written must not leave it out of the tables
        self._write(msgspec.json.encode(msgspec.structs.replace(outcome, program={})))

    def _read(self, kind: str) -> None:
        data = self.path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        lines, first = whole.splitlines(), msgspec.json.encode(_Head(kind=kind, program=self._program))
        if lines:
            self._take(lines, kind)
        elif not first.startswith(data):
            raise ConfigError(f"{self.path}: is no journal of a campaign like this; choose another folder")
        os.ftruncate(self._file, len(whole))
        os.lseek(self._file, 0, os.SEEK_END)
        if not lines:
            self._write(first)

    def _take(self, lines: list[bytes], kind: str) -> None:
        head = self._decoded(1, lines[0], _Head)
        for number, line in enumerate(lines[1:], 2):
            outcome = self._decoded(number, line, CaseOutcome)
            self.outcomes[outcome.id] = outcome
        if head.kind != kind:
            raise ConfigError(f"{self.path}: holds a campaign of kind {head.kind}; choose another folder")
        if head.program != self._program:
            difference = _difference(head.program, self._program)
            raise ConfigError(f"{self.path}: {difference}; results of both are not mixed: choose another folder")

    def _decoded(self, number: int, line: bytes, kind: type[T]) -> T:
        try:
            return msgspec.json.decode(line, type=kind)
        except msgspec.DecodeError as error:
            raise ConfigError(f"{self.path}: line {number}: damaged: {error}") from None

    def _write(self, line: bytes) -> None:
        rest = line + b"\n"
        try:
            while rest:
                rest = rest[os.write(self._file, rest) :]
            os.fsync(self._file)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.path)) from None


def _difference(theirs: dict[str, str], ours: dict[str, str]) -> str:
    names = [name for name in {**theirs, **ours} if theirs.get(name) != ours.get(name)]
    pairs = (f"{name} {theirs.get(name, 'none')}, here {ours.get(name, 'none')}" for name in names)
    return f"was computed with {'; '.join(pairs)}"
