"""`aritra identify` as its user runs it: files in, files out, exit codes, and the boat that drives with the result."""

import json
import re
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.__main__ import main, parser
from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.model.load_vessel import load_vessel
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import Pilot
from companion.jit import compile_loops
from companion.logs.readers.table import read_parquet, write_run
from sim.fitting.identify.record import OUTPUTS, Record
from sim.fitting.taylor.taylor_file import TaylorFile
from sim.fitting.validate import study
from sim.studies.boats.draw import draw_boat
from sim.world.stepped import SteppedRun
from sim.world.teleop_log import teleop_run
from sim.world.world import World, WorldSetup
from tests.support.drive_fixture import CORNER, figures, mission_text, settled
from tests.support.vessel_fixtures import BOATS, boat

FILE = BOATS / "aritra.toml"
TRUE = draw_boat(boat("aritra"), np.random.default_rng(21))
"""Inertia, damping, dead time, lag up to 30 % off the vessel file. Seed 21."""


def exit_code(*argv: object) -> int:
    try:
        return main(["identify", *map(str, argv)])
    except SystemExit as end:
        return int(end.code or 0)


def log(path: Path, seed: int = 21, seconds: float = 120.0) -> Path:
    run = teleop_run(TRUE, seed, seconds)
    arm = tuple(map(float, run.meta.tag_arm_m or (0.0, 0.0)))
    meta = replace(run.meta, tag_arm_m=arm, latency_s=float(run.meta.latency_s or 0.0))
    write_run(type(run)(run.table, meta), path)
    return path


@pytest.fixture(scope="module")
def quick():
    """Ten runs instead of a hundred in the stability test, which is most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "stability", partial(study.stability, runs=10))
        yield


@pytest.fixture(scope="module")
def done(tmp_path_factory, quick):
    """One command, everything it left behind."""
    folder = tmp_path_factory.mktemp("identify")
    source = log(folder / "drive.parquet")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "100")
        code = exit_code(source, "--vessel", FILE, "--out", folder / "out", "--peer")
    read = (folder / "out" / "identify.json").read_bytes()
    return SimpleNamespace(
        code=code, out=folder / "out", log=source, record=msgspec.json.decode(read, type=Record), plain=json.loads(read)
    )


def test_it_ends_well_and_writes_four_files(done):
    assert done.code == 0, done.record.verdict.attention
    assert sorted(p.name for p in done.out.iterdir()) == sorted(OUTPUTS)
    assert done.record.verdict.believe == "structured"


def test_the_identified_boat_is_nearer_the_truth_than_the_file_was(done):
    found, base = load_vessel((done.out / "vessel.toml").read_text(), name="vessel.toml"), boat("aritra")
    for name in ("N_r_N_m_s", "X_uu_N_s2_m2", "Y_vv_N_s2_m2"):
        true = getattr(TRUE.damping, name)
        assert abs(getattr(found.damping, name) / true - 1) < 0.08, name
        assert abs(getattr(found.damping, name) - true) < abs(getattr(base.damping, name) - true) + 0.05 * abs(true)
    assert found.propulsion.dead_time_s == pytest.approx(TRUE.propulsion.dead_time_s, abs=0.01)
    assert "identified" in found.inertia.source


def test_the_record_says_what_it_rests_on(done):
    r = done.record
    (used,) = r.logs
    assert used.data_hash == read_parquet(done.log).data_hash
    assert used.fitted_s[0][1] < used.held_out_s[0][0] == pytest.approx(90.0, abs=0.1)
    assert {m.name for m in r.held_out} == {
        "base file", "Taylor", "Taylor smoothed", "pysindy", "structured", "velocity stays", "velocity is zero",
    }  # fmt: skip
    assert {c.made for c in r.choices} == {"beforehand", "command line", "fitted parts"}
    whats = " ".join(c.what for c in r.choices)
    for wanted in ("held out", "window", "prior", "noise", "latent acceleration", "undetermined", "diverged", "seed"):
        assert wanted in whats
    times = [s.utc for s in r.stamps]
    assert times == sorted(times) and "first time" in r.stamps[-1].what
    assert {"aritra", "numpy", "casadi", "python", "git_revision"} <= set(r.versions)
    assert set(r.files) == set(OUTPUTS) - {"identify.json"}
    assert r.structured.converged and len(r.structured.parameters) == 25
    assert not re.search(r"NaN|Infinity", json.dumps(done.plain))


def test_the_taylor_file_loads_and_is_the_papers(done):
    file = msgspec.json.decode((done.out / "taylor.json").read_bytes(), type=TaylorFile)
    assert file.coefficients.shape == (3, 23) and "Lanczos" in file.source
    assert [s.name for s in done.record.series] == ["Taylor", "Taylor smoothed"]
    assert done.record.series[0].file == file
    peer = np.array(list((done.record.pysindy or {}).values()))
    smoothed = done.record.series[1].file.coefficients
    assert abs(peer[0, 20] / smoothed[0, 20] - 1) < 0.3, "what thrust ahead does to surge: two programs, one number"


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open, self.heads, self._sources = [], [], []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "img"):
            self.open.append(tag)
        self._sources += [(tag, v) for k, v in attrs if k in ("src", "href")]

    def sources(self, tag):
        return [source for name, source in self._sources if name == tag]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "h2":
            self.heads.append(data)


def test_the_report_stands_alone_with_the_verdict_first(done):
    text = (done.out / "report.html").read_text()
    page = _Page()
    page.feed(text)
    assert not page.open, "every tag is closed"
    pictures, links = (page.sources(tag) for tag in ("img", "a"))
    assert all(source.startswith("data:image/png;base64,") for source in pictures) and len(pictures) == 5
    assert links == [f"#s{i + 1}" for i in range(len(page.heads))]
    assert f"{done.log.name} (" in text and 'name="viewport"' in text
    assert not re.search(r"https?://|<script|<link|@import|url\(", text)
    heads = page.heads
    assert heads[0] == "What to believe"
    order = [
        "What to drive next", "Structured model: parameters", "Taylor: 23 terms for each axis, as the paper's Table 2",
        "On data that no fit has seen", "Measured against simulated", "How runs depart and diverge", "Residuals",
        "Stability", "The logs and what is wrong with them", "Every choice, and when it was made",
    ]  # fmt: skip
    assert [heads.index(h) for h in order] == sorted(heads.index(h) for h in order)
    for words in ("None was made on the held-out data", "Believe the structured model", "VIF", "pysindy", "60 s"):
        assert words in text
    assert "nan" not in re.sub(r"base64,[^\"]+|<style>.*?</style>", "", text, flags=re.S).lower().split()


def test_a_second_time_is_refused_and_nothing_is_touched(done, capsys):
    before = {p.name: p.read_bytes() for p in done.out.iterdir()}
    assert exit_code(done.log, "--vessel", FILE, "--out", done.out) == 2
    assert f"{done.out / 'vessel.toml'}: exists already" in capsys.readouterr().err
    assert before == {p.name: p.read_bytes() for p in done.out.iterdir()}


@pytest.mark.long
def test_the_boat_drives_with_the_identified_file(done, tmp_path):
    """Filter and NMPC know the identified boat, the world holds the true one: 14 m, corner, station keeping. Seed 5."""
    text = (EXAMPLES / "aritra.toml").read_text()
    assert 'vessel = "boats/aritra.toml"' in text
    text = text.replace('vessel = "boats/aritra.toml"', f'vessel = "{done.out / "vessel.toml"}"')
    for key in ("sites", "missions"):
        text = text.replace(f'"{key}/', f'"{EXAMPLES / key}/')
    run_file, mission = tmp_path / "run.toml", tmp_path / "corner.toml"
    run_file.write_text(text)
    mission.write_text(mission_text())
    for argv in (["run", "--config", str(run_file), "--start"], ["sim", "--config", str(run_file)]):
        assert parser().parse_args(argv).config == run_file
    setup = load_setup(run_file, mission=mission)
    assert "identified" in setup.pilot.vessel.damping.source
    told = setup.pilot
    patient = replace(told.nmpc, rescue_time_s=60.0)
    solver = Nmpc(
        StructuredModel.of(told.vessel), Actuation.of(told.vessel), patient, lambda: 0.0, compiler=compile_loops
    )
    world = World(WorldSetup(TRUE, told.site, start=(8.0, 8.0, 0.35)), 5)
    driven = SteppedRun(world, Pilot(told), solver.solve)
    assert driven.run(settled(2.0), 90.0), "the mission is not done"
    found = figures(driven, CORNER)
    assert found["cross_track_rms_m"] < 0.15


@pytest.mark.long
def test_alternate_blocks_without_the_series_and_what_must_be_looked_at(tmp_path, capsys, quick):
    """A log whose data was edited after it had been written: done, and told, exit code 1. Seed 22."""
    path, out = log(tmp_path / "edited.csv", 22, 80.0), tmp_path / "out"
    path.write_text(re.sub(r"\d(?=\D*\Z)", lambda last: "1" if last[0] != "1" else "2", path.read_text()))
    assert exit_code(path, "--vessel", FILE, "--out", out, "--block", "20", "--no-taylor") == 1
    told = " ".join(capsys.readouterr().out.split())
    assert "look: " in told and "edited" in told
    assert "[m] [rad] [m/s] [m/s] [rad/s] [%]" in told
    assert sorted(p.name for p in out.iterdir()) == ["identify.json", "report.html", "vessel.toml"]
    found = msgspec.json.decode((out / "identify.json").read_bytes(), type=Record)
    assert found.series == () and found.pysindy is None and len(found.logs[0].held_out_s) == 2
    assert "Look at this first" in (out / "report.html").read_text()


# --- bad input -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def short_log(tmp_path_factory):
    return log(tmp_path_factory.mktemp("short") / "short.csv", seconds=20.0)


@pytest.fixture(scope="module")
def text(short_log):
    return short_log.read_text()


def refused(tmp_path, capsys, *argv) -> str:
    assert exit_code(*argv, "--out", tmp_path / "out") == 2
    told = capsys.readouterr().err
    assert told.startswith("aritra identify: ")
    assert not any((tmp_path / "out" / name).exists() for name in OUTPUTS)
    return told


def test_a_log_that_is_too_short_is_named(short_log, tmp_path, capsys):
    told = refused(tmp_path, capsys, short_log, "--vessel", FILE)
    assert f"{short_log}: 20.0 s; 50 s are the least" in told


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("psi_rad", "psi_deg", "column psi_rad: missing; is it 'psi_deg'?"),
        ("pwm_rear_port", "pwm_aft_port", "but the thrusters of aritra are front_port"),
        ("r_rad_s", "yaw", "column r_rad_s: missing"),
    ],
)
def test_a_wrong_column_is_named(text, tmp_path, capsys, old, new, words):
    path = tmp_path / "log.csv"
    lines = [line.replace(old, new) for line in text.splitlines() if not line.startswith("#")]
    path.write_text("\n".join(lines) + "\n")
    told = refused(tmp_path, capsys, path, "--vessel", FILE)
    assert str(path) in told and words in told


def test_no_position_is_said(tmp_path, capsys):
    run = teleop_run(boat("aritra"), 23, 60.0)
    blind = run.table.with_columns(pl.lit(None, pl.Float64).alias(c) for c in ("north_m", "east_m"))
    write_run(type(run)(blind, run.meta), tmp_path / "blind.csv")
    told = refused(tmp_path, capsys, tmp_path / "blind.csv", "--vessel", FILE)
    assert "north_m: blank throughout; nothing can be identified without position" in told


def test_files_that_are_not_there_or_not_what_they_should_be(short_log, tmp_path, capsys):
    none, bad = tmp_path / "none.csv", tmp_path / "bad.toml"
    bad.write_text(FILE.read_text().replace("mass_kg =", "mass_kgs ="))
    assert f"{none}: No such file" in refused(tmp_path, capsys, none, "--vessel", FILE)
    assert f"{none}: No such file" in refused(tmp_path, capsys, short_log, "--vessel", none)
    assert f"{none}: No such file" in refused(tmp_path, capsys, short_log, "--vessel", FILE, "--held-out", none)
    assert f"{bad}: inertia.mass_kgs: unknown key" in refused(tmp_path, capsys, short_log, "--vessel", bad)
    assert "the following arguments are required: LOG" in refused(tmp_path, capsys, "--vessel", FILE)
    assert "LOG: " in (told := refused(tmp_path, capsys, bad, "--vessel", FILE))
    assert f"{bad}: is a vessel file; expected a log (.mcap" in told


def test_an_autopilots_uwb_log_goes_with_one_log(short_log, tmp_path, capsys):
    two = (short_log, short_log, "--vessel", FILE, "--uwb", short_log)
    assert "--uwb goes with a single LOG" in refused(tmp_path, capsys, *two)
    assert "a UWB log is joined to a .bin or .tlog only" in refused(tmp_path, capsys, short_log, *two[2:])


@pytest.mark.parametrize("value", ["0", "-5", "soon", "nan"])
def test_blocks_have_a_length(short_log, tmp_path, capsys, value):
    assert "expected a number of seconds" in refused(tmp_path, capsys, short_log, "--vessel", FILE, f"--block={value}")


def test_held_out_logs_and_blocks_exclude_each_other(short_log, tmp_path, capsys):
    told = refused(tmp_path, capsys, short_log, "--vessel", FILE, "--block", "60", "--held-out", short_log)
    assert "not allowed with argument" in told


def test_our_own_log_without_a_heading_is_named(drive_log, tmp_path, capsys):
    path = drive_log(10.0)
    told = refused(tmp_path, capsys, path, "--vessel", FILE, "--site", EXAMPLES / "sites" / "basin.toml")
    assert f"{path}: psi_rad: blank throughout" in told
