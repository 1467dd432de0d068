"""Whole diagnoses by the command line, on files: teleoperation of 80 s, seeds 8 to 10, truth taken out."""

import dataclasses
import json
import re
import shlex
import textwrap
from pathlib import Path

import msgspec
import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.__main__ import main
from companion.core.model.load_vessel import load_vessel
from companion.logs.readers.table import write_run
from companion.logs.runs.as_if_blank import DEAD_SENSOR, HELD_READINGS
from companion.logs.runs.run import LogProblem, Run
from sim.fitting.diagnose import job
from sim.fitting.diagnose.catalogue import catalogue, stochastic
from sim.fitting.diagnose.report.findings import OUTPUTS, Adequacy, Check, Findings, Identifiability
from sim.fitting.diagnose.report.page import report
from sim.fitting.diagnose.report.sentences import sentences
from sim.fitting.diagnose.report.verdict import HARMFUL
from sim.fitting.diagnose.selection.distinguishability import Distinguishability
from sim.fitting.diagnose.selection.identifiability import PairwiseEvidence
from sim.fitting.wiring.record import WiringFinding, WiringReport
from sim.world.teleop_log import teleop_run
from tests.companion.command_line import exit_code
from tests.companion.logs.readers.run_logs import clean_run
from tests.sim.fitting.diagnose.catalogue.catalogue_rows import rows
from tests.support.vessel_fixtures import BOATS, boat

VESSEL = boat("aritra")
PAGE = Path(__file__).resolve().parents[4] / "docs" / "diagnose.md"
EXAMPLE = re.search(r"```python\n(# my_effects.py\n.*?)```", PAGE.read_text(), flags=re.S)


def unlabelled(run: Run) -> Run:
    return Run(run.table.select(c for c in run.table.columns if not c.startswith("true_")), run.meta)


def said(folder: Path) -> Findings:
    return msgspec.json.decode((folder / "findings.json").read_bytes(), type=Findings)


@pytest.fixture(scope="module")
def weak(tmp_path_factory):
    """A thruster at half its force: log, results, exit code."""
    folder = tmp_path_factory.mktemp("weak")
    true = replace(
        VESSEL, thrusters=tuple(replace(t, gain=0.5 if i == 0 else 1.0) for i, t in enumerate(VESSEL.thrusters))
    )
    write_run(unlabelled(teleop_run(true, 8, 80.0)), folder / "drive.csv")
    words = f"diagnose {folder}/drive.csv --vessel {BOATS}/aritra.toml --out {folder}/out"
    kept, whole = [], job.diagnose
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(job, "diagnose", lambda *a, **k: kept.append(whole(*a, **k)) or kept[0])
        code = main(shlex.split(words))
    return folder, code, kept[0]


def test_a_weak_thruster_is_named_with_its_size(weak, capsys):
    folder, code, _ = weak
    found = said(folder / "out")
    assert code == 0 and found.verdict == "named"
    (cause,) = found.causes
    gain = cause.parameters["gain"]
    assert cause.name == "thruster_gain:front_port" and gain.ci95[0] < 0.5 < gain.ci95[1] and gain.se < 0.05
    assert cause.evidence_nats > 100 and cause.size > cause.size_low > 1
    assert found.summary[1].startswith("Thruster front_port gives ") and "less thrust" in found.summary[1]


def test_the_gain_is_measured_on_what_was_held_out(weak):
    found = said(weak[0] / "out")
    (log,) = found.logs
    assert log.fitted_s[0][1] < log.held_out_s[0][0]
    position = next(h for h in found.held_out if h.channel == "position" and h.horizon_s == 5)
    assert position.extended is not None and position.refit is not None and position.base is not None
    assert position.extended < min(position.refit, position.base)
    extended, refit, base = (found.one_step_nats[k] or 0.0 for k in ("extended", "refit", "base"))
    assert extended > refit > base


def test_every_file_is_there_and_loads(weak):
    out = weak[0] / "out"
    assert {p.name for p in out.iterdir()} == set(OUTPUTS)
    refitted, numbers, extended = (
        load_vessel((out / name).read_text(), name=name)
        for name in ("refitted.toml", "extended_numbers.toml", "extended.toml")
    )
    gain = said(out).causes[0].parameters["gain"].value
    assert extended.thrusters[0].gain == pytest.approx(numbers.thrusters[0].gain * gain)
    assert 0.9 < numbers.thrusters[0].gain < 1.1
    assert 0.9 < refitted.thrusters[0].gain < 1.1, "the cause must not hide in the refitted base"
    found = said(out)
    assert (found.vessel, found.refitted_vessel, found.extended_vessel) == (
        "extended.toml",
        "refitted.toml",
        "extended_numbers.toml",
    )


def test_the_page_needs_nothing_from_elsewhere(weak):
    page = (weak[0] / "out" / "report.html").read_text()
    assert "<script" not in page and not re.search(r'(src|href)="(?!data:|#)', page)
    assert page.count("data:image/png;base64,") >= 8 and "[m/s^2, m/s^2, rad/s^2], refitted base" in page
    first = page.index("<li>")
    assert "Thruster front_port gives" in page[first : page.index("</ul>")]


def test_what_is_left_over_and_what_cannot_be_told_apart_is_on_the_page(weak):
    found = weak[2]
    checks = (Check(name="autocorrelation of heading", value=0.4, limit=0.1, passed=False),)
    doubt = Adequacy(passed=False, checks=checks, depends_on=("speed", "thruster:rear_port"))
    seen = PairwiseEvidence(("lag", "dead_time"), np.array([[np.nan, 3.0], [49.0, np.nan]]), np.array([40.0, 70.0]))
    apart = Distinguishability(seen, Identifiability(manoeuvre="60 s of spins both ways would."))
    page = report(dataclasses.replace(found, verdict="partial", adequacy=doubt, identifiability=apart))
    for words in (
        "one cause is named, but something is left over",
        "What is left over depends on the speed, perhaps on thruster rear_port.",
        "autocorrelation of heading",
        "These logs cannot tell lag from dead_time (3.0 nats).",
        "60 s of spins both ways would.",
    ):
        assert words in page
    before = (weak[0] / "out" / "report.html").read_text()
    assert page.count("data:image/png") == before.count("data:image/png")


def test_with_nothing_named_the_page_says_what_would_have_been_seen(weak):
    found = dataclasses.replace(weak[2], verdict="none", causes=())
    notes = [LogProblem(kind=kind, text="x") for kind in ("not obeyed", DEAD_SENSOR, HELD_READINGS, "not obeyed")]
    lines, told = sentences(dataclasses.replace(found, problems={"": notes})), ("not obeyed: x (and 1 more)",)
    assert lines[-3:] == [f": {text}." for text in (*told, "dead sensor: x", "held readings: x")]
    assert "nothing is wrong with aritra" in lines[0]
    assert re.match(r"These logs would have shown thruster_gain from \d", lines[1])
    finding = WiringFinding(name="reversed:front_port", text="thruster front_port is reversed", certain=True)
    first, second, *_ = sentences(found.with_wiring(WiringReport(findings=(finding,)), VESSEL))
    assert "front_port is reversed" in first and "put right, nothing else is wrong with aritra" in second
    assert "<h2>The causes" not in report(found)


def test_a_reference_log_that_was_not_calm_is_said(weak):
    noise = weak[2].refit.noise
    for latent, said_so in (((0.5, 0.001, 0.001), True), (noise.latent, False)):
        ambient = dataclasses.replace(noise, latent=latent)
        lines = sentences(dataclasses.replace(weak[2], ambient=ambient, reference="calm.csv"))
        assert any("The reference log calm.csv holds more force" in line for line in lines) == said_so


def test_what_cannot_be_told_apart_is_said(weak):
    """Of two causes the one that is in doubt, also where that one is not named for it."""
    told = {"ambiguous": weak[2].causes * 2, "partial": weak[2].causes}
    for verdict, causes in told.items():
        found = dataclasses.replace(weak[2], verdict=verdict, causes=causes, confused={"wash": ("lag", "tether")})
        said_so = [line for line in sentences(found) if line.startswith("These logs cannot tell")]
        assert said_so == ["These logs cannot tell wash from lag, tether."]
        assert found.ambiguous_with == ("lag", "tether")


def test_results_are_never_overwritten(weak, capsys):
    folder, _, _ = weak
    words = f"diagnose {folder}/drive.csv --vessel {BOATS}/aritra.toml --out {folder}/out"
    assert main(shlex.split(words)) == 2
    assert "refitted.toml: exists already" in capsys.readouterr().err


@pytest.mark.long
def test_an_effect_of_ones_own_is_named_from_outside_the_package(tmp_path):
    """The example of docs/diagnose.md: soft iron, put into a clean log by hand; a reference log from before."""
    assert EXAMPLE
    (tmp_path / "my_effects.py").write_text(EXAMPLE[1])
    run = unlabelled(teleop_run(VESSEL, 9, 80.0))
    psi = pl.col("psi_rad")
    bent = run.table.with_columns(psi_rad=psi + np.radians(5.0) * (2 * psi).sin())
    wrapped = bent.with_columns(psi_rad=pl.arctan2(psi.sin(), psi.cos()))
    write_run(Run(wrapped, run.meta), tmp_path / "drive.csv")
    write_run(unlabelled(teleop_run(VESSEL, 10, 40.0)), tmp_path / "calm.csv")
    words = f"diagnose {tmp_path}/drive.csv --vessel {BOATS}/aritra.toml --out {tmp_path}/out"
    more = f" --catalogue {tmp_path}/my_effects.py --reference {tmp_path}/calm.csv"
    assert main(shlex.split(words + more)) == 0
    found = said(tmp_path / "out")
    (cause,) = found.causes
    low, high = cause.parameters["amplitude_deg"].ci95
    assert cause.name == "soft_iron" and low < 5.0 < high
    assert "soft_iron" in found.not_in_file and found.noise_card.ambient is not None


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("--reference {tmp}/none.csv", "none.csv: No such file"),
        ("--catalogue {tmp}/bad.py", "bad.py: defines no function effects(vessel)"),
        ("--held-out {tmp}/drive.csv", "holds the same data as"),
        ("--block 5", "20 s are the least"),
    ],
)
@pytest.mark.long
def test_bad_input_is_named(tmp_path, capsys, more, words):
    write_run(unlabelled(teleop_run(VESSEL, 8, 60.0)), tmp_path / "drive.csv")
    (tmp_path / "bad.py").write_text("x = 1\n")
    line = f"diagnose {tmp_path}/drive.csv --vessel {BOATS}/aritra.toml --out {tmp_path}/out " + more.format(
        tmp=tmp_path
    )
    assert exit_code(*shlex.split(line)) == 2
    error = capsys.readouterr().err
    assert error.startswith("aritra diagnose: ") and words in error
    assert not (tmp_path / "out" / "findings.json").exists()


@pytest.fixture(scope="module")
def drive() -> Run:
    return unlabelled(teleop_run(VESSEL, 8, 60.0))


def silent(run: Run, begin_s: float, end_s: float, *columns: str) -> Run:
    there = pl.col("t_s").is_between(begin_s, end_s)
    return Run(run.table.with_columns(pl.when(~there).then(pl.col(c)).alias(c) for c in columns), run.meta)


PLACES = ("north_m", "east_m")
PULSES = tuple(f"pwm_{thruster.name}" for thruster in VESSEL.thrusters)


@pytest.mark.parametrize(
    ("alter", "more", "words"),
    [
        (lambda run: Run(run.table[:5], run.meta), "--reference {bad}", "0.0 s with heading and commands is too short"),
        (lambda run: silent(run, 2.0, 60.0, *PLACES), "--held-out {bad}", "0 positions while heading and commands"),
        (lambda run: silent(run, 0.0, 50.0, *PULSES), "{bad}", "the fit needs commands; at no time all of pwm_front_"),
        (lambda run: silent(run, 40.0, 60.0, *PLACES), "{bad}", "39.97 to 59.97 s: the fit needs psi_rad and north_m"),
        (lambda run: run, "{bad} --block 50", "no two blocks of 50 s; choose shorter blocks"),
    ],
)
def test_a_log_that_holds_too_little_is_named_before_the_search(
    tmp_path, capsys, monkeypatch, drive, alter, more, words
):
    def searched(*_):
        raise AssertionError("the search is long")

    monkeypatch.setattr(job, "search_causes", searched)
    good, bad = tmp_path / "drive.csv", tmp_path / "bad.csv"
    write_run(drive, good)
    write_run(alter(drive), bad)
    logs = more.format(bad=bad) if more.startswith("{bad}") else f"{good} {more.format(bad=bad)}"
    assert main(shlex.split(f"diagnose {logs} --vessel {BOATS}/aritra.toml --out {tmp_path}/out")) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"aritra diagnose: {bad}") and words in error


def test_the_page_of_the_documents_has_every_effect_as_it_is():
    text = PAGE.read_text()
    for row in rows(VESSEL, (*catalogue(VESSEL, [clean_run(60.0)]), *stochastic.effects())):
        assert row in text, textwrap.fill(row)


def test_findings_are_plain_json(weak):
    data = json.loads((weak[0] / "out" / "findings.json").read_text())
    assert set(data) >= {"verdict", "causes", "ambiguous_with", "depends_on", "refitted_vessel", "extended_vessel"}
    assert data["causes"][0]["parameters"]["gain"]["ci95"][0] < 0.5


@pytest.mark.long
def test_what_is_known_to_be_there_is_fitted_and_nothing_else_is_looked_for(weak, tmp_path, capsys):
    """A yaw inertia that was not changed comes out as next to nothing beside the thruster that was."""
    words = f"diagnose {weak[0]}/drive.csv --vessel {BOATS}/aritra.toml --no-report --out {tmp_path}/out"
    believed = " --believe thruster_gain:front_port --believe yaw_inertia --believe rate_limit"
    assert main(shlex.split(words + believed)) == 0
    found = {c.name: c for c in said(tmp_path / "out").causes}
    assert set(found) == {"thruster_gain:front_port", "yaw_inertia", "rate_limit"}
    assert found["rate_limit"].size_low >= 0.0, "though there is none, and slowness cannot be less than nil"
    gain, inertia = found["thruster_gain:front_port"].parameters["gain"], found["yaw_inertia"].parameters["I_z_kg_m2"]
    assert gain.ci95[0] < 0.5 < gain.ci95[1] and inertia.ci95[0] < 0 < inertia.ci95[1]
    assert main(shlex.split(f"{words}2 --believe teather")) == 2
    assert "believe 'teather': no such effect; there are " in capsys.readouterr().err


@pytest.mark.long
def test_causes_that_do_harm_on_held_out_logs_are_taken_back_and_told(weak, monkeypatch):
    """As if the held-out readings had become worse: no name is left, and the files are those of the refitted base."""
    monkeypatch.setattr(job, "held_out_objection", lambda _verdict, _score: HARMFUL)
    run = weak[2].split.used[0].log.run
    found = job.diagnose([run], VESSEL, identifiability=None)
    assert found.verdict == "unknown" and not found.causes and not found.selection.causes
    assert found.withdrawn == {"thruster_gain:front_port": HARMFUL}
    assert found.files.extended == found.files.refitted and found.selection.final is found.selection.base
    told = (
        "thruster_gain:front_port was found in the fitted logs, but is not named: readings of the held-out logs become"
    )
    assert any(line.startswith(told) for line in sentences(found))
    many = dataclasses.replace(found, withdrawn={"lag": HARMFUL, "wash": "of chance", "cg_shift": HARMFUL})
    assert any(
        line.startswith("lag and cg_shift were found in the fitted logs, but are not") for line in sentences(many)
    )
    assert "wash was found in the fitted logs, but is not named: of chance." in sentences(many)
    assert found.adequacy is not None and not found.adequacy.passed, "the base alone leaves the thruster over"
    assert found.held_out.nats["extended"] == pytest.approx(found.held_out.nats["refit"]), "as in the files"
