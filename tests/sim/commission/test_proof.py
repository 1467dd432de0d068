"""The proof of a commissioning: only one that was flown to its end counts, and it must be long enough to prove."""

from dataclasses import replace

import pytest

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.excitation.file import Steps
from companion.core.messages import ExcitationStatus
from sim.commission import job
from sim.commission.belief import BoatBelief
from sim.commission.boats import Flown
from sim.commission.causes import Causes
from sim.commission.job import MOST_ENDED, NEW, Commissioning, CommissionTask
from sim.commission.journal import INTERRUPTED, FlightJournal, FlightRecord
from sim.commission.proof import Proof, proof
from sim.commission.stages import PROVEN
from sim.fitting.excite.nominal import fly_nominal
from sim.fitting.wiring.record import WiringReport
from sim.world.stepped_logs import SteppedLogs
from tests.support.excitation_fixture import BASIN, LIBRARY, of

SETUP = load_setup(EXAMPLES / "aritra.toml")
VESSEL = SETUP.pilot.vessel
TASK = CommissionTask(
    files=SETUP.files,
    vessel=VESSEL,
    site=SETUP.pilot.site,
    points=tuple(SETUP.pilot.mission.path.points),
    library=LIBRARY,
    minutes=30.0,
    date="2026-01-01",
)


class Fit:
    """Stands for the fit of the flights before: every parameter is as it was."""

    parameters, held = (), ()


class BriefBoat:
    """A boat that is under way for a second; `endings`: whether each flight was done. `goes_on`: nobody is asked."""

    def __init__(self, *endings: bool, goes_on: bool = False):
        self._endings, self._goes_on, self.flown = list(endings), goes_on, list[str]()

    def fly(self, _files, folder, _say):
        self.flown.append(folder.name)
        with SteppedLogs(folder, SETUP, 0) as logs:
            for t_ns in (0, 10**9):
                at = ExcitationStatus(t_ns=t_ns, phase="fly", segment=0, segments=1, name="", elapsed_s=t_ns * 1e-9)
                logs.record(at, t_ns)
        done = self._endings.pop(0)
        return Flown(done, "done" if done else "idle: stopped by the operator")

    def goes_on(self, _ending):
        return self._goes_on


@pytest.fixture
def only_the_proof(monkeypatch):
    """A commissioning of which nothing is left but the proof and the mission; the folders that were judged."""
    begun, judged = BoatBelief.beginning(VESSEL), list[str]()
    belief = BoatBelief(VESSEL, VESSEL, begun.known, WiringReport(logs=2), Fit())  # type: ignore[arg-type]
    monkeypatch.setattr(job, "STAGES", (PROVEN,))
    monkeypatch.setattr(job, "learned", lambda *_: belief)
    monkeypatch.setattr(job, "causes", lambda *_: Causes((), None))
    monkeypatch.setattr(job, "read_run", lambda log, _options: log.parent.name)

    def best(_files, run, _fit, _by):
        judged.append(run)
        return Proof({"first file": 0.5}, "first file")

    monkeypatch.setattr(job, "proof", best)
    return judged


def begun(folder) -> FlightJournal:
    """A folder with one flight that there is something to learn from."""
    journal = FlightJournal(folder, TASK.files)
    if not journal.flights():
        journal.close(journal.begin("hull", {}), FlightRecord(stage="hull", seconds=60.0, ending="done", done=True))
    return journal


def test_a_proof_that_was_stopped_is_flown_again_by_the_same_command(tmp_path, only_the_proof):
    boat = BriefBoat(False, True, True)
    first = Commissioning(TASK, boat, begun(tmp_path / "c"), lambda _text: None).run()
    assert not first.reached and "stopped by the operator" in first.why and not only_the_proof
    again = Commissioning(TASK, boat, begun(tmp_path / "c"), lambda _text: None).run()
    assert boat.flown == ["02-proof", "03-proof", f"04-{NEW}"]
    assert again.reached and only_the_proof == ["03-proof"]


def test_a_stage_whose_flights_all_end_early_is_over_until_the_command_is_given_again(tmp_path, only_the_proof):
    boat = BriefBoat(*[False] * MOST_ENDED, True, True, goes_on=True)
    first = Commissioning(TASK, boat, begun(tmp_path / "c"), lambda _text: None).run()
    assert len(boat.flown) == MOST_ENDED and not only_the_proof
    assert not first.reached and f"{MOST_ENDED} of its flights were ended early" in first.why
    assert Commissioning(TASK, boat, begun(tmp_path / "c"), lambda _text: None).run().reached


def test_a_proof_that_was_interrupted_proves_nothing_and_is_flown_again_while_there_is_time(tmp_path, only_the_proof):
    begun(tmp_path / "c").begin(PROVEN.name, {})
    boat = BriefBoat(True, True)
    late = Commissioning(replace(TASK, minutes=1.0), boat, begun(tmp_path / "c"), lambda _text: None).run()
    assert late.flights[1][1].ending == INTERRUPTED and not boat.flown and not only_the_proof
    assert not late.reached and "no whole proof was flown (no time left)" in late.why
    assert Commissioning(TASK, boat, begun(tmp_path / "c"), lambda _text: None).run().reached
    assert only_the_proof == ["03-proof"]


def test_manoeuvres_that_are_too_short_are_refused_and_say_what_to_do():
    short = fly_nominal(of(Steps(name="run", X=0.2, hold_s=4.0)), VESSEL, BASIN).run
    assert short.duration_s > 4.0
    with pytest.raises(ValueError, match=r"manoeuvres last \d+ s, and 28 s are needed: take a --library with a longer"):
        proof({"first file": VESSEL}, short, Fit(), VESSEL)  # type: ignore[arg-type]
