"""The folder of a commissioning: one folder a flight, in order; whatever ends the program, it goes on from there.

    commission.json        what it is about: digest of the files that it began with
    vessel.toml site.toml ..   these files
    01-signs/              excitation.toml, vessel.toml (as believed then), run.mcap; once judged flight.json
    02-hull/  ..
    commissioned.toml, report.html     at the end

A flight without `flight.json` was under way when the program ended: what its log holds counts as flown, and the
next is designed on what is known with it. One without a readable log has not been flown.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec

from companion.core.configuration.tables import ConfigError, digest
from sim.whole_file import write_whole
from sim.world.stepped_logs import RUN

LOG, RECORD, HEAD = RUN, "flight.json", "commission.json"
INTERRUPTED = "interrupted"


class FlightRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One flight. `seconds`: of flight; `ending`: in words; `done`: it came to its end.

    `nats`: expected beforehand, of the stage's parameters; `gained`: told by the fit with this log.
    `cross_track_rms_m`: of a mission, by the boat's own estimate.
    """

    stage: str
    seconds: float
    ending: str
    done: bool
    nats: float = 0.0
    gained: float | None = None
    cross_track_rms_m: float | None = None


class Head(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the folder is about."""

    digest: str


class FlightJournal:
    """The folder `path`, made where it is not there. Raises ConfigError where it belongs to other files."""

    def __init__(self, path: Path, files: Mapping[str, str]):
        self.path = path
        about = Head(digest=digest("".join(files[name] for name in sorted(files))))
        head = path / HEAD
        if not head.exists():
            if path.exists() and any(path.iterdir()):
                raise ConfigError(f"{path}: is there already, and no commissioning of ours: take another --out")
            path.mkdir(parents=True, exist_ok=True)
            for name, text in files.items():
                (path / name).write_text(text, encoding="utf-8")
            write_whole(head, msgspec.json.encode(about))
        elif msgspec.json.decode(head.read_bytes(), type=Head) != about:
            raise ConfigError(f"{path}: was begun with another vessel, site, run file or mission: take another --out")

    def flights(self) -> list[Path]:
        """Folders of all flights, in order."""
        return sorted(p for p in self.path.iterdir() if p.is_dir() and p.name[:2].isdigit())

    def begin(self, stage: str, files: Mapping[str, str]) -> Path:
        """Folder of the next flight, with its files."""
        folder = self.path / f"{len(self.flights()) + 1:02d}-{stage}"
        folder.mkdir()
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
        return folder

    def record(self, folder: Path) -> FlightRecord | None:
        """What is written of a flight; None where it was under way."""
        path = folder / RECORD
        return msgspec.json.decode(path.read_bytes(), type=FlightRecord) if path.exists() else None

    def close(self, folder: Path, record: FlightRecord) -> None:
        """Write the record of a flight."""
        write_whole(folder / RECORD, msgspec.json.format(msgspec.json.encode(record)))


def stage_of(folder: Path) -> str:
    """Name of the stage that a flight belongs to."""
    return folder.name[3:]
