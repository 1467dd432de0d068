"""`aritra watch` as its user runs it: logs in, one page and one proposed file out, nothing twice."""

import os
import re
from pathlib import Path

import pytest
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES
from companion.core.model.load_vessel import load_vessel
from companion.logs.readers.read_run import read_run
from companion.logs.readers.table import write_run
from companion.logs.runs.run import Run
from sim.world.teleop_log import teleop_run
from tests.companion.command_line import exit_code
from tests.support.vessel_fixtures import boat

FILE = EXAMPLES / "boats" / "aritra.toml"


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> list[Path]:
    """Two logs of a minute, a day apart by the times of their files."""
    folder, out = tmp_path_factory.mktemp("logs"), []
    for seed in (1, 2):
        flown = teleop_run(boat("aritra"), seed, 60.0)
        arm = tuple(map(float, flown.meta.tag_arm_m or (0.0, 0.0)))
        meta = replace(flown.meta, tag_arm_m=arm, latency_s=float(flown.meta.latency_s or 0.0))
        path = folder / f"day{seed}.csv"
        write_run(type(flown)(flown.table, meta), path)
        os.utime(path, (1.7e9, 1.7e9 + 86400 * seed))
        out.append(path)
    return out


def watch(folder: Path, *words: object) -> int:
    return exit_code("watch", *words, "--vessel", FILE, "--history", folder)


@pytest.mark.long
def test_logs_are_taken_in_once_a_bad_one_is_named_and_a_yes_writes_a_new_file(tmp_path, logs, capsys):
    history, bad = tmp_path / "history", tmp_path / "bad.csv"
    bad.write_text("no log\n")
    assert watch(history, logs[1]) == 0
    assert "watched over 1 mission up to" in (history / "proposed.toml").read_text()
    assert watch(history, bad, *logs) == 1
    out = capsys.readouterr().out
    assert str(bad) in out and "1 log taken in, 1 known already; 2 missions" in " ".join(out.split())
    entries = sorted((history / "logs").iterdir())
    assert len(entries) == 2 and "Nothing has changed" in out
    page = (history / "history.html").read_text()
    assert page.count(" UTC, by its file") == 2 and f"{logs[0].parent.name}/day1.csv" in page
    assert page.count("<img") == 2 and "day1.csv" in page and page.index("day1.csv") < page.index("day2.csv")
    assert watch(history, *logs) == 0
    assert sorted((history / "logs").iterdir()) == entries
    assert watch(history, "--accept") == 0
    accepted = history / "accepted-01.toml"
    assert load_vessel(accepted.read_text(), name="x").name == "aritra"
    assert "In force: accepted-01.toml" in (history / "history.html").read_text()
    capsys.readouterr()
    assert exit_code(*["watch", "--vessel", str(accepted), "--history", str(history)]) == 0
    assert "look:" not in capsys.readouterr().out


def test_a_vessel_file_that_is_no_longer_in_force_is_taken_and_said(tmp_path, logs, capsys):
    assert watch(tmp_path, logs[0]) == watch(tmp_path, "--accept") == 0
    assert "look:" not in capsys.readouterr().out
    assert watch(tmp_path) == 0
    text = f"look: --vessel is vessel.toml of this history; in force, and what missions are judged by, is {tmp_path}"
    assert f"{text}/accepted-01.toml: " in capsys.readouterr().out


def test_what_is_wrong_is_said_in_one_sentence(tmp_path, logs, capsys):
    other = EXAMPLES / "boats" / "twin.toml"
    assert watch(tmp_path / "none") == 2
    assert "no such folder" in capsys.readouterr().err
    assert watch(tmp_path / "h", logs[0], "--accept") == 2
    assert "goes without a LOG" in capsys.readouterr().err
    assert watch(tmp_path / "h", logs[0]) == 0
    assert exit_code(*["watch", "--vessel", str(other), "--history", str(tmp_path / "h")]) == 2
    assert "another vessel file" in capsys.readouterr().err
    (tmp_path / "h" / "proposed.toml").write_text("mine")
    assert watch(tmp_path / "h") == 2
    assert "changed by hand" in capsys.readouterr().err


def test_a_log_with_its_gyro_reversed_is_left_out_and_a_doubtful_one_is_told(tmp_path, logs, capsys):
    """The former had all thrusters 70 % weaker; the latter is one whose data was changed since it was written."""
    table, lines = read_run(logs[0]).table, logs[1].read_text().splitlines()
    write_run(Run(table.with_columns(-table["r_rad_s"])), tmp_path / "turned.csv")
    (tmp_path / "edited.csv").write_text("\n".join(lines[:-1]) + "\n")
    assert watch(tmp_path / "history", tmp_path / "turned.csv", tmp_path / "edited.csv") == 1
    told = " ".join(capsys.readouterr().out.split())
    assert re.search(r"left out: \S+turned.csv: .*psi_rad turns -\S+ times .* positive to port\?", told), told
    assert "1 log taken in" in told
    (entry,) = (tmp_path / "history" / "logs").iterdir()
    assert "edited.csv: edited: " in told and f"move {entry} away" in told
    assert "edited.csv: edited: " in (tmp_path / "history" / "history.html").read_text()
