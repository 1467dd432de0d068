"""`aritra excite` from end to end: design, judge, fly in the simulator, read the log, propose; the run file's key."""

import json
import re
import time

import msgspec
import pytest

from companion.boat.load_run import EXAMPLES, load_setup, setup_of
from companion.core.configuration.tables import ConfigError
from companion.core.excitation.file import excitation_toml, load_excitation
from companion.logs.log_file import LogFile
from companion.logs.readers.read_run import ReadOptions, read_run
from tests.companion.command_line import exit_code
from tests.support.excitation_fixture import LIBRARY

VESSEL = EXAMPLES / "boats" / "aritra.toml"
FEW = msgspec.structs.replace(
    LIBRARY, segments=tuple(s for s in LIBRARY.segments if s.name in ("sideways turns", "yaw reversals"))
)


@pytest.fixture
def library(tmp_path):
    path = tmp_path / "few.toml"
    path.write_text(excitation_toml(FEW))
    return path


@pytest.mark.long
def test_from_the_design_of_a_plan_to_the_log_and_what_comes_next(tmp_path, library, capsys):
    plan, out = tmp_path / "plan.toml", tmp_path / "flight"
    argv = ["excite", "design", "--minutes", "0.6", "--library", str(library), "--out", str(plan)]
    assert exit_code(*argv, "--picture", str(tmp_path / "plan.png")) == 0
    told = capsys.readouterr().out
    assert "Y_vv_N_s2_m2" in told and "to the fence" in told and (tmp_path / "plan.png").stat().st_size > 10_000
    made = load_excitation(plan.read_text(), name="plan")
    assert {s.name for s in made.segments} <= {s.name for s in FEW.segments}
    assert exit_code("excite", "info", str(plan)) == 0
    assert "known to" in capsys.readouterr().out
    begun_ns = time.time_ns()
    assert exit_code("excite", "fly", str(plan), "--out", str(out), "--seed", "5", "--mismatch", "0.1") == 0
    figures = json.loads((out / "flight.json").read_text())
    assert figures["done"] and figures["least_clearance_m"] > made.margin_m and figures["seed"] == 5
    assert (out / "picture.png").stat().st_size > 10_000
    run = read_run(out / "run.mcap", ReadOptions(truth=out / "truth.mcap"))
    assert begun_ns <= LogFile(out / "run.mcap").wall_offset_ns <= time.time_ns(), "the log begins when it was flown"
    page = tmp_path / "flight.html"
    assert exit_code("log", "page", str(out / "run.mcap"), "--extended", str(VESSEL), "-o", str(page)) == 0
    assert page.stat().st_size > 100_000
    assert run.duration_s > figures["duration_s"] - 1 and run.known("true_u_m_s") and not run.meta.notes
    assert exit_code("excite", "next", "--library", str(library), "--log", str(out / "run.mcap")) == 0
    told = capsys.readouterr().out
    assert "do this next:" in told and "it would bring" in told


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["design", "--out", "x.toml", "--minutes", "0"], "expected a number of minutes"),
        (["info", "none.toml"], "none.toml: No such file"),
        (["next", "--vessel", "none.toml"], "none.toml: No such file"),
        (["next", "--log", "none.mcap"], "none.mcap: No such file"),
        (["fly", "bad.toml", "--out", "out"], "bad.toml: segments[0].kind"),
        (["fly", "strafe.toml", "--out", "out", "--vessel", str(EXAMPLES / "boats" / "twin.toml")], "segments[0].Y"),
    ],
)
def test_bad_input_is_named_by_file_and_key_and_ends_with_2(argv, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    good = next(s for s in LIBRARY.segments if s.name == "strafe")
    text = excitation_toml(msgspec.structs.replace(LIBRARY, segments=(good,)))
    (tmp_path / "strafe.toml").write_text(text)
    (tmp_path / "bad.toml").write_text(text.replace('"steps"', '"stepz"'))
    assert exit_code("excite", *argv) == 2
    assert told in capsys.readouterr().err


# --- the run file's key, and `aritra run --excite` ---------------------------------------------------------


def test_the_run_file_may_name_an_excitation_and_the_command_line_another(tmp_path, library):
    for name in ("boats", "sites", "missions"):
        (tmp_path / name).symlink_to(EXAMPLES / name)
    text = (EXAMPLES / "aritra.toml").read_text()
    run = tmp_path / "my.toml"
    run.write_text(text)
    assert load_setup(run).pilot.excitation is None
    assert load_setup(run, excitation=library).pilot.excitation == FEW
    run.write_text('excitation = "few.toml"\n' + text)
    setup = load_setup(run)
    assert setup.pilot.excitation == FEW and setup.files["excitation.toml"] == library.read_text()
    assert setup_of(setup.files, {name: name for name in setup.files}).pilot.excitation == FEW
    library.write_text(re.sub("margin_m = .*", "margin_m = 14.0", library.read_text()))
    with pytest.raises(ConfigError, match=r"few.toml: margin_m \+ return_m: 17 m"):
        load_setup(run)


def test_run_needs_an_excitation_to_excite(tmp_path, capsys):
    assert exit_code("run", "--excite", "--log", str(tmp_path / "run.mcap")) == 2
    assert "excitation: missing key: --excite needs one" in capsys.readouterr().err
    assert exit_code("run", "--excite", str(tmp_path / "none.toml"), "--log", str(tmp_path / "run.mcap")) == 2
    assert "none.toml: No such file" in capsys.readouterr().err
