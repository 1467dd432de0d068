"""The history of a boat: a folder with one entry for each log, on disk before the next log is read.

    vessel.toml          the file that the watch began with; theta = 0
    logs/BEGIN-HASH.json what one log says (`mission_fit`), whole or not there at all
    accepted-NN.toml     vessel files that a person has said yes to, accepted-NN.json: their theta

All else (`proposed.toml`, `history.html`) follows from these and is made anew. Entries do not depend on each other: a
watch that was killed goes on where it was, a log that comes late takes its place in time, and none counts twice.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.load_vessel import load_vessel
from companion.logs.part_files import log_parts
from companion.logs.runs.fingerprint import overlap
from sim.commission.journal import HEAD as COMMISSIONING
from sim.commission.watch.mission_fit import MissionInformation
from sim.whole_file import write_whole

VESSEL, LOGS, PROPOSED, PAGE = "vessel.toml", "logs", "proposed.toml", "history.html"
ENTRIES = "*-????????????.json"
"""Names of entries, in `LOGS`."""
FORMAT = 1
T = TypeVar("T")
MARK = "# Made anew by `{by}`; sha256 of all below this line: "
WATCH = "aritra watch"


class MissionEntry(msgspec.Struct, frozen=True, kw_only=True):
    """One log: its file, SHA-256 of file and data, begin [Unix s], duration [s], and what it says of the boat.

    `begin_by_file`: the log does not say when it began: it is the time of its file, less the duration.
    `marks`: fingerprint of its positions; none in entries that older versions wrote.
    `doubts`: problems of the log that can bias what it says, in sentences.
    """

    format: int = FORMAT
    log: str
    file_sha256: str
    data_sha256: str
    begin_unix_s: float
    duration_s: float
    names: tuple[str, ...]
    precision: list[list[float]]
    eta: list[float]
    day: dict[str, float]
    latent: tuple[float, float, float]
    thrust: tuple[float, float, float]
    marks: tuple[int, ...] = ()
    doubts: tuple[str, ...] = ()
    begin_by_file: bool = False

    def information(self) -> MissionInformation:
        """What the log says."""
        precision, eta = np.array(self.precision), np.array(self.eta)
        return MissionInformation(self.names, precision, eta, self.day, self.latent, self.thrust)


class Acceptance(msgspec.Struct, frozen=True, kw_only=True):
    """A vessel file that was accepted: theta by name.

    `until_unix_s`: begin of the last mission in it whose clock was not ahead; 0: there was none. `logs`: SHA-256 of the
    data of all logs in it; none in those of older versions.
    """

    format: int = FORMAT
    file: str
    theta: dict[str, float]
    until_unix_s: float
    logs: tuple[str, ...] = ()

    def precedes(self, entry: MissionEntry) -> bool:
        """Whether the mission was flown after it: it is not in the file, and did not come late from before it."""
        return entry.data_sha256 not in self.logs and entry.begin_unix_s > self.until_unix_s

    def is_of(self, entries: Sequence[MissionEntry]) -> bool:
        """Whether the file was made from these logs, and no others."""
        if not self.logs:
            return not any(map(self.precedes, entries))
        return {entry.data_sha256 for entry in entries} == set(self.logs)


class History:
    """The history in `folder` of the boat of `vessel`. `given`: name of that file in it, of several alike the newest.

    Raises ConfigError where it is of another vessel file, and before anything is made where the folder is another's.
    """

    def __init__(self, folder: Path, vessel: VesselFile, vessel_text: str):
        try:
            _reject_other_folder(folder)
            (folder / LOGS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"--history {folder}: {error.strerror}") from None
        self.folder = folder
        if not (folder / VESSEL).exists():
            write_whole(folder / VESSEL, vessel_text.encode())
        self.vessel = _vessel(folder / VESSEL)
        self.entries = sorted(_read((folder / LOGS).glob(ENTRIES), MissionEntry), key=_in_time)
        known = sorted(_read(folder.glob("accepted-*.json"), Acceptance), key=lambda a: a.file)
        self.accepted = [a for a in known if (folder / a.file).exists()]  # else it was killed before the file was there
        names = (VESSEL, *(a.file for a in self.accepted))
        given = [name for name in names if vessel == _vessel(folder / name)]
        if not given:
            raise ConfigError(
                f"--history {folder}: is of another vessel file; name one that is in it ({', '.join(names)}), or "
                "another folder"
            )
        self.given = given[-1]

    @property
    def in_force(self) -> str:
        """Name of the vessel file in force: the last that was accepted, else the one that the history began with."""
        return self.accepted[-1].file if self.accepted else VESSEL

    @property
    def is_accepted(self) -> bool:
        """Whether the file in force was made from these very logs: none has come or gone since."""
        return bool(self.accepted) and self.accepted[-1].is_of(self.entries)

    @property
    def since(self) -> tuple[int, ...]:
        """Missions (indices) that were flown since the file in force was accepted; without any all of them."""
        return tuple(i for i, entry in enumerate(self.entries) if all(a.precedes(entry) for a in self.accepted[-1:]))

    def holds_file(self, sha256: str) -> bool:
        """Whether a log file of this content has been taken in."""
        return any(e.file_sha256 == sha256 for e in self.entries)

    def holds_data(self, sha256: str) -> bool:
        """Whether a log with these data has been taken in, from whatever file."""
        return any(e.data_sha256 == sha256 for e in self.entries)

    def overlapping(self, marks: np.ndarray) -> str:
        """The log in the history that shares positions with one of the fingerprint `marks`; empty where none does."""
        return next((e.log for e in self.entries if overlap(np.array(e.marks, dtype=np.uint64), marks)), "")

    def add(self, entry: MissionEntry) -> Path:
        """Keep an entry, on disk before it returns; its file. Raises OSError."""
        path = self.folder / LOGS / f"{entry.begin_unix_s:.0f}-{entry.data_sha256[:12]}.json"
        write_whole(path, msgspec.json.encode(entry))
        self.entries = sorted([*self.entries, entry], key=_in_time)
        return path

    def files_in_force(self, names: Sequence[str]) -> list[np.ndarray]:
        """Theta (B,) of the vessel file in force in each mission: that of the last acceptance before it, else zero."""
        out = []
        for entry in self.entries:
            before = [a for a in self.accepted if a.precedes(entry)]
            out.append(theta_of(before[-1], names) if before else np.zeros(len(names)))
        return out

    def accept(self, text: str, names: Sequence[str], theta: np.ndarray, now_unix_s: float) -> Path:
        """Write the vessel file `text` under a new name, as accepted with all these missions in it. Raises OSError."""
        number = 1
        while list(self.folder.glob(f"accepted-{number:02d}.*")):
            number += 1
        path = self.folder / f"accepted-{number:02d}.toml"
        values = dict(zip(names, theta.tolist(), strict=True))
        until_unix_s = max((e.begin_unix_s for e in self.entries if e.begin_unix_s <= now_unix_s), default=0.0)
        logs = tuple(e.data_sha256 for e in self.entries)
        made = Acceptance(file=path.name, theta=values, until_unix_s=until_unix_s, logs=logs)
        write_whole(path.with_suffix(".json"), msgspec.json.encode(made))
        write_whole(path, text.encode())
        self.accepted.append(made)
        return path


def theta_of(accepted: Acceptance, names: Sequence[str]) -> np.ndarray:
    """Theta (B,) of an accepted file."""
    return np.array([accepted.theta.get(name, 0.0) for name in names])


def file_sha256(path: Path) -> str:
    """SHA-256 of a log's content, with its continuations. Raises OSError."""
    digest = hashlib.sha256()
    for part in log_parts(path):
        digest.update(part.read_bytes())
    return digest.hexdigest()


def marked(text: str, by: str = WATCH) -> str:
    """A text that is made anew each time, with a mark by which a person's change to it is seen. `by`: which command."""
    return f"{MARK.format(by=by)}{hashlib.sha256(text.encode()).hexdigest()}\n{text}"


def changed_by_hand(path: Path, by: str = WATCH) -> bool:
    """Whether a marked file is there that is not as it was made."""
    if not path.exists():
        return False
    first, _, rest = path.read_text(encoding="utf-8", errors="replace").partition("\n")
    return first != MARK.format(by=by) + hashlib.sha256(rest.encode()).hexdigest()


def _vessel(path: Path) -> VesselFile:
    return load_vessel(path.read_text(encoding="utf-8"), name=str(path))


def _in_time(entry: MissionEntry) -> tuple[float, str]:
    return entry.begin_unix_s, entry.data_sha256


def _reject_other_folder(folder: Path) -> None:
    """Raise ConfigError where something is in `folder` and it is no history. One that was just begun may lack files."""
    if (folder / COMMISSIONING).exists():
        raise ConfigError(f"--history {folder}: is the folder of a commissioning; name another one for the history")
    if not folder.is_dir() or ((folder / VESSEL).is_file() and (folder / LOGS).is_dir()):
        return
    for path in sorted(folder.iterdir()):
        begun = path.name == LOGS and path.is_dir() and not any(path.iterdir())
        if not begun and not path.name.startswith(f".{VESSEL}."):
            raise ConfigError(f"--history {folder}: holds {path.name}, and no history; name a new or an empty folder")


def _read(paths: Iterable[Path], kind: type[T]) -> list[T]:
    out = []
    for path in sorted(paths):
        try:
            out.append(msgspec.json.decode(path.read_bytes(), type=kind))
        except msgspec.DecodeError as error:
            todo = "name its log again" if kind is MissionEntry else f"{path.stem}.toml with it, then --accept again"
            raise ConfigError(f"{path}: damaged ({error}); move it away and {todo}") from None
    return out
