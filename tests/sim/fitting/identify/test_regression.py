"""The 23-term regression recovers the paper's own polynomial from its data, and marks undetermined terms."""

import time

import msgspec
import numpy as np
import pytest
from statsmodels.api import OLS
from statsmodels.stats.outliers_influence import variance_inflation_factor

from companion.core.model.thrusters import configuration_matrix, force_from_pwm
from sim.fitting.engine.thrust.forces import body_forces, thruster_forces
from sim.fitting.taylor.abkowitz import AbkowitzModel, C
from sim.fitting.taylor.abkowitz_table import TERMS
from sim.fitting.taylor.regression import Samples, design, least_squares, noise_shift
from sim.fitting.taylor.sindy import sindy_coefficients
from sim.fitting.taylor.taylor_file import (
    TaylorFile,
    simulate_taylor,
    taylor_file,
    taylor_json,
)
from sim.studies.paper.polynomial_log import polynomial_logs
from sim.studies.paper.recovery import differenced, noisy, recovery, through_sensors
from sim.studies.paper.validity import outside
from tests.evidence.identify.coefficient_table import coefficient_table
from tests.support.vessel_fixtures import boat

N_SAMPLES = 13840


@pytest.fixture(scope="module")
def logs():
    return polynomial_logs(np.random.default_rng(1), N_SAMPLES)


@pytest.fixture(scope="module")
def exact(logs):
    return [log.samples for log in logs]


def test_the_generator_stays_in_the_box_and_obeys_the_model(logs):
    assert sum(len(log.x) for log in logs) == N_SAMPLES
    assert all(outside(log.x[i, 3:], 9.80665 * log.t_kgf[i]) == () for log in logs for i in range(0, len(log.x), 50))
    assert np.concatenate([log.t_kgf[:, 1] for log in logs]).std() > 0.1, "sway is flown"
    again = polynomial_logs(np.random.default_rng(1), 600)
    first = logs[0]
    k = min(len(first.x), len(again[0].x))
    assert np.allclose(again[0].x[:k], first.x[:k], atol=1e-12)
    model = AbkowitzModel(configuration_matrix(boat("aritra")), 0.1)
    for i in (0, 17, 133):
        got = np.array(model.nu_dot(None, first.x[i, 3:], 9.80665 * first.t_kgf[i])).ravel()
        assert np.allclose(got, first.nu_dot[i])


def test_exact_accelerations_give_the_coefficients_back(exact):
    fit = least_squares(exact)
    assert np.allclose(fit.C, C, rtol=1e-6, atol=1e-9)
    assert fit.rank == 23
    assert fit.determined.all(), "C_y too: sway is flown"
    assert (fit.r2 > 1 - 1e-12).all()


def test_seven_point_differences_give_them_back_away_from_steps_and_only_there(logs):
    away = recovery([least_squares(differenced(logs, across_steps=False))])
    across = recovery([least_squares(differenced(logs, across_steps=True))])
    assert away.worst_abs < 5e-6
    assert away.median_rel < 1e-6
    assert across.median_rel > 0.3, "commands change once a second: half of all stencils meet a step"


@pytest.mark.long
def test_intervals_cover_what_they_say(logs):
    """16 seeds, errors of 0.01 in the accelerations that hang together for 0.5 s, 2 mm/s in the speeds."""
    fits = [least_squares(noisy(logs, np.random.default_rng([5, k]), 0.01, 0.002)) for k in range(16)]
    found = recovery(fits)
    assert 0.90 <= found.coverage <= 0.98
    naive = np.mean([np.abs(fit.C - C) <= fit.half_width(robust=False) for fit in fits])
    assert naive < 0.7, "intervals for white errors would be far too short"


def test_after_sensors_little_but_the_thrust_terms_survives(logs):
    """What the paper could have known of its 69 numbers: median error beyond 100 %, yaw thrust within 15 %."""
    fit = least_squares(through_sensors(logs[:10], np.random.default_rng(6)))
    assert recovery([fit]).median_rel > 1.0
    assert fit.C[2, 22] == pytest.approx(C[2, 22], rel=0.15)


def test_speed(exact):
    took = []
    for _ in range(5):
        start = time.perf_counter()
        least_squares(exact)
        took.append(time.perf_counter() - start)
    assert min(took) < 0.5


def test_errors_agree_with_statsmodels():
    rng = np.random.default_rng(8)
    log = polynomial_logs(rng, 500)[0]
    samples = noisy([log], rng, 0.02, 0.0)
    fit = least_squares(samples, hac_s=1.0)
    A = design(samples[0].nu, samples[0].t_kgf)
    for axis in range(3):
        oracle = OLS(samples[0].nu_dot[:, axis], A).fit()
        assert np.allclose(fit.C[axis], oracle.params, rtol=1e-5, atol=1e-8)
        assert np.allclose(fit.se[axis], oracle.bse, rtol=1e-6)
        hac = oracle.get_robustcov_results("HAC", maxlags=10, use_correction=False)
        assert np.allclose(fit.se_robust[axis], hac.bse, rtol=1e-6)
    inflation = [variance_inflation_factor(A, j) for j in range(1, 23)]
    assert np.allclose(fit.vif[1:], inflation, rtol=1e-4)
    assert fit.condition == pytest.approx(np.linalg.cond(A))


def test_without_sway_commands_c_y_is_open_and_said_to_be(exact):
    """As in the paper: no sway-force data; minimum norm makes C_y = 0, which its Table 2 prints."""
    unflown = []
    for s in exact:
        t = s.t_kgf.copy()
        t[:, 1] = 0.0
        unflown.append(Samples(s.nu, s.nu_dot, t))
    fit = least_squares(unflown)
    assert fit.rank == 22
    assert np.array_equal(fit.C[:, 21], np.zeros(3))
    assert np.isinf(fit.se_robust[:, 21]).all()
    assert not fit.determined[:, 21].any() and fit.determined.sum() == 66
    assert "| C_y | open | open | open | - |" in coefficient_table(fit)
    file = taylor_file(fit, "unflown")
    assert file.se["surge"][21] is None


def test_columns_that_cannot_be_told_apart_are_both_open(exact):
    tied = [Samples(s.nu, s.nu_dot, s.t_kgf[:, [0, 0, 2]]) for s in exact]
    fit = least_squares(tied)
    assert fit.rank == 22
    assert [TERMS[j] for j in np.flatnonzero(~fit.determined[0])] == ["x", "y"]


def test_speed_errors_shift_coefficients_as_foretold(logs):
    """Bias over 12 draws of 6 mm/s in u, v, r against the shift computed from the last draw's own data."""
    sigma = 0.006
    fits, data = [], []
    for k in range(12):
        data = noisy(logs, np.random.default_rng([9, k]), 1e-4, sigma)
        fits.append(least_squares(data))
    bias = np.mean([fit.C for fit in fits], axis=0) - C
    told = noise_shift(data, [np.full_like(s.nu, sigma) for s in data], np.random.default_rng(3))
    scatter = np.std([fit.C for fit in fits], axis=0)
    clear = np.abs(bias) > 4 * scatter / np.sqrt(len(fits))
    assert clear.sum() > 15
    assert np.mean(np.sign(bias[clear]) == np.sign(told[clear])) > 0.9
    assert 0.6 < np.median(told[clear] / bias[clear]) < 1.3


@pytest.mark.parametrize(("samples", "words"), [(slice(23), "23 samples cannot"), (None, "finite")])
def test_what_cannot_be_fitted_is_refused(exact, samples, words):
    s = exact[0]
    if samples is None:
        bad = Samples(np.where(np.arange(len(s.nu))[:, None] == 5, np.nan, s.nu), s.nu_dot, s.t_kgf)
    else:
        bad = Samples(s.nu[samples], s.nu_dot[samples], s.t_kgf[samples])
    with pytest.raises(ValueError, match=words):
        least_squares([bad])


def test_the_file_goes_there_and_back_and_into_the_model(exact):
    file = taylor_file(least_squares(exact), "the paper's polynomial")
    again = msgspec.json.decode(taylor_json(file), type=TaylorFile)
    assert again == file
    B = configuration_matrix(boat("aritra"))
    nu, tau = np.array([0.6, 0.1, -0.2]), np.array([10.0, 2.0, 1.0])
    got = AbkowitzModel(B, 0.1, again.coefficients).nu_dot(None, nu, tau)
    assert np.allclose(np.array(got), np.array(AbkowitzModel(B, 0.1).nu_dot(None, nu, tau)), atol=1e-9)


def test_a_broken_file_is_refused_with_its_key(exact):
    text = taylor_json(taylor_file(least_squares(exact), "x")).decode()
    with pytest.raises(ValueError, match=r"sea"):
        msgspec.json.decode(text.replace('"surge"', '"sea"', 1).replace('"samples"', '"sea"'), type=TaylorFile)
    with pytest.raises(ValueError, match=r"nominal 0\.5"):
        msgspec.json.decode(text.replace('"nominal_u_m_s": 0.5', '"nominal_u_m_s": 0.4'), type=TaylorFile)
    with pytest.raises(ValueError, match=r"values\.yaw: expected 23"):
        TaylorFile(source="", method="", values={"surge": (0.0,) * 23, "sway": (0.0,) * 23}, se={}, se_robust={},
                   low=(), high=(), samples=0)  # fmt: skip


def test_many_simulations_are_each_what_one_would_be():
    rng = np.random.default_rng(0)
    x0 = np.hstack([np.zeros((3, 3)), rng.uniform(0.4, 0.6, (3, 1)), rng.normal(0, 0.05, (3, 2))])
    t = np.repeat(rng.normal(0, 0.3, (3, 1, 3)), 40, axis=1)
    many = simulate_taylor(C, x0, t, 0.1)
    for i in range(3):
        assert np.allclose(simulate_taylor(C, x0[i : i + 1], t[i : i + 1], 0.1)[0], many[i], atol=1e-12)


def test_the_printed_model_goes_off_when_the_facts_say():
    """Two kgf ahead from 0.5 m/s: |nu| = 50 after 72.3 s; gone is NaN, not an error."""
    x0 = np.array([[0, 0, 0, 0.5, 0, 0.0]])
    x = simulate_taylor(C, x0, np.tile([2.0, 0, 0], (1, 800, 1)), 0.1)[0]
    beyond = ~(np.abs(x[:, 3:]) < 50).all(axis=1)
    assert beyond.argmax() * 0.1 == pytest.approx(72.3, abs=0.3)
    assert np.isnan(x[-1, 3:]).all()


def test_forces_are_the_maps():
    vessel = boat("aritra")
    pwm = np.array([[1500, 1510, 1600, 1900], [1100, 1450, 1501, 2000.0]])
    got = thruster_forces(vessel, pwm, np.array([15.0, 13.2]))
    for i, volts in enumerate((15.0, 13.2)):
        want = [force_from_pwm(t, vessel.force_maps[t.force_map], pwm[i, j], volts)
                for j, t in enumerate(vessel.thrusters)]  # fmt: skip
        assert np.allclose(got[i], want)
        tau = body_forces(vessel, pwm, np.array([15.0, 13.2]))[i]
        assert np.allclose(tau, configuration_matrix(vessel) @ want)


def test_pysindy_finds_the_same_numbers_in_the_same_places():
    """Constant thrust in each run, so that its own smoothed differences have no steps to cross."""
    pytest.importorskip("pysindy", reason="the outside peer is not installed (extra: analysis)")
    rng = np.random.default_rng(3)
    x0 = np.hstack([np.zeros((60, 3)), rng.uniform([0.45, -0.2, -0.5], [0.8, 0.2, 0.5], (60, 3))])
    t = np.repeat(rng.uniform(-1, 1, (60, 1, 3)) * [2, 0.4, 0.2], 80, axis=1)
    x = simulate_taylor(C, x0, t, 0.05)[:, :-1]
    found = sindy_coefficients([Samples(x[i, :, 3:], x[i, :, 3:], t[i], 20.0) for i in range(60)], threshold=0.0)
    large = np.abs(C) > 0.02
    assert np.median(np.abs(found / np.where(large, C, 1) - 1)[large]) < 0.05
    assert np.allclose(found[:, 20:], C[:, 20:], atol=0.01)
    assert (sindy_coefficients([Samples(x[0, :, 3:], x[0, :, 3:], t[0], 20.0)], threshold=10.0) == 0).all()
