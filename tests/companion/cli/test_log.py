"""`aritra log`: what people and scripts see."""

import json
from pathlib import Path

import pytest

from companion.boat.recorder import Recorder
from companion.cli import log
from companion.core.messages import Battery
from companion.logs.schema import KINDS
from tests.companion.command_line import exit_code


def run(*argv: object) -> int:
    return exit_code("log", *argv)


def cut(path: Path) -> Path:
    path.write_bytes(path.read_bytes()[:-20_000])
    return path


def test_info_tells_people_what_is_in_the_log(drive_log, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    assert run("info", drive_log(10.0)) == log.OK
    out = capsys.readouterr().out
    for wanted in ("synthetic", "/override_lease", "plan 94, shifted_plan 6", "thruster 2 near its limit", "10.00"):
        assert wanted in out


def test_damage_of_the_truth_is_told_with_a_picture_and_counts(drive_log, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("companion.logs.export.plot.plot", lambda _log, _out, truth: list(truth.messages()))
    whole, truth = drive_log(5.0), tmp_path / "simulator.mcap"
    truth.write_bytes(whole.read_bytes()[:-20_000])
    assert run("plot", whole, "--truth", truth) == log.DAMAGED
    assert str(truth) in capsys.readouterr().out


def test_info_tells_scripts_the_same(drive_log, capsys):
    assert run("info", "--json", drive_log(10.0)) == log.OK
    summary = json.loads(capsys.readouterr().out)
    topics = {topic["topic"]: topic for topic in summary["topics"]}
    assert topics["/tick"]["messages"] == 100
    assert topics["/tick"]["rate_hz"] == pytest.approx(10.0)
    assert topics["/uwb_position"]["largest_gap_s"] == pytest.approx(0.5)
    assert topics["/tick"]["missing"] == 0
    assert summary["leases"] == {"plan": 94, "shifted_plan": 6}
    assert summary["plans"] == {"ok": 100}
    assert summary["alerts"] == [{"t_s": 10.0, "level": "warning", "text": "thruster 2 near its limit"}]
    assert summary["duration_s"] == pytest.approx(10.0)
    assert summary["unknown"] == summary["undecodable"] == {}
    assert summary["damage"] == []


def test_a_damaged_log_is_told_and_recovered(drive_log, capsys):
    path = cut(drive_log(10.0))
    assert run("info", path) == log.DAMAGED
    assert "recover" in capsys.readouterr().out
    assert run("recover", path) == log.DAMAGED
    out = capsys.readouterr().out
    assert "kept" in out
    assert "last message at t =" in out
    assert run("info", path.with_name("drive.recovered.mcap")) == log.OK


def test_a_log_whose_first_part_is_empty_is_read_from_the_others(drive_log, capsys):
    path = drive_log(10.0)
    path.rename(path.with_name("drive.part1.mcap"))
    path.touch()
    assert run("info", path) == log.DAMAGED
    assert f"{path}: the file is empty" in capsys.readouterr().out.replace("\n", "")
    assert run("recover", path) == log.DAMAGED
    assert run("info", path.with_name("drive.recovered.mcap")) == log.OK
    path.with_name("drive.part1.mcap").unlink()
    assert run("info", path) == log.IMPOSSIBLE
    assert "is empty" in capsys.readouterr().err


def test_messages_of_another_version_are_told_and_no_copy_is_advised(drive_log, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setitem(KINDS, "/tick", Battery)
    assert run("info", drive_log(1.0)) == log.DAMAGED
    told = capsys.readouterr().out
    assert "/tick: 10 messages do not fit their class in this version: left out" in told
    assert "sound copy" not in told


@pytest.mark.parametrize("command", ["info", "plot", "recover"])
def test_what_cannot_be_read_is_exit_code_2_with_the_path(command, tmp_path, capsys):
    assert run(command, tmp_path / "absent.mcap") == log.IMPOSSIBLE
    assert "absent.mcap: " in capsys.readouterr().err


def test_an_empty_log_has_facts_but_no_picture(tmp_path, capsys):
    path = tmp_path / "empty.mcap"
    Recorder(path, {}, lambda: 0, wall_offset_ns=0).close()
    assert run("info", path) == log.OK
    assert run("plot", path) == log.IMPOSSIBLE
    assert "nothing to plot" in capsys.readouterr().err


@pytest.mark.long
def test_plot_writes_the_picture_beside_the_log(drive_log, capsys):
    path = drive_log(5.0)
    assert run("plot", path) == log.OK
    assert str(path.with_suffix(".png")) in capsys.readouterr().out
    assert path.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def test_a_picture_that_cannot_be_written_is_told(drive_log, tmp_path, capsys):
    path = drive_log(2.0)
    assert run("plot", path, "-o", tmp_path / "absent" / "a.png") == log.IMPOSSIBLE
    assert "a.png" in capsys.readouterr().err
