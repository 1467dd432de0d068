"""The history on disk: nothing twice, nothing lost, nothing overwritten, whatever ends the program."""

import os
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import polars as pl
import pytest

from companion.boat.load_run import EXAMPLES
from companion.core.configuration.tables import ConfigError
from companion.core.model.load_vessel import load_vessel
from companion.logs.readers.table import read_csv, write_run
from companion.logs.runs.fingerprint import fingerprint
from companion.logs.runs.run import Run, RunMeta
from sim.commission.journal import FlightJournal
from sim.commission.watch import job
from sim.commission.watch.history import LOGS, PAGE, PROPOSED, History, MissionEntry, changed_by_hand, marked
from sim.commission.watch.history import VESSEL as VESSEL_FILE
from sim.commission.watch.mission_fit import boat_effects
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

TEXT, VESSEL = (EXAMPLES / "boats" / "aritra.toml").read_text(), boat("aritra")
NAMES = tuple(e.id for e in boat_effects(VESSEL))
B = len(NAMES)
NOW = 2e9


def entry(day: int, gain: float = 0.0) -> MissionEntry:
    """A made-up log of that day that says front_port gives `gain` more."""
    theta = np.array([gain if n == "thruster_gain:front_port" else 0.0 for n in NAMES])
    precision = np.diag([1e4 if n.startswith("thruster") else 1.0 for n in NAMES])
    return MissionEntry(
        log=f"day{day}.mcap", file_sha256=f"file{day}", data_sha256=f"data{day}".ljust(64, "0"),
        begin_unix_s=1e9 + 86400.0 * day, duration_s=100.0, names=NAMES, precision=precision.tolist(),
        eta=(precision @ theta).tolist(), day={}, latent=(0.01, 0.005, 0.005), thrust=(0.1, 0.06, 0.2),
    )  # fmt: skip


def begun(folder: Path, *days: int) -> History:
    history = History(folder, VESSEL, TEXT)
    for day in days:
        history.add(entry(day, 0.03))
    return history


def test_entries_are_there_again_in_order_of_time(tmp_path):
    begun(tmp_path, 3, 1, 2)
    again = History(tmp_path, VESSEL, TEXT)
    assert [e.log for e in again.entries] == ["day1.mcap", "day2.mcap", "day3.mcap"]
    assert again.entries[0] == entry(1, 0.03)


def test_the_same_course_in_whatever_order_logs_came(tmp_path):
    one, other = begun(tmp_path / "a", 1, 2, 3), begun(tmp_path / "b", 3, 2, 1)
    first, second = job.course_of(one), job.course_of(other)
    assert first and second
    for a, b in zip(first.missions, second.missions, strict=True):
        np.testing.assert_array_equal(a.belief.mean, b.belief.mean)


def test_an_entry_that_was_cut_short_is_not_there_at_all(tmp_path, monkeypatch):
    history = begun(tmp_path, 1)

    def power_cut(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", power_cut)
    with pytest.raises(KeyboardInterrupt):
        history.add(entry(2))
    monkeypatch.undo()
    assert [e.log for e in History(tmp_path, VESSEL, TEXT).entries] == ["day1.mcap"]


def test_another_boats_file_is_refused_and_so_is_none_of_the_accepted_ones(tmp_path):
    begun(tmp_path, 1)
    with pytest.raises(ConfigError, match="another vessel file"):
        History(tmp_path, boat("twin"), TEXT)
    job.watch(History(tmp_path, VESSEL, TEXT), [], now_unix_s=NOW)
    path = job.accept(History(tmp_path, VESSEL, TEXT), NOW)
    again = History(tmp_path, load_vessel(path.read_text(), name="x"), "")
    assert again.accepted and again.given == again.in_force == path.name
    assert History(tmp_path, VESSEL, TEXT).given == VESSEL_FILE


def test_a_damaged_entry_is_named(tmp_path):
    begun(tmp_path, 1)
    (path,) = (tmp_path / LOGS).glob("*.json")
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ConfigError, match=path.name):
        History(tmp_path, VESSEL, TEXT)


def test_a_damaged_acceptance_is_named_with_its_file(tmp_path):
    path = job.accept(begun(tmp_path, 1), NOW).with_suffix(".json")
    path.write_text("{}")
    with pytest.raises(ConfigError, match=r"accepted-01\.json: damaged .* move it away and accepted-01\.toml with it"):
        History(tmp_path, VESSEL, TEXT)


def test_the_folder_of_a_commissioning_is_refused_before_anything_is_made_in_it(tmp_path):
    """Its head was called damaged, to be moved away: without it no commissioning goes on."""
    FlightJournal(tmp_path / "c", {"vessel.toml": TEXT, "site.toml": ""}).begin("signs", {})
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ConfigError, match=r"/c: is the folder of a commissioning; name another"):
        History(tmp_path / "c", VESSEL, TEXT)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", ["notes.txt", "vessel.toml", "logs/run.mcap"])
def test_a_folder_with_other_things_is_refused_and_left_alone(name, tmp_path):
    (path := tmp_path / name).parent.mkdir(exist_ok=True)
    path.write_text(TEXT)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ConfigError, match=rf"holds {name.partition('/')[0]}, and no history; name a new"):
        History(tmp_path, VESSEL, TEXT)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_history_that_ended_before_its_first_file_was_there_goes_on(tmp_path):
    (tmp_path / LOGS).mkdir()
    (tmp_path / ".vessel.toml.123").write_text("form")
    assert History(tmp_path, VESSEL, TEXT).vessel == VESSEL


def test_other_files_in_a_history_are_let_be(tmp_path):
    begun(tmp_path, 1)
    for name in ("settings.json", "logs/notes.json"):
        (tmp_path / name).write_text("{}")
    assert len(History(tmp_path, VESSEL, TEXT).entries) == 1


def test_accepting_writes_a_new_name_each_time_and_overwrites_nothing(tmp_path):
    history = begun(tmp_path, 1, 2)
    job.watch(history, [], now_unix_s=NOW)
    assert "In force: vessel.toml. `--accept` puts" in (tmp_path / PAGE).read_text()
    one = job.accept(history, NOW)
    before = one.read_text()
    assert "In force: accepted-01.toml. It is the proposed one." in (tmp_path / PAGE).read_text()
    with pytest.raises(ConfigError, match="no mission has come since"):
        job.accept(history, NOW)
    history.add(entry(3, 0.06))
    two = job.accept(history, NOW)
    assert one.name == "accepted-01.toml" and two.name == "accepted-02.toml"
    assert one.read_text() == before != two.read_text()


def test_the_accepted_file_is_what_later_missions_are_judged_against(tmp_path):
    history = begun(tmp_path, 1, 2)
    assert [f.any() for f in history.files_in_force(NAMES)] == [False, False]
    job.accept(history, NOW)
    history.add(entry(3))
    assert [f.any() for f in history.files_in_force(NAMES)] == [False, False, True]
    outcome = job.watch(history, [], now_unix_s=NOW)
    assert outcome.in_force == "accepted-01.toml" and outcome.since == (2,)


AHEAD, TODAY, TOMORROW = 7000, 100, 101


def test_a_log_whose_clock_was_ahead_does_not_keep_later_missions_from_counting(tmp_path):
    """Dated 2031, it blocked every yes until then, and missions since its acceptance counted as flown before it."""
    history, now_unix_s = begun(tmp_path, 99, AHEAD), entry(TODAY).begin_unix_s
    job.accept(history, now_unix_s)
    with pytest.raises(ConfigError, match="no mission has come since"):
        job.accept(history, now_unix_s)
    history.add(entry(TODAY))
    again = History(tmp_path, VESSEL, TEXT)
    assert [e.log for e in again.entries] == ["day99.mcap", f"day{TODAY}.mcap", f"day{AHEAD}.mcap"]
    assert again.since == (1,) and [f.any() for f in again.files_in_force(NAMES)] == [False, True, False]
    assert job.accept(again, now_unix_s).name == "accepted-02.toml"
    again.add(entry(TOMORROW))
    assert again.since == (2,)


def test_a_log_that_comes_late_may_be_accepted_and_is_not_judged_by_a_file_of_after_it(tmp_path):
    history = begun(tmp_path, 2, 3)
    job.accept(history, NOW)
    history.add(entry(1))
    assert history.since == () and not np.any(history.files_in_force(NAMES)) and not history.is_accepted
    job.accept(history, NOW)


def test_without_a_log_that_was_moved_away_the_file_may_be_accepted_again(tmp_path):
    job.accept(begun(tmp_path, 1, AHEAD), entry(TODAY).begin_unix_s)
    (path,) = (tmp_path / LOGS).glob(f"{entry(AHEAD).begin_unix_s:.0f}-*")
    path.unlink()
    assert job.accept(History(tmp_path, VESSEL, TEXT), NOW).name == "accepted-02.toml"


def test_an_acceptance_of_an_older_version_is_judged_by_time(tmp_path):
    history = begun(tmp_path, 1, 2)
    record = job.accept(history, NOW).with_suffix(".json")
    record.write_bytes(msgspec.json.encode(msgspec.structs.replace(history.accepted[0], logs=())))
    again = History(tmp_path, VESSEL, TEXT)
    assert again.is_accepted and again.since == ()
    again.add(entry(3))
    assert not again.is_accepted and again.since == (2,)


@pytest.mark.parametrize(("now_unix_s", "doubted"), [(1.6e9, True), (1.8e9, False)])
def test_a_log_that_began_later_than_now_is_doubtful(now_unix_s, doubted, tmp_path, monkeypatch):
    said = entry(2).information()
    monkeypatch.setattr(job, "mission_information", lambda *_: said)
    write_run(Run(flown().table, RunMeta()), path := tmp_path / "day.csv")
    os.utime(path, (1.7e9, 1.7e9))
    history = begun(tmp_path / "history")
    outcome = job.watch(history, [path], now_unix_s=now_unix_s)
    assert outcome.taken == (str(path),)
    told = [text for text in outcome.doubtful if "later than now" in text]
    assert len(told) == doubted and [d for d in history.entries[0].doubts if "later than now" in d] == [
        text.partition(" It counts")[0] for text in told
    ]
    if doubted:
        (kept,) = (history.folder / LOGS).iterdir()
        assert f"{path}: began 2023-11-14 22:12 UTC, by its file, which is later" in told[0]
        assert f"move {kept} away" in told[0]


def test_the_proposed_file_has_what_is_believed_and_loads(tmp_path):
    history = begun(tmp_path, *range(1, 9))
    job.watch(history, [], now_unix_s=NOW)
    proposed = load_vessel((tmp_path / PROPOSED).read_text(), name=PROPOSED)
    gains = {t.name: t.gain for t in proposed.thrusters}
    assert gains["front_port"] == pytest.approx(1.03, abs=0.01)
    assert gains["rear_port"] == pytest.approx(1.0, abs=0.01)


def test_a_part_of_a_log_that_is_known_is_no_new_mission_and_is_told(tmp_path, monkeypatch):
    """A cut of it under another name, on a clock of its own; another log is taken in."""
    run = flown()
    history = begun(tmp_path / "history")
    history.add(msgspec.structs.replace(entry(1), marks=tuple(fingerprint(run).tolist())))
    cut, other = tmp_path / "cut.csv", tmp_path / "other.csv"
    later = run.table.filter(pl.col("t_s") >= 30.0).with_columns(pl.col("t_s") - 30.0)
    write_run(Run(later, RunMeta()), cut)
    write_run(Run(teleop_run(VESSEL, 4, 60.0).table, RunMeta()), other)
    said = entry(2).information()
    monkeypatch.setattr(job, "mission_information", lambda *_: said)
    outcome = job.watch(history, [cut, other], now_unix_s=NOW)
    assert (outcome.known, outcome.taken, outcome.unusable) == ((str(cut),), (str(other),), ())
    assert outcome.in_part == (f"{cut}: one recording with day1.mcap, which is in the history: not taken in again",)
    again = History(history.folder, VESSEL, TEXT)
    assert again.overlapping(fingerprint(read_csv(other))) == str(other)
    assert not begun(tmp_path / "old", 1).overlapping(fingerprint(run)), "an entry of an older version has no marks"


@pytest.mark.parametrize(
    ("boat_of_log", "form", "taken"),
    [("otter", "csv", False), ("otter", "parquet", False), ("aritra", "csv", True), (None, "csv", True)],
)
def test_another_boats_log_is_left_out_in_whatever_form(boat_of_log, form, taken, tmp_path, monkeypatch):
    said = entry(2).information()
    monkeypatch.setattr(job, "mission_information", lambda *_: said)
    monkeypatch.setattr(job, "reject_swapped_columns", lambda _run: None)
    meta = RunMeta(vessel=boat_of_log) if boat_of_log else RunMeta()
    write_run(Run(flown().table, meta), path := tmp_path / f"log.{form}")
    outcome = job.watch(begun(tmp_path / "history"), [path], now_unix_s=NOW)
    assert outcome.taken == ((str(path),) if taken else ())
    why = f"{path}: is of the boat otter, the history is of aritra: name its own history"
    assert outcome.unusable == (() if taken else (why,))


@cache
def flown() -> Run:
    """A minute by hand."""
    return teleop_run(VESSEL, 3, 60.0)


def test_a_proposed_file_that_somebody_has_changed_is_left_alone(tmp_path):
    history = begun(tmp_path, 1)
    job.watch(history, [], now_unix_s=NOW)
    path = tmp_path / PROPOSED
    path.write_text(path.read_text().replace("gain", "gain "))
    mine = path.read_text()
    with pytest.raises(ConfigError, match="changed by hand"):
        job.watch(history, [], now_unix_s=NOW)
    with pytest.raises(ConfigError, match="changed by hand"):
        job.accept(history, NOW)
    assert path.read_text() == mine


def test_a_mark_shows_every_change(tmp_path):
    path = tmp_path / "x"
    path.write_text(marked("a\nb\n"))
    assert not changed_by_hand(path) and not changed_by_hand(tmp_path / "none")
    path.write_text(marked("a\nb\n") + "c")
    assert changed_by_hand(path)


def test_an_acceptance_whose_file_was_not_written_any_more_does_not_count(tmp_path):
    history = begun(tmp_path, 1)
    path = job.accept(history, NOW)
    path.unlink()
    again = History(tmp_path, VESSEL, TEXT)
    assert again.accepted == []
    assert job.accept(again, NOW).name == "accepted-02.toml"
