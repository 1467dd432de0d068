"""Random boats, each commissioned in the simulator from a file that knows its length and thrusters' places only."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import load_excitation
from companion.core.excitation.pen import Pen
from companion.core.messages import GroundTruth
from companion.core.model.vessel_text import vessel_toml
from companion.logs.log_file import LogFile
from sim.commission.boats import SimulatedBoat
from sim.commission.job import NEW, OLD, Commissioning, CommissionOutcome, CommissionTask
from sim.commission.journal import FlightJournal
from sim.studies.driving.identified import BelievedModel, Driven, missions
from sim.world.stepped_logs import TRUTH
from sim.world.world import WorldSetup
from tests.evidence.commission.draw import DrawnBoat, drawn
from tests.evidence.line import Line, at_least, at_most, exactly, information

BOATS, ALL = 3, 40
MINUTES = 30.0
AS_GOOD, AS_SURE = 1.15, 1.2
SEEDS = (1, 2)
SHARE = 0.9


@dataclass(frozen=True)
class Commissioned:
    """One boat: how it ended, its mission with the true and with the new file, and the least room it ever had [m]."""

    boat: DrawnBoat
    outcome: CommissionOutcome
    true: list[Driven]
    first: list[Driven]
    new: list[Driven]
    room_m: float

    def ratio(self, figure: str, of: str = "new") -> float:
        """A figure of the missions over that with the true file; inf where one missed a waypoint."""
        own = getattr(self, of)
        if any(m.missed for m in own) or any(m.missed for m in self.true):
            return math.inf
        return float(np.mean([getattr(m, figure) for m in own]) / np.mean([getattr(m, figure) for m in self.true]))

    @property
    def good(self) -> bool:
        """Whether it drives as it should."""
        return self.outcome.reached and self.ratio("cross_track_rms_m") <= AS_GOOD

    @property
    def minutes(self) -> float:
        """Flown until the new file was proven, without the missions."""
        return sum(r.seconds for name, r in self.outcome.flights if name not in (OLD, NEW)) / 60


def commissioned(seed: int, folder: Path) -> Commissioned:
    """Commission the boat of a seed, and drive its mission with three files."""
    setup = load_setup(EXAMPLES / "aritra.toml")
    settings, boat = setup.pilot, drawn(seed, setup.pilot.vessel)
    library = EXAMPLES / "excitations" / "library.toml"
    files = {**setup.files, "vessel.toml": vessel_toml(boat.first)}
    task = CommissionTask(
        files=files,
        vessel=boat.first,
        site=settings.site,
        points=tuple(settings.mission.path.points),
        library=load_excitation(library.read_text(encoding="utf-8"), name=library.name),
        minutes=MINUTES,
        date="2026-01-01",
    )
    north_m, east_m = map(float, Pen(settings.site).middle)
    world = WorldSetup(boat.true, settings.site, start=(north_m, east_m, 0.5), weather=boat.weather)
    outcome = Commissioning(task, SimulatedBoat(world, seed), FlightJournal(folder, files), lambda _text: None).run()

    def drive(name: str, vessel: VesselFile) -> list[Driven]:
        return missions(boat.true, BelievedModel(name, vessel), settings, SEEDS, weather=boat.weather)

    # A first file with thrusters in the wrong places is not driven with: nobody should.
    safe = not {"swapped", "reversed"} & set(boat.hidden)
    return Commissioned(
        boat,
        outcome,
        drive("true", boat.true),
        drive("first", boat.first) if safe else [],
        drive("new", outcome.vessel) if outcome.reached else [],
        _least_room_m(folder, Pen(settings.site)),
    )


def _least_room_m(folder: Path, pen: Pen) -> float:
    rooms = []
    for path in folder.glob(f"*/{TRUTH}"):
        truths = [m for m in LogFile(path).messages(GroundTruth) if isinstance(m, GroundTruth)]
        rooms.append(float(pen.clearance(np.array([(m.north_m, m.east_m) for m in truths])).min()))
    return min(rooms)


def boats(full: bool) -> Iterator[Line]:
    """Random boats from a first guess: cross-track with the new file over that with the true one, minutes, fence"""
    count, found = ALL if full else BOATS, []
    for seed in range(1, count + 1):
        with tempfile.TemporaryDirectory() as folder:
            one = commissioned(seed, Path(folder) / "boat")
        found.append(one)
        told = "; ".join((*one.outcome.belief.wiring.lines, *one.outcome.causes, one.outcome.why))
        note = f"hidden: {', '.join(one.boat.hidden) or 'nothing'}; {one.minutes:.1f} min; {told}"
        yield information(f"boat {seed}: cross-track over the true file's", _shown(one), note=note)
    good = [one for one in found if one.good]
    sure = [one for one in found if one.outcome.reached and one.ratio("position_rmse_m") <= AS_SURE]
    yield at_least(f"boats with cross-track <= {AS_GOOD:g} x", len(good), SHARE * count, note=f"of {count}")
    yield at_least(f"boats with position error <= {AS_SURE:g} x", len(sure), SHARE * count, note=f"of {count}")
    yield at_most("minutes until the file was proven, longest", max(one.minutes for one in found), MINUTES, "min")
    yield information("minutes, median", float(np.median([one.minutes for one in found])), "min")
    yield exactly("boats that were beyond the fence", sum(one.room_m < 0 for one in found), 0)
    yield information("least room to the fence", min(one.room_m for one in found), "m")
    better = [one for one in found if one.first and one.outcome.reached]
    gains = [one.ratio("cross_track_rms_m", "first") / one.ratio("cross_track_rms_m") for one in better]
    yield information("cross-track with the first file over the new one's", float(np.median(gains or [math.nan])), "x")


def _shown(one: Commissioned) -> float:
    return one.ratio("cross_track_rms_m") if one.outcome.reached else math.nan
