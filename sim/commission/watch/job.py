"""A watch: logs that are new are taken into the history, and what follows from all of them is written.

    log -> entry on disk -> course over all entries -> proposed.toml, history.html

A log that cannot be used is named and left out; the others are taken in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from companion.core.configuration.site_file import Site
from companion.core.configuration.tables import ConfigError
from companion.logs.log_file import LogError, LogFile
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.fingerprint import fingerprint
from companion.logs.runs.problems import problem_sentences, problems
from companion.logs.runs.run import Run, RunMeta
from sim.commission.watch.causes import Watched, watched
from sim.commission.watch.course import BoatCourse, course
from sim.commission.watch.history import (
    PAGE,
    PROPOSED,
    History,
    MissionEntry,
    changed_by_hand,
    file_sha256,
    marked,
)
from sim.commission.watch.mission_fit import boat_effects, mission_information
from sim.commission.watch.page import history_page
from sim.commission.watch.proposal import proposed_text
from sim.commission.watch.sentences import counted, when
from sim.fitting.diagnose.preparation.swapped_columns import reject_swapped_columns
from sim.whole_file import write_whole

UNUSABLE = (LogError, ValueError, OSError, np.linalg.LinAlgError)
"""Of a log that cannot be read or fitted: RunError, StructuredFitError and JobError are ValueErrors."""
NOT_STATED = RunMeta().vessel
Say = Callable[[str, float], None]


@dataclass(frozen=True)
class Outcome:
    """What a watch did: names of logs taken in, of those known already, and why others could not be used.

    `in_part`: of the known ones, those that share positions with another log of the history, in words.
    `doubtful`: why what logs that were taken in say may be wrong, and how to take them out again, in words.
    `course`: None without any log; `told`: changes that were not told before; `in_force`: name of the vessel file in
    force, `since`: its missions (indices).
    """

    taken: tuple[str, ...]
    known: tuple[str, ...]
    unusable: tuple[str, ...]
    in_part: tuple[str, ...]
    doubtful: tuple[str, ...]
    course: BoatCourse | None
    told: tuple[int, ...]
    in_force: str
    since: tuple[int, ...]


def watch(
    history: History,
    logs: Sequence[Path],
    site: Site | None = None,
    say: Say = lambda _text, _share: None,
    *,
    now_unix_s: float,
) -> Outcome:
    """Take `logs` into `history`; write the proposed file and the page. Raises ConfigError, OSError."""
    proposed = history.folder / PROPOSED
    if changed_by_hand(proposed):
        raise ConfigError(f"{proposed}: was changed by hand; move it away, it is made anew")
    found = course_of(history)
    old = _changes(history, found)
    taken, known, unusable, in_part, doubtful = [], [], [], [], []
    for i, path in enumerate(logs):
        say(path.name, i / len(logs))
        try:
            entry = _entry(history, path, site, now_unix_s)
        except UNUSABLE as error:
            unusable.append(_why(path, error))
            continue
        if not isinstance(entry, MissionEntry):
            known.append(str(path))
            in_part += [entry] if entry else []
            continue
        kept = history.add(entry)
        doubtful += [
            f"{doubt} It counts all the same: to take it out again, move {kept} away" for doubt in entry.doubts
        ]
        taken.append(str(path))
    found = course_of(history) if taken else found
    told = tuple(i for i, change in enumerate(_changes(history, found)) if change not in old)
    if found:
        write_whole(proposed, marked(proposal(history, found)).encode())
        write_whole(history.folder / PAGE, history_page(history, found).encode())
    return Outcome(
        tuple(taken), tuple(known), tuple(unusable), tuple(in_part), tuple(doubtful), found, told, history.in_force,
        history.since,
    )  # fmt: skip


def accept(history: History, now_unix_s: float) -> Path:
    """Write the proposed file under a new name: a person has said yes; then the page. Raises ConfigError, OSError."""
    path, found = history.folder / PROPOSED, course_of(history)
    if found is None:
        raise ConfigError(f"--history {history.folder}: holds no log yet; name one, then there is a file to accept")
    if changed_by_hand(path):
        raise ConfigError(f"{path}: was changed by hand; use it under a name of its own, or move it away")
    theta = found.missions[-1].belief.mean
    if history.is_accepted:
        raise ConfigError(f"{history.folder / history.in_force}: was accepted, and no mission has come since")
    accepted = history.accept(proposal(history, found), found.watched.names, theta, now_unix_s)
    write_whole(history.folder / PAGE, history_page(history, found).encode())
    return accepted


def proposal(history: History, found: BoatCourse) -> str:
    """The proposed vessel file as text."""
    last = history.entries[-1]
    note = f"watched over {counted(len(history.entries), 'mission')} up to {when(last)}"
    return proposed_text(history.vessel, found.missions[-1].belief.mean, note)


def course_of(history: History) -> BoatCourse | None:
    """The course over all entries; None without any."""
    if not history.entries:
        return None
    parameters = watched_of(history)
    for entry in history.entries:
        if entry.names != parameters.names:
            raise ConfigError(f"--history {history.folder}: {entry.log} was read by another version of this program; "
                              "begin another history")  # fmt: skip
    missions = [entry.information() for entry in history.entries]
    return course(missions, parameters, history.files_in_force(parameters.names))


def watched_of(history: History) -> Watched:
    """The watched parameters of the history's boat."""
    return watched(history.vessel, boat_effects(history.vessel))


def _changes(history: History, found: BoatCourse | None) -> list[tuple[str, str]]:
    """Each change by its name and the log by which it was told: the same when it is revised or a log comes late."""
    changes = found.changes if found else ()
    return [(change.cause.name, history.entries[change.told].data_sha256) for change in changes]


def _entry(history: History, path: Path, site: Site | None, now_unix_s: float) -> MissionEntry | str:
    """What the log says; where it is in the history already a sentence if only a part of it is, or nothing."""
    content = file_sha256(path)
    if history.holds_file(content):
        return ""
    run = read_run(path, ReadOptions(history.vessel, site))
    log = LogFile(path) if path.suffix.lower() == ".mcap" else None
    _reject_other_boat(run, log, history.vessel.name)
    if history.holds_data(run.data_hash):
        return ""
    marks = fingerprint(run)
    if other := history.overlapping(marks):
        return f"{path}: one recording with {other}, which is in the history: not taken in again"
    begin_s, by_file = _begin_unix_s(path, run, log)
    reject_swapped_columns(run)
    found = mission_information(run, history.vessel)
    if not np.isfinite(found.precision).all() or not np.isfinite(found.eta).all():
        raise ValueError("the fit ran away: is it a log of this boat?")
    entry = MissionEntry(
        log=str(path), file_sha256=content, data_sha256=run.data_hash, begin_unix_s=begin_s, duration_s=run.duration_s,
        names=found.names, precision=found.precision.tolist(), eta=found.eta.tolist(), day=dict(found.day),
        latent=found.latent, thrust=found.thrust, marks=tuple(marks.tolist()),
        doubts=tuple(problem_sentences({str(path): problems(run)})), begin_by_file=by_file,
    )  # fmt: skip
    if begin_s <= now_unix_s:
        return entry
    ahead = (
        f"{path}: began {when(entry)}, which is later than now: its clock was ahead, or this computer's is behind. "
        "Until then it stands after every other mission."
    )
    return msgspec.structs.replace(entry, doubts=(*entry.doubts, ahead))


def _reject_other_boat(run: Run, log: LogFile | None, name: str) -> None:
    """ValueError where a log says that it is of another boat. `log`: of ours, whose run is called as it was read."""
    own = log.metadata.get("vessel", NOT_STATED) if log else run.meta.vessel
    if own not in (name, NOT_STATED):
        raise ValueError(f"is of the boat {own}, the history is of {name}: name its own history")


def _begin_unix_s(path: Path, run: Run, log: LogFile | None) -> tuple[float, bool]:
    """Begin of a log by its wall clock; where it has none, by the time of its file less its duration, and whether so.

    `log`: of ours.
    """
    if log:
        if log.wall_offset_ns:
            return (run.meta.zero_ns + log.wall_offset_ns) * 1e-9, False
    elif "Unix" in run.meta.clock:
        return run.meta.zero_ns * 1e-9, False
    return path.stat().st_mtime - run.duration_s, True


def _why(path: Path, error: Exception) -> str:
    text = str(error)
    return text if str(path) in text else f"{path}: {text}"
