"""Flights of signs and sides in the simulator, of a boat of which another file is believed."""

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import Excitation, excitation_toml
from companion.core.model.first_vessel import Answers, first_vessel
from companion.core.model.vessel_text import vessel_toml
from companion.logs.readers.read_run import ReadOptions, read_run
from sim.commission.boats import SimulatedBoat
from sim.commission.journal import LOG, FlightJournal
from sim.commission.signs import distrusted, signs_segments
from sim.fitting.engine.split import NamedLog
from sim.world.environment import Weather
from sim.world.world import WorldSetup

SETUP = load_setup(EXAMPLES / "aritra.toml")
SITE, FOUR = SETUP.pilot.site, SETUP.pilot.vessel
TWO = first_vessel(Answers(1.47, 0.75, 45.0, "differential", None, "uwb"), "two", FOUR.force_maps["t200"])
WEATHER = Weather(V_c_m_s=0.08, beta_c_deg=60.0, V_w_m_s=2.0, beta_w_deg=200.0, gustiness=0.2)


def excitation(vessel: VesselFile, flown: int) -> Excitation:
    return Excitation(format=1, name="signs", homing=False, caution=2.5, segments=signs_segments(vessel, flown))


def flown(true: VesselFile, first: VesselFile, folder, flights: int, *, weather: Weather = WEATHER, seed: int = 21):
    """Folders of the first flights of `true`, of which `first` is believed."""
    journal = FlightJournal(folder, SETUP.files)
    boat = SimulatedBoat(WorldSetup(true, SITE, start=(15.0, 15.0, 0.5), weather=weather), seed)
    for number in range(flights):
        texts = {
            "vessel.toml": vessel_toml(distrusted(first)),
            "excitation.toml": excitation_toml(excitation(first, number)),
        }
        files = {**SETUP.files, **texts}
        boat.fly(files, journal.begin("signs", files), lambda _text: None)
    return journal.flights()


def logs(folders, first: VesselFile) -> list[NamedLog]:
    return [NamedLog(f.name, read_run(f / LOG, ReadOptions(first, SITE))) for f in folders]
