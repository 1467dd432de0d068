"""Identification without files: the split, the verdict, errors for logs that cannot be used."""

import dataclasses
from itertools import count
from unittest.mock import ANY

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.problems import problems
from companion.logs.runs.run import LogProblem, Run, RunMeta
from sim.fitting.engine.parameters import WARP, Parameters, file_values
from sim.fitting.engine.split import JobError, NamedLog, split
from sim.fitting.identify.advice import MANOEUVRES, advice
from sim.fitting.identify.chosen_fit import ChosenFit
from sim.fitting.identify.report.tables import parameter_table
from sim.fitting.identify.result import Estimate, FitResult, ResidualChannel, fit_structured
from sim.fitting.identify.structured_fit import FitSettings
from sim.fitting.identify.trials import Trial
from sim.fitting.identify.verdict import NAMES, NEEDED, relative_error, verdict
from sim.fitting.validate.models import ConstantVelocity, ZeroVelocity
from sim.fitting.validate.protocol import CHANNELS
from sim.fitting.validate.scores import Score, SpeedBox
from sim.fitting.validate.stability import Stability
from sim.fitting.validate.study import Validation
from sim.fitting.validate.windows import HeldOutWindows
from sim.world.teleop_log import teleop_run
from tests.companion.logs.readers.run_logs import clean_run, record, simulated
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
NAMES_OF = Parameters(VESSEL).names


@pytest.fixture(scope="module")
def run() -> Run:
    return teleop_run(VESSEL, 8, 80.0)


def changed(run: Run, **columns) -> Run:
    return Run(run.table.with_columns(**columns), run.meta)


def blank(run: Run, *columns: str) -> Run:
    return changed(run, **{c: pl.lit(None, pl.Float64) for c in columns})


def test_the_last_quarter_is_held_out_and_nothing_is_in_both(run):
    found = split([NamedLog("a.csv", run)], [], VESSEL)
    (used,) = found.used
    (fitted,), (out,) = used.fitted_s, used.held_out_s
    assert fitted[1] < out[0] == pytest.approx(60.0, abs=0.1)
    assert found.fitted[0].measured_s()[-1] < out[0]
    assert found.held_out[0].inside == (out,)
    assert "last 25 %" in found.rule


def test_named_logs_are_held_out_whole_and_others_fitted_whole(run):
    other = teleop_run(VESSEL, 9, 40.0)
    found = split([NamedLog("a.csv", run)], [NamedLog("b.csv", other)], VESSEL)
    assert found.held_out[0].inside is None and found.held_out[0].run.meta.source == "b.csv"
    assert found.fitted[0].table.height == run.table.height
    assert found.used[1].fitted_s == ()


def test_alternate_blocks(run):
    found = split([NamedLog("a.csv", run)], [], VESSEL, block_s=20.0)
    assert [round(r.measured_s()[0]) for r in found.fitted] == [0, 40]
    assert found.held_out[0].inside is not None and len(found.held_out[0].inside) == 2


def test_thrusters_are_put_into_the_vessel_files_order(run):
    names = [c for c in run.table.columns if c.startswith("pwm_")]
    others = [c for c in run.table.columns if c not in names]
    turned = Run(run.table.select(*others, *reversed(names)), run.meta)
    assert split([NamedLog("a.csv", turned)], [], VESSEL).fitted[0].thrusters == tuple(t.name for t in VESSEL.thrusters)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda r: ([], []), "no log to fit"),
        (lambda r: ([clean_run(60.0)], []), r"log0: columns pwm_left, pwm_right, but the thrusters of aritra are"),
        (lambda r: ([blank(r, "north_m", "east_m")], []), r"log0: north_m: blank throughout.*--uwb"),
        (lambda r: ([blank(r, "psi_rad")], []), r"log0: psi_rad: blank throughout"),
        (lambda r: ([changed(r, psi_rad=pl.lit(0.0))], []), r"log0: psi_rad: the same value throughout"),
        (lambda r: ([blank(r, "pwm_rear_port")], []), r"log0: pwm_rear_port: blank throughout"),
        (lambda r: ([short(r, 45.0)], []), r"log0: 45\.0 s; 50 s are the least when its last part is held out"),
        (lambda r: ([with_pause(short(r, 45.0), 20.0)], []), r"log0: 45\.0 s beside 1 pauses of the recording; 50 s"),
        (lambda r: ([short(r, 25.0)], [teleop_run(VESSEL, 9, 40.0)]), r"log0: 25\.0 s; 30 s are the least to fit"),
        (lambda r: ([r], [teleop_run(VESSEL, 9, 15.0)]), r"log1: 1\d\.\d s; 20 s are the least to be held out"),
        (lambda r: ([r], [r]), r"log1: holds the same data as log0"),
        (lambda r: ([r], [later(r, 50.0)]), r"log1: holds positions of log0: one is a part of the other"),
        (lambda r: ([later(r, 30.0), short(r, 50.0)], []), r"log1: holds positions of log0"),
        (lambda r: ([r, r], []), r"log1: holds the same data as log0"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_named(run, make, words):
    number = count()
    logs, held_out = ([NamedLog(f"log{next(number)}", r) for r in runs] for runs in make(run))
    with pytest.raises(JobError, match=words):
        split(logs, held_out, VESSEL)


def test_accelerations_that_are_zero_throughout_are_blank_and_looked_at(run):
    """A log without an IMU whose columns were filled with zeros."""
    zeros = changed(teleop_run(VESSEL, 9, 80.0), ax_m_s2=pl.lit(0.0), ay_m_s2=pl.lit(0.0))
    division = split([NamedLog("a.csv", run), NamedLog("b.csv", zeros)], [], VESSEL)
    assert [used.log.run.known("ax_m_s2") for used in division.used] == [True, False]
    assert not any(piece.known("ay_m_s2") for piece in division.fitted[1:])
    found = verdict(chosen(), validation(structured=0.1), {u.log.name: problems(u.log.run) for u in division.used})
    assert found.attention == (
        "b.csv: dead sensor: ax_m_s2, ay_m_s2: the same value in every sample, which no sensor gives: left out, as if "
        "blank.",
    )


def with_pause(run: Run, at_s: float) -> Run:
    """The recording stood still for 300 s after `at_s`."""
    return changed(run, t_s=pl.col("t_s") + pl.when(pl.col("t_s") > at_s).then(300.0).otherwise(0.0))


def test_a_pause_of_the_recording_is_neither_fitted_nor_counted(run):
    """What was commanded meanwhile is unknown; the last quarter is one of what was recorded."""
    paused = with_pause(run, 30.0)
    found = split([NamedLog("a.csv", paused)], [], VESSEL)
    (used,) = found.used
    fitted, out = (np.array(intervals) for intervals in (used.fitted_s, used.held_out_s))
    assert fitted == pytest.approx(np.array([(0.0, 30.0), (330.0, 360.0)]), abs=0.1)
    assert out == pytest.approx(np.array([(360.0, 380.0)]), abs=0.1)
    assert [np.diff(piece.measured_s()).max() < 0.5 for piece in found.fitted] == [True, True]
    assert found.fitted[1].commands()[0][0] >= 330.0
    about = dict(found.about(VESSEL))
    assert (about["Logs"], about["Of them"]) == ("a.csv (80 s)", "60 s fitted, 20 s held out")
    assert "cut at pauses and resets (1 times)" in found.rule
    held_out = (
        split([NamedLog("b.csv", teleop_run(VESSEL, 9, 80.0))], [NamedLog("a.csv", paused)], VESSEL).held_out[0].inside
    )
    assert np.array(held_out) == pytest.approx(np.array([(0.0, 30.0), (330.0, 380.0)]), abs=0.1)


@pytest.mark.parametrize(("block_s", "words"), [(10.0, "20 s are the least"), (70.0, "hold no two blocks of 70 s")])
def test_blocks_that_do_not_fit_are_refused(run, block_s, words):
    with pytest.raises(JobError, match=words):
        split([NamedLog("a.csv", run)], [], VESSEL, block_s=block_s)


def test_a_log_of_ours_has_the_vessel_files_thrusters(tmp_path):
    """15 s of the stepped world: read, and refused for its length alone."""
    run = read_run(record(tmp_path / "run.mcap", simulated()), ReadOptions(VESSEL))
    with pytest.raises(JobError, match=r"run\.mcap: 1\d\.\d s; 50 s are the least"):
        split([NamedLog("run.mcap", run)], [], VESSEL)


def later(run: Run, begin_s: float) -> Run:
    """From `begin_s` on, on a clock that begins at 0 again."""
    return Run(run.table.filter(pl.col("t_s") >= begin_s).with_columns(pl.col("t_s") - begin_s), RunMeta())


def short(run: Run, seconds: float) -> Run:
    return Run(run.table.filter(pl.col("t_s") <= seconds), RunMeta())


# --- the verdict, from made-up scores ------------------------------------------------------------------------


def score(name: str, error: float, channels=CHANNELS) -> Score:
    """rms `error` in `channels`, 1 in the others; the baselines have 1 everywhere."""
    rms = {c: np.full(3, error if c in channels else 1.0) for c in CHANNELS}
    zero, nothing = np.zeros(3), {}
    return Score(name, (10, 20, 30), np.full(3, 9), zero, rms, rms, rms, nothing, nothing, nothing)


def validation(**errors: float) -> Validation:
    scores = [score(NAMES[k], e) for k, e in errors.items()]
    scores += [score(ConstantVelocity().name, 1.0), score(ZeroVelocity().name, 2.0)]
    stable = tuple(Stability(s.name, 0.0, 0.0, 1.0, 100) for s in scores)
    nothing = np.zeros((9, 301, 6))
    windows = HeldOutWindows(nothing[:, 0], nothing, None, np.zeros(9))  # type: ignore[arg-type]  # commands: not looked at
    return Validation("x", (), (), windows, SpeedBox(np.zeros(3), np.ones(3)), tuple(scores), stable, ())


def fit(undetermined=(), *, converged=True, white=True) -> FitResult:
    estimates = tuple(
        Estimate(name=n, value=v, se=0.1, ci95=(v - 0.2, v + 0.2), unit="1", determined=n not in undetermined,
                 share_of_prior=0.9 if n in undetermined else 0.1)
        for n, v in zip(NAMES_OF, file_values(VESSEL), strict=True)
    )  # fmt: skip
    return FitResult(
        parameters=estimates, covariance=(), directions=(), latent=(0, 0, 0), latent_share=(0, 0, 0), window_s=2.0,
        channels=(ResidualChannel(name="psi", count=100, sigma=1.0, rms=1.0, lag1=0.0 if white else 0.5),), white=white,
        samples=100, fixes=10, iterations=5, converged=converged, seconds=1.0, data_hashes=("a",), vessel="x",
    )  # fmt: skip


def chosen(undetermined=(), **more) -> ChosenFit:
    return ChosenFit(VESSEL, FitSettings(), fit(undetermined, **more), "a test")


@pytest.mark.parametrize(("first", "shorter", "taken"), [(True, True, 1), (True, False, 0), (False, False, 1)])
def test_shorter_windows_that_do_not_converge_replace_none_that_do(monkeypatch, run, first, shorter, taken):
    found = [fit(converged=converged, white=False) for converged in (first, shorter)]
    fits = iter(found)
    monkeypatch.setattr("sim.fitting.identify.result.solve", lambda *_: (None, 0))
    monkeypatch.setattr("sim.fitting.identify.result.fit_result", lambda *_: next(fits))
    assert fit_structured([run], VESSEL) == replace(found[taken], seconds=ANY)


def test_the_relative_error_is_a_geometric_mean_over_channels_and_horizons():
    half = score("half", 0.25, channels=CHANNELS[:2])
    assert relative_error(half, [half, score("velocity stays", 1.0)]) == pytest.approx(0.25 ** (2 / 5))
    gone = score("gone", np.inf)
    assert relative_error(gone, [gone, score("velocity stays", 1.0)]) == np.inf


@pytest.mark.parametrize(
    ("errors", "believe", "begins", "doubts"),
    [
        ({"base": 0.5, "taylor": 0.6, "structured": 0.1}, "structured", "Believe the structured model", 0),
        ({"base": 0.10, "structured": 0.104}, "structured", "Believe the structured model", 0),
        ({"base": 0.1, "structured": 0.2}, "base file", "Keep the vessel file that you started from", 1),
        ({"base": 0.9, "taylor": 0.1, "structured": 0.2}, "Taylor", "Taylor comes nearest", 1),
        ({"base": 1.5, "structured": 1.2}, None, "Believe none of the models", 1),
        ({"base": np.inf, "structured": 0.2}, "structured", "Believe the structured model", 0),
    ],
)
def test_who_is_believed(errors, believe, begins, doubts):
    found = verdict(chosen(), validation(**errors), {})
    assert found.believe == believe
    assert found.lines[0].startswith(begins)
    assert len(found.attention) == doubts, found.attention


def test_everything_that_must_be_looked_at_is_said():
    told = {"a.csv": [LogProblem(kind="disagree", text="psi_rad turns 57 times"), LogProblem(kind="idle", text="rest")]}
    open_ones = ("M22_kg", "Y_v_N_s_m", "Y_vv_N_s2_m2", "Y_r_N_s")
    found = verdict(chosen(open_ones, converged=False, white=False), validation(base=0.5, structured=0.1), told)
    text = " ".join(found.attention)
    for words in ("did not converge in 5 steps", "hang together (psi)", "determine M22_kg,", "Y_v_N_s_m or Y_vv",
                  "a.csv: disagree: psi_rad turns 57 times"):  # fmt: skip
        assert words in text
    assert "Y_r" not in text and "idle" not in text
    assert "open: M22_kg, Y_v_N_s_m, Y_r_N_s, Y_vv_N_s2_m2" in " ".join(found.lines)


def test_what_the_method_holds_is_not_open_and_nobody_is_sent_to_sea_for_it():
    """Multi-step output error holds latency and place of the tag; the fit of windows does not."""
    open_ones = ("lag_s", "uwb_latency_s", "tag_x_m", "tag_y_m", *WARP)
    windows = chosen(open_ones)
    multi_step = dataclasses.replace(windows, result=replace(windows.result, horizon_s=15.0))
    known = len(NAMES_OF) - len(open_ones)
    for one, told in ((windows, {"lag_s", "uwb_latency_s", "tag_x_m", "tag_y_m"}), (multi_step, {"lag_s"})):
        found = verdict(one, validation(structured=0.1), {})
        assert {name for names, _ in found.advice for name in names} == told
        lines = " ".join(found.lines)
        assert f"determine {known} of {known + len(told)} parameters of boat and sensors; open: lag_s" in lines
        held = "by this method, multi-step output error: uwb_latency_s, tag_x_m, tag_y_m."
        assert (held in lines) == (one is multi_step)
    table = {row[0]: row[-1] for row in parameter_table(multi_step.result, VESSEL, FitSettings()).rows}
    assert (table["tag_x_m"], table["lag_s"]) == ("held at the file's value", "**no**")


@pytest.mark.parametrize(
    ("name", "none", "text"), [("k_kg", 0.0, "yaw moment of u v"), ("astern_t200", 1.0, "thrust astern")]
)
def test_a_refinement_that_may_be_nothing_is_not_what_the_logs_ask_for(name, none, text):
    """Chance, or another effect, makes halves of a log predict each other better: the boat may have nothing of it."""
    refinement = {"k_kg": "munk_moment", "astern_t200": "astern"}[name]
    for value, asked in ((none + 0.1, False), (none - 0.3, True)):
        extra = replace(fit().parameters[0], name=name, value=value, ci95=(value - 0.2, value + 0.2))
        kept = Trial("windows", ("speed_damping", refinement), 0.9, (0.9, 0.9), kept=True)
        one = dataclasses.replace(chosen(), trials=(kept,))
        one = dataclasses.replace(one, result=replace(one.result, parameters=(*one.result.parameters, extra)))
        lines = [
            line for line in verdict(one, validation(structured=0.1), {}).lines if "yaw damping" in line or text in line
        ]
        assert (text in lines[0]) == asked and lines[0].startswith("The logs ask for")
        assert len(lines) == 1 if asked else lines[1].startswith("Kept as well") and text in lines[1]
    lines = verdict(dataclasses.replace(one, left_out=(refinement,)), validation(structured=0.1), {}).lines
    assert [line.split(",")[0] for line in lines if text in line] == ["Left out again"]


def test_one_of_linear_and_quadratic_damping_is_enough():
    assert not verdict(chosen(("X_uu_N_s2_m2", "lag_s")), validation(structured=0.1), {}).attention


def test_every_parameter_has_a_manoeuvre_and_one_only():
    for name in NAMES_OF:
        mine = [m for m in MANOEUVRES if name.startswith(m.heads)]
        assert len(mine) == (0 if name in WARP else 1), name
    assert {name for group in NEEDED for name in group} <= set(NAMES_OF)
    told = dict(advice(("Y_r_N_s", "gain_rear_port"), boat("aritra")))
    assert set(told) == {("Y_r_N_s",), ("gain_rear_port",)} and "zig-zag" in told[("Y_r_N_s",)]
