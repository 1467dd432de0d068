"""Open-loop validation: simulators against independent ones, scores against cases whose answer is known."""

import base64
import re
from dataclasses import dataclass

import numpy as np
import polars as pl
import pytest
from scipy.integrate import solve_ivp

from companion.core.model.integrate import BufferedStep, step_function
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import configuration_matrix
from companion.logs.runs.run import Run, RunMeta
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.engine.thrust.forces import thruster_forces
from sim.fitting.taylor.abkowitz import C, regressor
from sim.fitting.taylor.pipeline import held, paper_motion, paper_samples, smoother_samples
from sim.fitting.taylor.regression import least_squares
from sim.fitting.validate.divergence import divergence_study, divergence_table
from sim.fitting.validate.figures import divergence, training_log
from sim.fitting.validate.models import TaylorSimulator, VelocityStays, VelocityZero, VesselSimulator
from sim.fitting.validate.protocol import CHANNELS, STEP_S, Commands
from sim.fitting.validate.report import Section, report
from sim.fitting.validate.scores import Box, errors, score, whiteness
from sim.fitting.validate.stability import stability
from sim.fitting.validate.study import HeldOut, validate
from sim.fitting.validate.table import sentences, table
from sim.fitting.validate.windows import HeldOutWindows, cut, joined, reference
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
NOISE = SmootherNoise.of(VESSEL)
BOX = Box(np.array([-1.0, -0.6, -1.1]), np.array([1.0, 0.6, 1.1]))


@pytest.fixture(scope="module")
def run():
    return teleop_run(VESSEL, 4, 90.0)


@pytest.fixture(scope="module")
def windows(run):
    return cut(run, reference(run, NOISE), 15.0, horizon_s=20.0, stride_s=10.0)


@dataclass(frozen=True)
class Told:
    """A model that says what it is told to, at the command rate."""

    name: str
    x: np.ndarray

    def simulate(self, x0, commands):
        out = np.repeat(self.x, 2, axis=1)[:, : commands.pwm_us.shape[1] + 1]
        return np.concatenate([out, self.x[:, -1:]], axis=1)[:, : commands.pwm_us.shape[1] + 1]


def commands(pwm, steps, m=1, volts=15.0):
    row = np.broadcast_to(np.asarray(pwm, dtype=float), (m, steps, 4))
    return Commands(row, np.full((m, steps), volts), row[:, :40])


def test_the_true_vessel_file_reproduces_the_plant(run, windows):
    """The plant is another program: 100 Hz, delay line, battery sag; the rest is rounding of volts and stamps."""
    found, _ = score(VesselSimulator("true", VESSEL), windows, BOX)
    assert windows.horizon_s == 20.0
    assert found.rms["position"][found.horizons_s.index(20)] < 0.06
    assert max(found.rms[c].max() for c in "uvr") < 0.01
    assert min(found.r2.values()) > 0.999
    assert not found.diverged.any()


@pytest.mark.parametrize("m", [2, 40])
def test_few_windows_and_many_are_the_models_own_steps(m):
    """Seed 1, 40 s: few by the interpreter, many by machine code; one is gone where its voltage makes no sense."""
    rng = np.random.default_rng(1)
    x0, pwm = rng.uniform(-0.5, 0.5, (m, 6)), np.repeat(rng.uniform(1200, 1800, (m, 40, 4)), 20, axis=1)
    volts, before = np.full((m, 800), 15.0), np.tile(pwm[:, :1], (1, 40, 1))
    volts[1, 300:] = -1.0
    got = VesselSimulator("true", VESSEL).simulate(x0, Commands(pwm, volts, before))
    step = BufferedStep(step_function(StructuredModel.of(VESSEL), STEP_S, 1))
    x = np.concatenate([x0[0], thruster_forces(VESSEL, before[0, :1], volts[0, :1])[0]])
    late = np.concatenate([before[0, -2:], pwm[0, :-2]])
    for k, f_cmd in enumerate(thruster_forces(VESSEL, late, volts[0])):
        x = step(x, f_cmd, np.zeros(3))
        assert got[0, k + 1] == pytest.approx(x[:6], rel=1e-9, abs=1e-10)
    assert np.isfinite(got[1, :300]).all() and np.isnan(got[1, 304:]).all()
    assert np.isfinite(np.delete(got, 1, axis=0)).all()


def test_a_wrong_dead_time_shows(windows):
    late = replace_propulsion(dead_time_s=0.4)
    right, _ = score(VesselSimulator("right", VESSEL), windows, BOX)
    wrong, _ = score(VesselSimulator("late", late), windows, BOX)
    assert wrong.rms["u"][0] > 10 * right.rms["u"][0]


def replace_propulsion(**values):
    from msgspec.structs import replace as with_fields

    return with_fields(VESSEL, propulsion=with_fields(VESSEL.propulsion, **values))


def test_the_taylor_model_against_scipy():
    pwm = np.array([1560, 1540, 1570, 1550])
    steps, x0 = 200, np.array([1.0, 2.0, 0.3, 0.55, 0.02, -0.05])
    got = TaylorSimulator("t", C, VESSEL).simulate(x0[None], commands(pwm, steps))[0]
    t = configuration_matrix(VESSEL) @ thruster_forces(VESSEL, pwm[None], np.array([15.0]))[0] / 9.80665

    def rate(_, x):
        c, s = np.cos(x[2]), np.sin(x[2])
        pose = [c * x[3] - s * x[4], s * x[3] + c * x[4], x[5]]
        return [*pose, *(C @ np.array(regressor(x[3:], t)))]

    want = solve_ivp(rate, (0, steps * STEP_S), x0, rtol=1e-10, atol=1e-12).y[:, -1]
    assert np.allclose(got[-1], want, atol=1e-6)


def test_what_needs_no_model():
    """A quarter circle of radius u / r in closed form; the other stays where it is."""
    x0 = np.array([[0.0, 0.0, 0.0, 0.5, 0.0, np.pi / 20]])
    stays = VelocityStays().simulate(x0, commands([1900] * 4, 200))[0]
    assert np.allclose(stays[-1, :3], [0.5 / (np.pi / 20), 0.5 / (np.pi / 20), np.pi / 2])
    zero = VelocityZero().simulate(x0, commands([1900] * 4, 200))[0]
    assert np.array_equal(zero[0], x0[0])
    assert np.array_equal(zero[1:], np.zeros((200, 6)))
    straight = VelocityStays().simulate(np.array([[0, 0, np.pi / 2, 0.3, 0.1, 0.0]]), commands([1500] * 4, 20))[0]
    assert np.allclose(straight[-1, :2], [-0.1, 0.3])


def test_errors_tell_unknown_from_gone_and_wrap_the_heading():
    truth = np.zeros((1, 3, 6))
    truth[0, 2] = np.nan
    states = np.zeros((1, 3, 6))
    states[0, 0] = [3, 4, 2 * np.pi + 0.1, 0.5, 0, 0]
    states[0, 1:] = np.nan
    e = errors(states, truth)
    assert np.allclose(e[0, 0], [5, 0.1, 0.5, 0, 0])
    assert np.isinf(e[0, 1]).all()
    assert np.isnan(e[0, 2]).all()


def test_the_box():
    box = Box.of(np.array([[0.0, -1, 0], [1, 1, 2], [np.nan, 9, 9]]))
    assert np.array_equal(box.low, [0, -1, 0]) and np.array_equal(box.high, [1, 1, 2])
    inside = [[1.99, 2.99, 3.99], [-0.99, 0, 1]]
    outside = [[2.01, 0, 1], [0.5, 0, -2.01], [np.nan, 0, 0], [np.inf, 0, 0]]
    assert not box.left(np.array(inside)).any()
    assert box.left(np.array(outside)).all()


def test_scores_of_known_errors():
    """Four windows of 30 s: one exact, one 0.1 fast in u, one that ends after 12 s, one gone after 20 s."""
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(4, 301, 6)) * [0, 0, 0, 0.2, 0.1, 0.1]
    states = truth.copy()
    states[1, :, 3] += 0.1
    truth[2, 121:] = np.nan
    states[3, 200:] = np.nan
    zero = np.zeros((4, 600, 4))
    windows = HeldOutWindows(truth[:, 0], truth, Commands(zero, zero[..., 0], zero[:, :1]), np.zeros(4))
    box = Box(np.full(3, -1.0), np.ones(3))
    found, _ = score(Told("told", states), windows, box)
    at = {h: i for i, h in enumerate(found.horizons_s)}
    assert found.horizons_s == (1, 2, 5, 10, 20, 30)
    assert list(found.count[[at[10], at[20]]]) == [4, 3]
    assert found.rms["u"][at[10]] == pytest.approx(0.05)
    assert np.isinf(found.rms["u"][at[20]])
    assert found.median["u"][at[20]] == pytest.approx(0.1)
    assert np.isinf(found.p90["u"][at[20]])
    assert found.diverged[at[10]] == 0.0
    assert found.diverged[at[20]] == pytest.approx(1 / 3)
    assert found.r2["u"] == -np.inf
    part = replace_windows(windows, slice(0, 2))
    found, _ = score(Told("told", states[:2]), part, box)
    u = truth[:2, :, 3]
    assert found.nrmse["u"] == pytest.approx(np.sqrt(0.005) / np.ptp(u))
    assert found.r2["u"] == pytest.approx(1 - 0.005 / u.var())
    assert found.r2["v"] == 1.0


def replace_windows(w, part):
    c = w.commands
    return HeldOutWindows(
        w.x0[part], w.truth[part], Commands(c.pwm_us[part], c.battery_v[part], c.before_us[part]), w.start_s[part]
    )


def test_whiteness_knows_white_from_coloured():
    rng = np.random.default_rng(1)
    k = 400
    white = rng.normal(size=(k, 3))
    coloured = white.copy()
    for i in range(1, k):
        coloured[i] += 0.5 * coloured[i - 1]
    zero = np.zeros((k, 20, 4))
    truth = np.zeros((k, 11, 6))
    windows = HeldOutWindows(truth[:, 0], truth, Commands(zero, zero[..., 0], zero[:, :1]), np.arange(k))
    for series, expected in ((white, True), (coloured, False)):
        states = np.zeros((k, 11, 6))
        states[:, :, 3:] = series[:, None]
        found = whiteness(Told("x", states), windows)
        assert all((f.p > 0.01) == expected for f in found.values())
        assert all(f.n == k for f in found.values())
        assert found["u"].lag1 == pytest.approx(0.0 if expected else 0.5, abs=0.1)


def test_a_boat_comes_to_rest_and_the_printed_model_does_not():
    box = Box(np.array([0.43, -0.22, -0.57]), np.array([0.85, 0.22, 0.57]))
    good = stability(VesselSimulator("file", VESSEL), VESSEL, BOX, 1, runs=25)
    assert (good.driven_diverged, good.free_diverged, good.free_at_rest) == (0.0, 0.0, 1.0)
    bad = stability(TaylorSimulator("printed", C, VESSEL), VESSEL, box, 1, runs=25)
    assert bad.free_at_rest == 0.0
    assert bad.driven_diverged > 0.9


def test_windows_stay_within_what_is_held_out(run):
    ref = reference(run, NOISE)
    found = cut(run, ref, 15.0, horizon_s=20.0, stride_s=5.0, inside=[(10.0, 40.0), (60.0, 72.0)])
    assert list(found.start_s.round(6)) == [10, 15, 20, 25, 30, 60], "each has at least 10 s to run"
    lasts = np.isfinite(found.truth[..., 0]).sum(axis=1) - 1
    ends = found.start_s + lasts / 10
    assert (ends <= np.where(found.start_s < 50, 40.0, 72.0) + 1e-6).all()
    assert np.array_equal(found.truth[:, 0], found.x0)
    pwm, _ = held(run, found.start_s[1] + STEP_S * (np.arange(400) + 0.5))
    assert np.array_equal(found.commands.pwm_us[1], pwm)
    earlier, _ = held(run, found.start_s[1] - STEP_S * (np.arange(40) + 0.5))
    assert np.array_equal(found.commands.before_us[1], earlier[::-1])
    assert len(joined([found, found]).x0) == 12


def test_too_short_a_run_is_refused(run):
    with pytest.raises(ValueError, match=r"seed 4: no window of 10 s"):
        cut(run, reference(run, NOISE), 15.0, inside=[(3.0, 9.0)])


def test_without_truth_the_smoother_is_the_reference_and_gaps_are_unknown(run):
    plain = run.table.drop([c for c in run.table.columns if c.startswith("true_")])
    hole = (pl.col("t_s") > 30.0) & (pl.col("t_s") < 50.0)
    plain = plain.with_columns(pl.when(hole).then(None).otherwise(pl.col(c)).alias(c) for c in ("north_m", "east_m"))
    found = reference(Run(plain, run.meta), NOISE)
    assert found.source == "the smoothed measurements"
    truth = reference(run, NOISE)
    k = min(len(found.x), len(truth.x))
    known = np.isfinite(found.x[:k]).all(axis=1)
    assert not known[330:470].any() and known[:280].all()
    assert np.abs(found.x[:k] - truth.x[:k])[known, 3:].max() < 0.1
    with pytest.raises(ValueError, match="no window"):
        cut(Run(plain, run.meta), found, 15.0, inside=[(32.0, 48.0)])


def test_held_before_anything_was_sent():
    table = pl.DataFrame({"t_s": [0.0, 1.0], "pwm_a": [None, 1600.0], "battery_v": [None, None], "psi_rad": [0.0, 0.0],
                          "r_rad_s": [0.0, 0.0], "ax_m_s2": [0.0, 0.0], "ay_m_s2": [0.0, 0.0],
                          "north_m": [0.0, 0.0], "east_m": [0.0, 0.0]}).cast(pl.Float64)  # fmt: skip
    pwm, volts = held(Run(table, RunMeta()), np.array([-1.0, 0.5, 1.0]))
    assert list(pwm[:, 0]) == [1500.0, 1500.0, 1600.0]
    assert np.isnan(volts).all()


@pytest.fixture(scope="module")
def found(run):
    samples = smoother_samples(run, VESSEL, smooth(run, NOISE))
    taylor = TaylorSimulator("Taylor", least_squares([samples]).C, VESSEL)
    printed = TaylorSimulator("printed", C, VESSEL)
    return validate(
        [VesselSimulator("true", VESSEL), taylor, printed], [HeldOut(run)], VESSEL, NOISE, horizon_s=30.0, stride_s=15.0
    )


def test_side_by_side(found):
    head = table(found).head
    assert head == ("figure", "true", "Taylor", "printed", "velocity stays", "velocity is zero")
    rows = {row[0]: row[1:] for row in table(found).rows}
    for channel in CHANNELS:
        row = next(v for k, v in rows.items() if k.startswith(f"{channel}, rms error after 10 s"))
        assert row[0].startswith("**")
    assert rows["no thrust: runs that come to rest"][0] == "100 %"
    assert rows["no thrust: runs that come to rest"][2] == "0 %"
    assert table(found).markdown().count("\n") == len(rows) + 1


def test_sentences_say_who_wins_and_who_runs_away(found):
    text = sentences(found)
    assert "nearest model is true" in text[1]
    assert "true beats both baselines in every channel at 10 and 20 s." in text
    assert any(line.startswith("printed:") and "diverge" in line for line in text)
    assert not any(line.startswith("true:") for line in text)


def test_the_report_stands_alone_and_begins_with_sentences(found, run):
    figure = training_log(run, paper_motion(run, NOISE), smooth(run, NOISE))
    departures = divergence_study([VesselSimulator("true", VESSEL)], found.windows, found.box)
    page = report(
        found,
        title="Boat <1>",
        before=[Section("Fitted", ("On one log.",), "a < b")],
        after=[Section("More", figures=((figure, "5 and 6"), (divergence(departures), "how many are left")))],
    )
    assert "Boat &lt;1&gt;" in page and "a &lt; b" in page
    assert not re.search(r"https?:|<script|<link|src=\"(?!data:)", page)
    images = re.findall(r"data:image/png;base64,([^\"]+)", page)
    assert len(images) == 4
    assert all(base64.b64decode(i)[:8] == b"\x89PNG\r\n\x1a\n" for i in images)
    assert page.index("<li>") < page.index("<table>") < page.index("<img")


def test_divergence_counts_and_quantiles(found):
    printed = TaylorSimulator("printed", C, VESSEL)
    true, gone = divergence_study([VesselSimulator("true", VESSEL), printed], found.windows, found.box)
    assert true.diverged[-1] == 0.0 and np.isinf(true.first_s).all()
    assert gone.diverged[-1] == np.isfinite(gone.first_s).mean() > 0.0
    assert (np.diff(gone.diverged) >= 0).all()
    assert (np.diff(true.position_m, axis=1) >= 0).all()
    assert "| true | 0.00 m, 0 %" in divergence_table([true, gone])
    assert divergence_table([true, gone]).endswith("| - |")


def test_models_need_names_of_their_own(run):
    twice = [VesselSimulator("a", VESSEL), VesselSimulator("a", VESSEL)]
    with pytest.raises(ValueError, match="name of its own"):
        validate(twice, [HeldOut(run)], VESSEL, NOISE)


def test_another_boats_run_is_refused(run):
    with pytest.raises(ValueError, match=r"thrusters .*front_port.* but twin has"):
        paper_samples(run, boat("twin"), NOISE)
