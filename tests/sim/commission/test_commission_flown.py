"""A boat that is not as its file says, commissioned in the simulated world by a program that is killed on the way."""

import contextlib

import pytest
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import load_excitation
from companion.core.messages import GroundTruth
from companion.core.model.vessel_text import vessel_toml
from companion.logs.log_file import LogFile
from sim.commission.boats import Flown, SimulatedBoat
from sim.commission.job import NEW, Commissioning, CommissionTask
from sim.commission.journal import INTERRUPTED, LOG, FlightJournal
from sim.world.environment import Weather
from sim.world.stepped_logs import TRUTH
from sim.world.world import WorldSetup

SETUP = load_setup(EXAMPLES / "aritra.toml")
LIBRARY = EXAMPLES / "excitations" / "library.toml"
SEED = 11


class Killed(BaseException):
    """What ends the program in the midst of a flight."""


class Fragile:
    """A boat whose program dies once, `at` this report of its progress."""

    def __init__(self, boat: SimulatedBoat, at: int):
        self._boat, self._left = boat, at
        self.goes_on = boat.goes_on

    def fly(self, files, folder, say):
        def counted(text):
            self._left -= 1
            if self._left == 0:
                raise Killed
            say(text)

        return self._boat.fly(files, folder, counted)


class StoppedBoat:
    """A boat whose flights all end by an operator's STOP, and whom nobody allows to go on."""

    def __init__(self, boat: SimulatedBoat):
        self._boat, self.asked = boat, list[str]()

    def fly(self, files, folder, say):
        self._boat.fly(files, folder, say)
        return Flown(False, "idle: the operator's stop")

    def goes_on(self, ending):
        self.asked.append(ending)
        return False


def unlike(vessel: VesselFile) -> VesselFile:
    """The vessel with a thruster 30 % weaker, and tag and IMU elsewhere."""
    weak, *rest = vessel.thrusters
    imu, uwb = vessel.sensors.imu, vessel.sensors.tag
    sensors = replace(vessel.sensors, imu=replace(imu, x_m=imu.x_m - 0.15), uwb=replace(uwb, x_m=uwb.x_m + 0.2))
    return replace(vessel, thrusters=(replace(weak, gain=0.7 * weak.gain), *rest), sensors=sensors)


def commission_of(first: VesselFile) -> CommissionTask:
    """Twelve minutes of the demo's basin and mission, with the file `first`."""
    settings = SETUP.pilot
    return CommissionTask(
        files={**SETUP.files, "vessel.toml": vessel_toml(first)},
        vessel=first,
        site=settings.site,
        points=tuple(settings.mission.path.points),
        library=load_excitation(LIBRARY.read_text(encoding="utf-8"), name="library"),
        minutes=12.0,
        date="2026-01-01",
    )


@pytest.mark.long
def test_after_a_stop_no_flight_begins_by_itself(tmp_path):
    settings = SETUP.pilot
    task = commission_of(settings.vessel)
    boat = StoppedBoat(SimulatedBoat(WorldSetup(settings.vessel, settings.site, start=(15.0, 15.0, 0.3)), SEED))
    outcome = Commissioning(task, boat, FlightJournal(tmp_path / "com", task.files), lambda _text: None).run()
    assert len(outcome.flights) == 1 and boat.asked == ["idle: the operator's stop"]
    assert not outcome.reached and "the operator's stop); look at the boat" in outcome.why


@pytest.mark.long
@pytest.mark.matrix
def test_a_killed_commissioning_goes_on_and_drives_the_mission_with_what_it_found(tmp_path):
    settings = SETUP.pilot
    first, true = settings.vessel, unlike(settings.vessel)
    task = commission_of(first)
    weather = Weather(V_c_m_s=0.05, beta_c_deg=60.0)
    boat = SimulatedBoat(WorldSetup(true, settings.site, start=(15.0, 15.0, 0.3), weather=weather), SEED)
    folder, said = tmp_path / "com", list[str]()
    with contextlib.suppress(Killed):
        Commissioning(task, Fragile(boat, 21), FlightJournal(folder, task.files), said.append).run()
    begun = FlightJournal(folder, task.files).flights()
    assert len(begun) == 1  # it died in the first flight
    assert max(m.t_ns for m in LogFile(begun[0] / LOG).messages()) >= 15e9

    outcome = Commissioning(task, boat, FlightJournal(folder, task.files), said.append).run()

    first_flight, last_flight = outcome.flights[0][1], outcome.flights[-1][1]
    assert first_flight.ending == INTERRUPTED and first_flight.seconds > 5.0
    assert outcome.reached, outcome.why
    assert not outcome.belief.wiring.findings
    gains = [t.gain / true.gain for t, true in zip(outcome.vessel.thrusters, true.thrusters, strict=True)]
    assert max(gains) / min(gains) < 1.05  # the common scale is a matter of the prior
    assert outcome.proof is not None and outcome.proof.best != "first file"
    assert not any(line.startswith("no diagnosis") for line in outcome.causes)
    assert last_flight.stage == NEW and last_flight.cross_track_rms_m and last_flight.cross_track_rms_m < 0.15
    for path in folder.glob(f"*/{TRUTH}"):
        for truth in LogFile(path).messages(GroundTruth):
            assert isinstance(truth, GroundTruth) and settings.site.inside(truth.north_m, truth.east_m)
    assert sum(r.seconds for _, r in outcome.flights) / 60 < task.minutes
