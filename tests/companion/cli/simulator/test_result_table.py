"""The demo's end: groups, meanings, a verdict, and what is said of a computer that is too busy."""

import pytest

from companion.cli.simulator import demo
from companion.cli.simulator.result_table import GROUPS, busy, lines, passed, verdict
from tests.companion.command_line import exit_code

GOOD = {"waypoints_total": 5, "waypoints_passed": 5} | {key: 0.123 for rows in GROUPS.values() for key, *_ in rows}
GOOD |= {"ticks": 1130, "leases": 1130, "leases_from_plan": 1068, "simulator_stall_ms": 20.0}


def test_the_table_fits_80_columns_and_explains_every_row():
    *table, last = map(str, lines(GOOD, ""))
    assert max(map(len, table)) <= 78
    assert [line for line in table if not line.startswith("  ")] == [*GROUPS]
    assert len(table) == len(GROUPS) + sum(map(len, GROUPS.values()))
    assert all(row[3] for rows in GROUPS.values() for row in rows)
    assert last == "PASSED: 5 of 5 waypoints, 0.12 m rms off the path, position known to 0.12 m rms."


def test_a_goal_that_was_missed_is_marked():
    table = [str(line) for line in lines(GOOD | {"lateness_p99_ms": 20.4}, "")]
    assert [line.split()[:3] for line in table if line.endswith("goal 10: missed")] == [["late", "by", "20.400"]]
    assert sum("missed" in line for line in table) == 1 and sum("goal" in line for line in table) == 3


def test_a_run_without_a_track_still_has_a_verdict():
    figures = {"waypoints_total": 5, "waypoints_passed": 0, "ticks": 12, "lateness_p99_ms": float("nan")}
    assert str(verdict(figures, "")) == "NOT PASSED: 0 of 5 waypoints."
    shown = [str(line) for line in lines(figures, "")]
    assert any(line.split()[:2] == ["ticks", "12"] for line in shown) and not any("nan" in line for line in shown)


def test_a_boat_that_stopped_has_not_passed_whatever_it_had_passed_before():
    why = "driving was stopped after 109.6 s: this computer is too busy"
    assert passed(GOOD, "") and not passed(GOOD, why)
    first, second = str(verdict(GOOD, why)).splitlines()
    assert first.startswith("NOT PASSED: 5 of 5 waypoints") and second == f"But {why}."


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({}, ""),
        ({"lateness_p99_ms": 49.0}, ""),
        ({"lateness_p99_ms": 140.0}, "1 tick in 100 was over 140 ms late"),
        ({"simulator_stall_ms": 1600.0}, "the simulator stood still for 1.6 s"),
    ],
)
def test_a_busy_computer_is_named(more, said):
    found = busy(GOOD | more)
    assert (said in found) if said else not found
    assert ("this computer is too busy" in str(verdict(GOOD | more, ""))) == bool(said)


def test_earlier_results_are_put_away_and_never_overwritten(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(demo, "drive", lambda args, boats, wires, keys: ["it failed"])
    for number in (0, 1, 2):
        for name in ("run.mcap", "truth.mcap", "run.part1.mcap", "picture.png", "summary.json", "run.html"):
            (tmp_path / name).write_text(f"of demo {number}")
        (tmp_path / "command.key").write_text("stays")
        assert exit_code("demo", "--out", tmp_path) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["command.key", "earlier-1", "earlier-2", "earlier-3"]
    assert {p.read_text() for p in (tmp_path / "earlier-2").iterdir()} == {"of demo 1"}
    out = capsys.readouterr()
    assert "earlier-3" in out.out and "it failed" in out.err


@pytest.mark.parametrize("more", [[], ["--boats", "anna", "--shore"]])
def test_a_second_demo_in_the_same_folder_is_refused_and_touches_nothing(more, tmp_path, monkeypatch, capsys):
    """It put the log of the first one away, which then told a false verdict."""
    words, place = ["demo", "--out", str(tmp_path), *more], tmp_path / "anna" if more else tmp_path
    second = []

    def drive(args, *_):
        (place / "run.mcap").write_text("of the first")
        if not second:
            second.append(None)
            before = {path: path.read_bytes() for path in place.iterdir()}
            assert exit_code(*words) == 2
            assert {path: path.read_bytes() for path in place.iterdir()} == before
        return ["it failed"]

    monkeypatch.setattr(demo, "drive", drive)
    assert exit_code(*words) == 1
    assert f"aritra demo: another demo runs in {place}: choose another --out" in capsys.readouterr().err
    assert exit_code(*words) == 1, "the first one has ended"
