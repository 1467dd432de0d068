"""The folder of a commissioning: one folder a flight, in order; whatever ends the program, it goes on from there.

    commission.json        which boat flies: the real one, or which simulated one
    vessel.toml site.toml ..   the files that it began with
    01-signs/              excitation.toml, vessel.toml (as believed then), run.mcap; once judged flight.json
    02-hull/  ..
    commissioned.toml, report.html     at the end

A flight without `flight.json` was under way when the program ended: what its log holds counts as flown, and the
next is designed on what is known with it. One without a readable log has not been flown.
"""

from __future__ import annotations

import fcntl
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import TypeVar

import msgspec

from companion.core.configuration.run_file import RunFile, load_run
from companion.core.configuration.tables import ConfigError
from sim.whole_file import write_whole
from sim.world.stepped_logs import RUN

LOG, RECORD, HEAD = RUN, "flight.json", "commission.json"
INTERRUPTED = "interrupted"
REAL = "the boat itself"
RUN_FILE, FLOWN_BY = "run.toml", ("control", "battery")
"""The run file, and its tables that say how a flight is flown: wires and logs may change on the way."""
FLIGHT = re.compile(r"\d{2,}-[a-z-]+")
LEAST_FLOWN = 0.25
"""Share of a flight from which on it counts as flown: stopped before, it is flown again; assumed."""
Written = TypeVar("Written")


class FlightRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One flight. `seconds`: of flight; `ending`: in words; `done`: it came to its end.

    `nats`: expected beforehand, of the stage's parameters; `gained`: told by the fit with this log.
    `cross_track_rms_m`: of a mission, by the boat's own estimate. `planned_s`: how long it was to take, 0: not known.
    """

    stage: str
    seconds: float
    ending: str
    done: bool
    nats: float = 0.0
    gained: float | None = None
    cross_track_rms_m: float | None = None
    planned_s: float = 0.0

    @property
    def counts(self) -> bool:
        """Whether its stage need not fly it again."""
        return self.done or self.seconds > LEAST_FLOWN * self.planned_s


class Head(msgspec.Struct, frozen=True, kw_only=True):
    """Which boat the folder is about."""

    boat: str = REAL


class FlightJournal:
    """The folder `path`, made where it is not there. `boat`: which one flies.

    Raises ConfigError where it belongs to another boat or other files, OSError naming the file.
    """

    def __init__(self, path: Path, files: Mapping[str, str], boat: str = REAL):
        self.path = path
        head = path / HEAD
        if head.exists():
            before = _read(head, Head)
            if before.boat != boat:
                raise ConfigError(f"{path}: was flown by {before.boat}, not by {boat}: take another --out")
        elif path.exists() and any(_is_foreign(p, files) for p in path.iterdir()):
            raise ConfigError(f"{path}: is there already, and no commissioning of ours: take another --out")
        for name, text in files.items():
            if (path / name).exists():
                _check_same(path / name, text)
            elif head.exists():
                raise ConfigError(f"{path}: was begun without a {name}: take another --out")
        path.mkdir(parents=True, exist_ok=True)
        if not head.exists():
            for name, text in files.items():
                write_whole(path / name, text.encode())
            write_whole(head, msgspec.json.encode(Head(boat=boat)))

    @contextmanager
    def held(self) -> Iterator[None]:
        """Nobody else flies in this folder meanwhile. Raises ConfigError where somebody does."""
        with (self.path / HEAD).open("rb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ConfigError(f"{self.path}: another `aritra commission` flies in it: stop that first") from None
            yield

    def flights(self) -> list[Path]:
        """Folders of all flights, in order."""
        own = [p for p in self.path.iterdir() if p.is_dir() and FLIGHT.fullmatch(p.name)]
        return sorted(own, key=number_of)

    def begin(self, stage: str, files: Mapping[str, str]) -> Path:
        """Folder of the next flight, with its files."""
        number = 1 + max(map(number_of, self.flights()), default=0)
        folder = self.path / f"{number:02d}-{stage}"
        folder.mkdir()
        for name, text in files.items():
            write_whole(folder / name, text.encode())
        return folder

    def record(self, folder: Path) -> FlightRecord | None:
        """What is written of a flight; None where it was under way. Raises ConfigError where that is damaged."""
        path = folder / RECORD
        return _read(path, FlightRecord) if path.exists() else None

    def close(self, folder: Path, record: FlightRecord) -> None:
        """Write the record of a flight."""
        write_whole(folder / RECORD, msgspec.json.format(msgspec.json.encode(record)))


def number_of(folder: Path) -> int:
    """Number of a flight, from 1."""
    return int(folder.name.partition("-")[0])


def stage_of(folder: Path) -> str:
    """Name of the stage that a flight belongs to."""
    return folder.name.partition("-")[2]


def _is_foreign(path: Path, files: Mapping[str, str]) -> bool:
    """Whether it is none of the files with which a commissioning that was ended at once has begun."""
    return not path.name.startswith(".") and not (path.name in files and path.read_bytes() == files[path.name].encode())


def _check_same(path: Path, text: str) -> None:
    """ConfigError where a file that it began with says something else, with the first place."""
    before = path.read_text(encoding="utf-8")
    if path.name == RUN_FILE:
        ours, theirs = load_run(text, name="the run file"), load_run(before, name=str(path))
        lines = [_keys(run) for run in (theirs, ours)]
    else:
        lines = [iter(before.splitlines()), iter(text.splitlines())]
    for then, now in zip_longest(*lines, fillvalue=""):
        if then != now:
            raise ConfigError(f"{path}: was begun with {then.strip()!r}, not {now.strip()!r}: take another --out")


def _keys(run: RunFile) -> Iterator[str]:
    """What matters of a run file, line by line."""
    for table in FLOWN_BY:
        for key, value in msgspec.structs.asdict(getattr(run, table)).items():
            yield f"{table}.{key} = {value}"


def _read(path: Path, kind: type[Written]) -> Written:
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (msgspec.ValidationError, msgspec.DecodeError) as error:
        raise ConfigError(f"{path}: is damaged ({error}): take it from a copy, or another --out") from None
