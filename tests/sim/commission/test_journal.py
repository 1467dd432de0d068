"""The folder of a commissioning: nothing is overwritten, nothing of another boat is gone on with."""

import re

import pytest
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES
from companion.core.configuration.tables import ConfigError
from sim.commission.journal import FlightJournal, FlightRecord, stage_of

FILES = {"vessel.toml": "a", "site.toml": "b"}


def record(stage: str) -> FlightRecord:
    return FlightRecord(stage=stage, seconds=12.5, ending="done", done=True, nats=1.0, gained=0.5)


def test_flights_come_back_in_order_with_what_was_written_of_them(tmp_path):
    journal = FlightJournal(tmp_path / "new", FILES)
    first, second = journal.begin("signs", {"vessel.toml": "v"}), journal.begin("hull", {})
    journal.close(first, record("signs"))
    again = FlightJournal(tmp_path / "new", FILES)
    assert again.flights() == [first, second] and [stage_of(f) for f in (first, second)] == ["signs", "hull"]
    assert again.record(first) == record("signs") and again.record(second) is None
    assert (first / "vessel.toml").read_text() == "v" and (tmp_path / "new" / "vessel.toml").read_text() == "a"


def test_another_boat_in_the_same_folder_is_refused_by_name(tmp_path):
    FlightJournal(tmp_path / "one", FILES)
    with pytest.raises(ConfigError, match=r"one/vessel\.toml: was begun with 'a', not 'c': take another --out"):
        FlightJournal(tmp_path / "one", {**FILES, "vessel.toml": "c"})
    with pytest.raises(ConfigError, match=r"was flown by a simulated boat, not by the boat itself"):
        FlightJournal(tmp_path / "rehearsal", FILES, "a simulated boat")
        FlightJournal(tmp_path / "rehearsal", FILES)


RUN = (EXAMPLES / "aritra.toml").read_text(encoding="utf-8")


def test_wires_may_change_on_the_way_and_how_it_is_controlled_may_not(tmp_path):
    FlightJournal(tmp_path / "one", {"run.toml": RUN})
    FlightJournal(tmp_path / "one", {"run.toml": re.sub(r'url = ".*"', 'url = "serial:/dev/ttyUSB7"', RUN)})
    with pytest.raises(
        ConfigError, match=r"one/run\.toml: was begun with 'control\.period_s = 0\.1', not 'control\.period_s = 0\.2'"
    ):
        FlightJournal(tmp_path / "one", {"run.toml": RUN.replace("period_s = 0.1", "period_s = 0.2")})


def test_two_programs_do_not_fly_in_one_folder(tmp_path):
    first, second = (FlightJournal(tmp_path / "one", FILES) for _ in range(2))
    with first.held(), pytest.raises(ConfigError, match="another `aritra commission` flies in it"), second.held():
        pass
    with second.held():
        pass


def test_what_ended_while_the_folder_was_made_is_begun_again_but_no_file_of_a_person_is_taken_for_it(tmp_path):
    (tmp_path / "vessel.toml").write_text("a")
    FlightJournal(tmp_path, FILES)
    assert (tmp_path / "site.toml").read_text() == "b"
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "vessel.toml").write_text("not what is begun with")
    with pytest.raises(ConfigError, match="no commissioning"):
        FlightJournal(tmp_path / "mine", FILES)
    assert (tmp_path / "mine" / "vessel.toml").read_text() == "not what is begun with"


def test_flights_that_somebody_took_away_leave_the_numbers_of_the_others(tmp_path):
    journal = FlightJournal(tmp_path / "new", FILES)
    folders = [journal.begin("signs", {}) for _ in range(3)]
    folders[1].rmdir()
    (tmp_path / "new" / "2026-11-30 photos").mkdir()
    assert journal.begin("hull", {}).name == "04-hull" and len(journal.flights()) == 3


@pytest.mark.parametrize("name", ["commission.json", "01-signs/flight.json"])
def test_a_damaged_record_is_named(name, tmp_path):
    journal = FlightJournal(tmp_path / "new", FILES)
    journal.close(journal.begin("signs", {}), record("signs"))
    (tmp_path / "new" / name).write_text("")
    with pytest.raises(ConfigError, match=rf"{name}: is damaged"):
        FlightJournal(tmp_path / "new", FILES).record(tmp_path / "new" / "01-signs")


def test_a_flight_that_was_stopped_at_once_is_flown_again(tmp_path):
    flown = FlightRecord(stage="hull", seconds=1.0, ending="stopped by the operator", done=False, planned_s=100.0)
    assert not flown.counts and replace(flown, seconds=30.0).counts and replace(flown, done=True).counts


def test_a_folder_with_other_things_is_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match="no commissioning"):
        FlightJournal(tmp_path, FILES)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
