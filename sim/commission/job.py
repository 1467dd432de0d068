"""One commissioning, from the first file to one that has been proven, or to the reason why not.

    for each stage:  propose -> fly -> learn from all logs -> propose ..        until the stage is over
    proof            the best file on a manoeuvre that no fit has seen
    mission          with the file of the beginning, and with the new one

Everything that it knows stands in the folder (`journal`): started again, it learns from the logs that are there
and goes on. While signs and sides are in doubt nothing is flown but pulses of one thruster, and from the second flight
on moments of all together, a metre to and fro (`signs`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from dataclasses import replace as changed
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import Excitation, excitation_toml
from companion.core.messages import ExcitationStatus, GuidanceReference
from companion.core.model.vessel_text import vessel_toml
from companion.logs.log_file import LogError, LogFile
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.run import Run, RunError
from sim.commission.belief import BoatBelief, learned
from sim.commission.boats import Boat
from sim.commission.causes import Causes, causes
from sim.commission.journal import INTERRUPTED, LOG, FlightJournal, FlightRecord, stage_of
from sim.commission.news import doubts, news
from sim.commission.proof import Proof, driven, proof
from sim.commission.stages import PROVEN, SIGNS, STAGES, Proposal, Stage, propose
from sim.fitting.engine.split import NamedLog
from sim.fitting.excite.design import gain_nats

RESERVE_S = 420.0
"""Kept for the proof and two missions; assumed: the demo's mission takes 110 s."""
OLD, NEW = "mission-before", "mission"
BEGINNING, IDENTIFIED, EXTENDED = "first file", "identified", "identified with causes"
MOST_ENDED = 5
"""So many flights of a stage that were ended early since the program began, and it is over; assumed."""
NO_TIME = "no time left"
NO_PLAN = Proposal(None)
YIELD = (0.05, 1.0)
"""Least and largest share of the expected nats that flights are taken to tell; assumed."""
AS_EXPECTED_NATS = 5.0
"""So many are taken to have come as expected beforehand: a flight of little promise says little of the next; assumed.
One of 0.9 nats that told 0.1 ended a commissioning after four minutes, its boat driven 1.4 times as badly as can be."""
Say = Callable[[str], None]


@dataclass(frozen=True)
class CommissionTask:
    """What to commission: texts of the files, the first vessel and site as read, the manoeuvres, and the time there is.

    `points`: the mission's waypoints, north and east [m].
    """

    files: Mapping[str, str]
    vessel: VesselFile
    site: Site
    points: tuple[tuple[float, float], ...]
    library: Excitation
    minutes: float
    date: str


@dataclass(frozen=True)
class CommissionOutcome:
    """How it ended. `vessel`: the file to drive with; `reached`: it has been proven; `why`: why not.

    over     of each stage, why it was over
    causes   what the diagnosis found, in sentences
    """

    belief: BoatBelief
    vessel: VesselFile
    reached: bool
    why: str = ""
    proof: Proof | None = None
    over: Mapping[str, str] = field(default_factory=dict)
    causes: tuple[str, ...] = ()
    flights: tuple[tuple[str, FlightRecord], ...] = ()


class NotFlownError(Exception):
    """A flight left no tick under way: nothing would be gained by another."""


class StoppedError(Exception):
    """A flight was not done, and nobody has said that another may begin. `belief`: by all flights so far."""

    def __init__(self, why: str, belief: BoatBelief):
        super().__init__(why)
        self.belief = belief


class Commissioning:
    """One commissioning in a folder. `say`: a line to keep; `status`: what it is at just now."""

    def __init__(
        self, task: CommissionTask, boat: Boat, journal: FlightJournal, say: Say, status: Say = lambda _text: None
    ):
        self.task, self.boat, self.journal, self._say, self._status = task, boat, journal, say, status
        self._over: dict[str, str] = {}

    def run(self) -> CommissionOutcome:
        """All stages, from where the folder is; the outcome. Raises OSError."""
        self._close_interrupted()
        belief = self._learn() if self._logs() else BoatBelief.beginning(self.task.vessel)
        for stage in STAGES:
            try:
                belief = self._stage(stage, belief)
            except NotFlownError as error:
                return self._outcome(belief, belief.vessel, False, f"the boat did not fly: {error}")
            except StoppedError as error:
                return self._outcome(error.belief, error.belief.vessel, False, str(error))
            if stage is SIGNS and not belief.signs_known:
                return self._outcome(belief, belief.first, False, f"{doubts(belief)} ({self._over[SIGNS.name]})")
        if belief.fit is None:
            return self._outcome(belief, belief.first, False, f"no fit: {belief.problem or 'nothing was flown'}")
        return self._proven(belief)

    def _stage(self, stage: Stage, belief: BoatBelief) -> BoatBelief:
        """Fly a stage until it is over; what is believed then."""
        ended_early = 0
        while True:
            own = [record for name, record in self._records() if name == stage.name]
            flown = sum(record.done if stage is PROVEN else record.counts for record in own)
            left_s = 60 * self.task.minutes - self._spent_s() - RESERVE_S * (stage is not PROVEN)
            proposal = propose(
                stage, belief, self.task.library, self.task.site, left_s, flown, self._yielded(), self._status
            )
            why = f"{MOST_ENDED} of its flights were ended early" if ended_early >= MOST_ENDED else ""
            why = why or (NO_TIME if left_s <= 0 else "")
            if proposal.plan is None or why:
                self._over[stage.name] = proposal.why or why
                self._say(f"{stage.name}: over: {self._over[stage.name]}")
                return belief
            expected = f", {proposal.nats:.1f} nats expected" if proposal.nats else ""
            left = f"{left_s / 60:.0f} of {self.task.minutes:g} minutes left"
            self._say(f"{stage.name}: {stage.why}; flight of {proposal.minutes:.1f} minutes{expected}; {left}")
            plan = excitation_toml(proposal.plan, f"{stage.name}: {stage.why}")
            record, folder = self._fly(stage.name, belief.vessel, {"excitation.toml": plan}, proposal)
            if not record.seconds:
                self.journal.close(folder, record)
                raise NotFlownError(record.ending)
            ended_early += not (record.done if stage is PROVEN else record.counts)
            before = belief
            if stage is not PROVEN:
                belief = self._learn()
                of, of_after = (stage.indices(each.known) for each in (before, belief))
                record = replace(record, gained=gain_nats(before.known, belief.known, of, of_after))
            self.journal.close(folder, record)
            self._say(f"{stage.name}: {record.ending}; {'; '.join(news(before, belief))}")
            if why := self._stopped(record):
                raise StoppedError(why, belief)

    def _proven(self, belief: BoatBelief) -> CommissionOutcome:
        """The file to believe, and missions with the first and with it."""
        assert belief.fit is not None
        files = {BEGINNING: belief.first, IDENTIFIED: belief.vessel}
        records = ((folder, self.journal.record(folder)) for folder in self.journal.flights())
        flown = [folder for folder, record in records if record and record.done and stage_of(folder) == PROVEN.name]
        if not flown:
            ended = self._over[PROVEN.name]
            more = ", with more --minutes" if ended == NO_TIME else ""
            why = f"no whole proof was flown ({ended}): give the same command again{more}"
            return self._outcome(belief, belief.vessel, False, why)
        try:
            run = read_run(flown[-1] / LOG, ReadOptions(belief.first, self.task.site))
            found = self._causes(belief, run)
            if found.vessel is not None:
                files[EXTENDED] = found.vessel
            judged = proof(files, run, belief.fit, belief.vessel)
        except (LogError, ValueError) as error:
            return self._outcome(belief, belief.vessel, False, f"the proof cannot be used: {flown[-1].name}: {error}")
        best = files[judged.best]
        self._say(f"diagnosis: {'; '.join(found.lines) or 'nothing else is wrong'}")
        errors = ", ".join(f"{name} {error:.1%}" for name, error in judged.errors.items())
        self._say(f"proof: error of predictions {errors}: {judged.best} is believed")
        over = {name for name, record in self._records() if record.done or (name == OLD and record.seconds)}
        why = ""
        if judged.best != BEGINNING and OLD not in over:
            why = self._stopped(self._mission(OLD, belief.first))
        if not why and NEW not in over:
            last = self._mission(NEW, best)
            why = "" if last.done else f"the mission did not come to its end: {last.ending}"
        return changed(self._outcome(belief, best, not why, why), proof=judged, causes=found.lines)

    def _causes(self, belief: BoatBelief, run: Run) -> Causes:
        """What the diagnosis finds; that it cannot be made ends nothing."""
        self._status("diagnosis")
        try:
            return causes(belief, run)
        except ValueError as error:
            return Causes((f"no diagnosis: {error}",), None)

    def _stopped(self, record: FlightRecord) -> str:
        """Why no other flight may begin after this one; empty: it may."""
        if record.done or self.boat.goes_on(record.ending):
            return ""
        return (
            f"a flight ended early ({record.stage}: {record.ending}); look at the boat, then give the same command "
            "again: it goes on from here"
        )

    def _mission(self, name: str, vessel: VesselFile) -> FlightRecord:
        record, folder = self._fly(name, vessel, {})
        with contextlib.suppress(LogError):
            record = replace(record, cross_track_rms_m=driven(folder / LOG, self.task.points))
        self.journal.close(folder, record)
        error_m = record.cross_track_rms_m
        error = "no track" if error_m is None else f"cross-track {error_m:.3f} m by its own estimate"
        self._say(f"{name}: {record.ending}; {error}")
        return record

    def _fly(
        self, name: str, vessel: VesselFile, more: Mapping[str, str], plan: Proposal = NO_PLAN
    ) -> tuple[FlightRecord, Path]:
        head = f"{name}: as believed by `aritra commission`"
        files = {**self.task.files, "vessel.toml": vessel_toml(plan.vessel or vessel, head), **more}
        folder = self.journal.begin(name, files)
        flown = self.boat.fly(files, folder, lambda text: self._status(f"{name}: {text}"))
        seconds, planned_s = _logged_s(folder / LOG), 60 * plan.minutes
        record = FlightRecord(
            stage=name, seconds=seconds, ending=flown.ending, done=flown.done, nats=plan.nats, planned_s=planned_s
        )
        return record, folder

    def _learn(self) -> BoatBelief:
        return learned(self.task.vessel, self._logs(), self.task.date, self._status)

    def _logs(self) -> list[NamedLog]:
        """All logs to fit: excitations but for the proof."""
        logs = []
        for folder in self.journal.flights():
            if stage_of(folder) in (PROVEN.name, OLD, NEW):
                continue
            try:
                run = read_run(folder / LOG, ReadOptions(self.task.vessel, self.task.site))
            except (LogError, RunError, OSError) as error:
                self._say(f"{folder.name}: cannot be used: {error}")
                continue
            logs.append(NamedLog(folder.name, run))
        return logs

    def _close_interrupted(self) -> None:
        """Flights that were under way when the program ended: what their logs hold counts."""
        for folder in self.journal.flights():
            if self.journal.record(folder) is None:
                seconds = _logged_s(folder / LOG)
                record = FlightRecord(stage=stage_of(folder), seconds=seconds, ending=INTERRUPTED, done=False)
                self.journal.close(folder, record)
                self._say(f"{folder.name}: was interrupted after {seconds:.0f} s, which count")

    def _records(self) -> list[tuple[str, FlightRecord]]:
        pairs = ((stage_of(folder), self.journal.record(folder)) for folder in self.journal.flights())
        return [(name, record) for name, record in pairs if record is not None]

    def _yielded(self) -> float:
        """What the designed flights so far told over what was expected of them, with `AS_EXPECTED_NATS` beside them."""
        pairs = [(r.gained, r.nats) for _, r in self._records() if r.gained is not None and r.nats > 0]
        gained, expected = (AS_EXPECTED_NATS + sum(each) for each in zip((0.0, 0.0), *pairs, strict=True))
        return float(np.clip(gained / expected, *YIELD))

    def _spent_s(self) -> float:
        return sum(record.seconds for _, record in self._records())

    def _outcome(self, belief: BoatBelief, vessel: VesselFile, reached: bool, why: str) -> CommissionOutcome:
        return CommissionOutcome(belief, vessel, reached, why, over=dict(self._over), flights=tuple(self._records()))


def _logged_s(log: Path) -> float:
    """Seconds from the first to the last tick under way of a log, as far as it can be read."""
    try:
        ticks = [m.t_ns for m in LogFile(log).messages(ExcitationStatus, GuidanceReference)]
    except (LogError, OSError):
        return 0.0
    return (ticks[-1] - ticks[0]) * 1e-9 if ticks else 0.0
