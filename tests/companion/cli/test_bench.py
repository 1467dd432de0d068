"""`aritra bench` from the command line: rows, JSON, exit codes, bad input."""

import re
import sys
from pathlib import Path

import msgspec
import pytest

from companion.__main__ import main
from companion.jit import machine as compiled
from sim.bench import run
from sim.bench.result import (
    SCHEMA,
    Bench,
    BenchRow,
    BenchSettings,
    Growth,
    GrowthPoint,
    MachineInfo,
    SolverRefused,
    read,
)
from tests.companion.command_line import exit_code

DOCS = Path(__file__).resolve().parents[3] / "docs"


def bench(*words: str) -> int:
    return main(["bench", "--solve", "3", "--rounds", "1", *words])


@pytest.mark.long
@pytest.mark.skipif(not compiled.may_run_what_was_written(), reason="the system forbids machine code")
def test_solvers_are_measured_shown_and_written(tmp_path, capsys):
    file = tmp_path / "bench.json"
    assert bench("--only", "solvers", "--json", str(file)) == 0
    out, err = capsys.readouterr()
    found = read(file)
    assert found.schema == SCHEMA and found.refused == () and found.settings.solves == 3
    assert {row.part for row in found.rows} == {"solvers"} and len(found.rows) >= 8
    reference = next(row for row in found.rows if row.reference)
    ours = next(row for row in found.rows if row.name == "RTI, 2 iterations")
    assert reference.name.startswith("IPOPT") and reference.times == pytest.approx(1.0)
    assert ours.times and ours.times > 10 and ours.count == 3
    for row in found.rows:
        assert 0 < row.p50 <= (row.p99 or 0) and row.name in out
    assert found.machine.cores >= 1 and found.machine.versions["casadi"] in out
    assert max(map(len, out.splitlines())) <= 80
    assert "solvers" in err


@pytest.mark.long
def test_cadence_says_whether_it_fits(capsys):
    assert bench("--only", "cadence") == 0
    assert re.search(
        r"The controller (fits|does NOT fit): p99 [\d.]+ .s of the 100 ms of a tick", capsys.readouterr().out
    )


@pytest.mark.long
def test_start_and_simulation_have_their_rows(tmp_path):
    assert bench("--only", "start", "--json", str(tmp_path / "a")) == 0
    rows = read(tmp_path / "a").rows
    assert {row.unit for row in rows} == {"s", "MB"} and len({row.name for row in rows}) == 3
    assert all(row.p50 > 0 for row in rows)
    assert bench("--only", "simulation", "--json", str(tmp_path / "b")) == 0
    assert all(row.p50 > 1 and row.off is not None and row.off < 1e-9 for row in read(tmp_path / "b").rows)


def test_what_cannot_run_is_told_and_is_exit_code_1(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "polars", None)
    assert bench("--only", "fit", "--json", str(tmp_path / "a")) == 1
    assert [one.part for one in read(tmp_path / "a").refused] == ["fit"]
    assert "not run: fit" in capsys.readouterr().out


def test_a_part_that_breaks_down_does_not_lose_the_others(tmp_path, monkeypatch):
    def breaks(order):
        yield BenchRow(part="start", problem="", name="before", unit="s", p50=1.0, count=1)
        raise ZeroDivisionError("no figure")

    monkeypatch.setattr(run, "PARTS", {"start": breaks, "fit-or-start": lambda order: iter(())})
    assert bench("--only", "start", "--json", str(tmp_path / "a")) == 1
    found = read(tmp_path / "a")
    assert [row.name for row in found.rows] == ["before"]
    assert [one.why for one in found.refused] == ["ZeroDivisionError: no figure"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--vessel", "nowhere.toml"), "nowhere.toml: No such file"),
        (("--only", "everything"), "--only everything: no part has that in its name; there are solvers"),
        (("--only", "solvers", "--json", "no/such/folder.json"), "no/such/folder.json: there is no folder"),
    ],
)
def test_bad_input_is_told_before_anything_is_measured(words, said, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert exit_code("bench", *words) == 2
    assert said in capsys.readouterr().err


def test_a_bad_vessel_file_is_told_by_file_and_key(tmp_path, capsys):
    file = tmp_path / "boat.toml"
    file.write_text("format = 1\nname = 3\n")
    assert bench("--vessel", str(file)) == 2
    err = capsys.readouterr().err
    assert "boat.toml" in err and "name" in err


@pytest.mark.parametrize("words", [("--solve", "0"), ("--rounds", "x"), ("--problem", "other")])
def test_bad_arguments_are_refused(words):
    with pytest.raises(SystemExit) as end:
        main(["bench", *words])
    assert end.value.code == 2


@pytest.mark.parametrize("kind", [Bench, BenchRow, SolverRefused, Growth, GrowthPoint, MachineInfo, BenchSettings])
def test_every_key_of_the_json_is_documented(kind):
    words = set(re.findall(r"`([\w.]+)`", (DOCS / "bench.md").read_text()))
    assert {field.encode_name for field in msgspec.structs.fields(kind)} - words == set()


@pytest.mark.matrix
@pytest.mark.long
def test_growth_is_measured_and_drawn(tmp_path):
    picture, file = tmp_path / "growth.png", tmp_path / "growth.json"
    assert bench("--growth", "--only", "horizon", "--json", str(file), "--picture", str(picture)) == 0
    assert picture.stat().st_size > 10_000
    for g in read(file).growth:
        assert g.by == "stages" and [p.size for p in g.points] == [10, 20, 40, 80, 160]
        assert 0.2 < g.exponent < 2.5, g
