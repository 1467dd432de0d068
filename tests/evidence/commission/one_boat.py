"""One drawn boat commissioned in the simulator, and its mission with the true file, the first, the new and others'."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from companion.boat.load_run import EXAMPLES, RunSetup, load_setup
from companion.core.configuration.vessel_file import VesselFile
from companion.core.messages import GroundTruth, OverrideLease
from companion.core.model.vessel_text import vessel_toml
from companion.core.pilot.pilot import PilotSettings
from companion.logs.log_file import LogFile
from companion.logs.readers.read_run import ReadOptions, read_run
from sim.commission.belief import learned
from sim.commission.boats import SimulatedBoat, Worlds, simulated_world
from sim.commission.job import NEW, OLD, Commissioning, CommissionOutcome, CommissionTask
from sim.commission.journal import LOG, FlightJournal, FlightRecord, stage_of
from sim.commission.stages import PROVEN, STAGES
from sim.fitting.engine.split import NamedLog
from sim.studies.driving.identified import BelievedModel, Driven, missions
from sim.world.stepped_logs import TRUTH
from tests.evidence.commission.draw import DrawnBoat, drawn
from tests.evidence.commission.library_flight import library, world_of
from tests.evidence.commission.others import DATE, OTHERS

MINUTES = 30.0
SEEDS = (1, 2)
TRUE, FIRST, COMMISSIONED = "true", "first", "new"


@dataclass(frozen=True)
class OneBoat:
    """How one boat ended. `missions`: by the name of the file that they were driven with.

    `said`: what it says of causes and of why not; `room_m`: least room of the true boat to the fence in any flight [m];
    `outside_s`: how long thrusters were driven while it was beyond [s].
    """

    seed: int
    hidden: tuple[str, ...]
    reached: bool
    said: tuple[str, ...]
    flights: tuple[tuple[str, FlightRecord], ...]
    room_m: float
    outside_s: float
    missions: Mapping[str, list[Driven]] = field(default_factory=dict)

    def ratio(self, figure: str, of: str = COMMISSIONED) -> float:
        """A figure of the missions over that with the true file; inf: one missed a waypoint; NaN: none was driven."""
        own, true = self.missions.get(of), self.missions[TRUE]
        if not own:
            return math.nan
        if any(m.missed for m in (*own, *true)):
            return math.inf
        return float(np.mean([getattr(m, figure) for m in own]) / np.mean([getattr(m, figure) for m in true]))

    @property
    def minutes(self) -> float:
        """Flown until the new file was proven, without the missions."""
        return sum(r.seconds for name, r in self.flights if name not in (OLD, NEW)) / 60


def task_of(boat: DrawnBoat, setup: RunSetup) -> CommissionTask:
    """Half an hour of the demo's basin and mission."""
    return CommissionTask(
        files={**setup.files, "vessel.toml": vessel_toml(boat.first)},
        vessel=boat.first,
        site=setup.pilot.site,
        points=tuple(setup.pilot.mission.path.points),
        library=library(),
        minutes=MINUTES,
        date=DATE,
    )


def fly(boat: DrawnBoat, setup: RunSetup, folder: Path, worlds: Worlds) -> CommissionOutcome:
    """Commission the boat in `folder`."""
    task = task_of(boat, setup)
    simulated = SimulatedBoat(world_of(boat, setup), boat.seed, worlds)
    return Commissioning(task, simulated, FlightJournal(folder, task.files), lambda _text: None).run()


def commissioned(seed: int, stages: bool = False, others: bool = False, worlds: Worlds = simulated_world) -> OneBoat:
    """Commission the boat of a seed; its mission with the true file and the new one.

    `others`: also with what others find; `stages`: with the first file and with what was believed after each stage.
    `worlds`: that it is commissioned in; missions are driven with the simulated autopilot.
    """
    setup = load_setup(EXAMPLES / "aritra.toml")
    boat = drawn(seed, setup.pilot.vessel)
    files = {TRUE: boat.true}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "boat"
        outcome = fly(boat, setup, folder, worlds)
        if others:
            files |= {name: found for name, other in OTHERS.items() if (found := other(boat)) is not None}
        if stages:
            files |= _first(boat) | after_stages(boat, setup, folder)
        room_m, outside_s = fence_of(folder, setup.pilot)
    if outcome.reached:
        files[COMMISSIONED] = outcome.vessel
    driven = {
        name: missions(boat.true, BelievedModel(name, vessel), setup.pilot, SEEDS, weather=boat.weather)
        for name, vessel in files.items()
    }
    said = (*outcome.belief.wiring.lines, *outcome.causes, outcome.why)
    return OneBoat(
        seed, boat.hidden, outcome.reached, tuple(filter(None, said)), outcome.flights, room_m, outside_s, driven
    )


def _first(boat: DrawnBoat) -> dict[str, VesselFile]:
    """The first file; none where its thrusters are in the wrong places: nobody should drive with it."""
    return {} if {"swapped", "reversed"} & set(boat.hidden) else {FIRST: boat.first}


def after_stages(boat: DrawnBoat, setup: RunSetup, folder: Path) -> dict[str, VesselFile]:
    """What was believed at the end of each stage, by its name, where that was fit to drive with."""
    believed: dict[str, VesselFile] = {}
    flights = FlightJournal(folder, task_of(boat, setup).files).flights()
    logs: list[NamedLog] = []
    for stage in (s for s in STAGES if s is not PROVEN):
        own = [path for path in flights if stage_of(path) == stage.name]
        reading = ReadOptions(boat.first, setup.pilot.site)
        logs += [NamedLog(path.name, read_run(path / LOG, reading)) for path in own]
        belief = learned(boat.first, logs, DATE) if own else None
        if belief and belief.signs_known and belief.fit is not None:
            believed[stage.name] = belief.vessel
    return believed


def fence_of(folder: Path, settings: PilotSettings) -> tuple[float, float]:
    """Least room of the true boat to the fence [m], and how long it was driven beyond it [s], in all flights."""
    rooms, outside_s = [math.inf], 0.0
    for path in sorted(folder.glob(f"*/{TRUTH}")):
        truths = [m for m in LogFile(path).messages(GroundTruth) if isinstance(m, GroundTruth)]
        room = settings.pen.clearance(np.array([(m.north_m, m.east_m) for m in truths]))
        rooms.append(float(room.min()))
        leases = [m for m in LogFile(path.parent / LOG).messages(OverrideLease) if isinstance(m, OverrideLease)]
        at = np.searchsorted([m.t_ns for m in truths], [m.t_ns for m in leases]).clip(max=len(truths) - 1)
        driven = np.array([m.source != "neutral" for m in leases])
        outside_s += float((driven & (room[at] < 0)).sum()) * settings.control.period_s
    return min(rooms), outside_s
