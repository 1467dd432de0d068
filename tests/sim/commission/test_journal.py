"""The folder of a commissioning: nothing is overwritten, nothing of another boat is gone on with."""

import pytest

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
    with pytest.raises(ConfigError, match=r"one: was begun with another vessel"):
        FlightJournal(tmp_path / "one", {**FILES, "vessel.toml": "c"})


def test_a_folder_with_other_things_is_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match="no commissioning"):
        FlightJournal(tmp_path, FILES)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
