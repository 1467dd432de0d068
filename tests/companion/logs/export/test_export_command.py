"""`aritra log export`: what people and scripts see."""

import json
import resource
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from companion.boat.load_run import EXAMPLES
from companion.cli import log
from companion.core.messages import GroundTruth
from companion.logs.readers.read_run import read_run
from companion.logs.readers.table import write_run
from companion.logs.runs.run import Run
from tests.companion.command_line import exit_code
from tests.companion.logs.readers.run_logs import clean_run, dataflash, record, simulated

NEED_POLARS = ("companion.logs.runs", "companion.logs.readers", "sim.fitting")


def run(*argv: object) -> int:
    return exit_code("log", "export", *argv)


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("export")
    boat = record(folder / "boat.mcap", [x for x in simulated() if not isinstance(x, GroundTruth)])
    return boat, record(folder / "truth.mcap", [x for x in simulated() if isinstance(x, GroundTruth)])


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_log_with_its_truth_becomes_a_table(logs, tmp_path, capsys, monkeypatch, ending):
    monkeypatch.setenv("COLUMNS", "120")
    out = tmp_path / f"run.{ending}"
    assert run(logs[0], "--out", out, "--truth", logs[1]) == log.OK
    told = capsys.readouterr().out
    back = read_run(out)
    assert back.known("true_u_m_s")
    for wanted in (f"wrote {out}", back.data_hash[:12], "vessel aritra", "r_rad_s", "50.00", "no problems found"):
        assert wanted in told


def test_scripts_get_one_object(logs, tmp_path, capsys):
    out = tmp_path / "run.parquet"
    assert run(logs[0], "-o", out, "--json") == log.OK
    told = json.loads(capsys.readouterr().out)
    back = read_run(out)
    assert (told["rows"], told["data_hash"], told["vessel"]) == (back.table.height, back.data_hash, "aritra")
    assert told["rates_hz"]["psi_rad"] == pytest.approx(50.0)
    assert told["problems"] == []


def test_a_clean_run_says_so_and_many_problems_are_counted(tmp_path, capsys):
    path = tmp_path / "a.csv"
    write_run(clean_run(20.0), path)
    assert run(path, "-o", tmp_path / "b.parquet") == log.OK
    assert "no problems found" in capsys.readouterr().out
    holes = clean_run(60.0).table
    t = holes["t_s"]
    write_run(Run(holes.filter((t % 10) > 1.0)), path)
    assert run(path, "-o", tmp_path / "c.parquet") == log.OK
    assert "... and 2 more (--json lists all)" in capsys.readouterr().out


def test_a_damaged_log_is_exit_code_1(logs, tmp_path, capsys):
    path = tmp_path / "cut.mcap"
    path.write_bytes(logs[0].read_bytes()[:-60_000])
    assert run(path, "-o", tmp_path / "a.csv", "--vessel", EXAMPLES / "boats" / "aritra.toml") == log.DAMAGED
    assert "damaged: 1" in capsys.readouterr().out


def test_what_cannot_be_done_is_exit_code_2_with_the_file(logs, tmp_path, capsys):
    broken = tmp_path / "vessel.toml"
    broken.write_text("format = 2\n")
    for argv, told in (
        ([tmp_path / "absent.mcap", "-o", tmp_path / "a.csv"], "absent.mcap: No such file"),
        ([tmp_path / "absent.csv", "-o", tmp_path / "a.csv"], "absent.csv: No such file"),
        ([logs[0], "-o", tmp_path / "a.xlsx"], "a.xlsx: a run is written as"),
        ([logs[0], "-o", tmp_path / "no" / "a.csv"], "a.csv: there is no folder"),
        ([logs[0], "-o", logs[0]], "this is the log itself"),
        ([logs[0], "-o", tmp_path / "a.csv", "--vessel", broken], "vessel.toml: "),
        ([logs[0], "-o", tmp_path / "a.csv", "--uwb", logs[1]], "UWB log is joined"),
    ):
        assert run(*argv) == log.IMPOSSIBLE
        assert told in capsys.readouterr().err


@pytest.mark.parametrize("form", ["csv", "parquet", "geojson", "foxglove", "rosbag2"])
def test_an_ardupilot_log_is_named_where_only_our_own_can_be_written(tmp_path, capsys, form):
    path = tmp_path / "boat.bin"
    path.write_bytes(dataflash([]))
    assert run(path, f"--{form}", "-o", tmp_path / "out") == log.IMPOSSIBLE
    told = f"{path}: is an ArduPilot log (.bin); expected a log of `aritra run` (.mcap); without --{form} it becomes"
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@contextmanager
def full_disk():
    """No file may grow beyond 500 bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    ("words", "out", "named"),
    [
        ((), "a.csv", "a.csv"),
        ((), "a.csv.gz", "a.csv.gz"),
        ((), "a.parquet", "a.parquet"),
        (("--csv",), "there", "there/attitude.csv"),
        (("--parquet",), "new", "new/alert.parquet"),
        (("--foxglove",), "a.mcap", "a.mcap"),
        (("--rosbag2",), "bag", "bag"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else value,
)
def test_a_full_disk_is_told_with_the_file_and_leaves_nothing_in_the_way(logs, tmp_path, capsys, words, out, named):
    (tmp_path / "there").mkdir()
    mine = tmp_path / "there" / "notes.txt"
    mine.write_text("mine")
    with full_disk():
        assert run(logs[0], *words, "-o", tmp_path / out) == log.IMPOSSIBLE
    told = capsys.readouterr().err
    assert told.startswith(f"aritra log: {tmp_path / named}: ") and "File too large" in told
    assert set(tmp_path.rglob("*")) == {tmp_path / "there", mine}
    assert run(logs[0], *words, "-o", tmp_path / out) == log.OK


def test_without_polars_it_says_what_to_install(logs, tmp_path, capsys, monkeypatch):
    for name in [n for n in sys.modules if n.startswith(NEED_POLARS)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "polars", None)
    assert run(logs[0], "-o", tmp_path / "a.csv") == log.IMPOSSIBLE
    assert "`make install` in a checkout" in capsys.readouterr().err
