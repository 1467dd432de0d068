"""Waves, gusts and fixes without line of sight: worlds made here (seeds stated), and dense algebra as an oracle."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS
from sim.fitting.diagnose.stochastic_effects import gusts, nlos, nlos_cause, waves
from sim.fitting.diagnose.stochastic_effects.ambient import fit_ambient, initial_noise
from sim.fitting.diagnose.stochastic_effects.process import log_likelihood
from sim.fitting.diagnose.stochastic_effects.residual_acceleration import ResidualAcceleration, residual_acceleration
from sim.fitting.engine.noise import LATENT
from sim.fitting.engine.windows import SURGE
from tests.support.vessel_fixtures import boat

M_INV = np.diag([1 / 20, 1 / 35, 1 / 3])
TO_IMU = np.array([[1.0, 0.0, 0.02], [0.0, 1.0, 0.05]])
ANCHORS = {"0": (0.0, 0.0), "1": (30.0, 0.0), "2": (30.0, 30.0), "3": (0.0, 30.0)}


def markov(rng: np.random.Generator, count: int, time_s: float, step_s: float) -> np.ndarray:
    """Gauss-Markov of unit size."""
    keep, out = np.exp(-step_s / time_s), np.empty(count)
    out[0] = rng.normal()
    for k in range(1, count):
        out[k] = keep * out[k - 1] + np.sqrt(1 - keep**2) * rng.normal()
    return out


def band(rng: np.random.Generator, count: int, period_s: float, width: float, step_s: float) -> np.ndarray:
    """Of unit size: a slow random turning and swelling of a wave of one period."""
    time = period_s / (2 * np.pi * width)
    phase = 2 * np.pi * np.arange(count) * step_s / period_s
    slow = markov(rng, count, time, step_s), markov(rng, count, time, step_s)
    return slow[0] * np.cos(phase) + slow[1] * np.sin(phase)


def world(
    seed: int, step_s: float, minutes: float = 6.0
) -> tuple[np.random.Generator, ResidualAcceleration, np.ndarray]:
    """A boat that turns this way and that, and what is left over of ambient force [N, N, N m] and noise alone."""
    rng = np.random.default_rng(seed)
    count = int(minutes * 60 / step_s)
    x = np.zeros((count, 6, 1))
    x[:, 2, 0] = np.cumsum(0.3 * markov(rng, count, 15.0, step_s)) * step_s
    force = np.stack([size * markov(rng, count, 3.0, step_s) for size in (0.12, 0.12, 0.04)], axis=1)
    return rng, ResidualAcceleration(np.zeros((count, 3, 1)), x, step_s, M_INV, TO_IMU, 0.5), force


def measured(rng: np.random.Generator, data: ResidualAcceleration, force: np.ndarray) -> ResidualAcceleration:
    """The same with what `force` (T, 3) leaves over, and white noise."""
    y = data.pattern(force[:, :, None])[..., 0]
    rho, keep = 0.0, np.exp(-data.yaw_rate_1_s * data.step_s)
    for k in range(len(y)):
        y[k, 2], rho = rho, keep * rho + data.step_s * y[k, 2]
    y += rng.normal(size=y.shape) * np.array([0.012, 0.012, 0.001])
    return ResidualAcceleration(y[:, :, None], data.x, data.step_s, M_INV, TO_IMU, data.yaw_rate_1_s)


def blocks(data: ResidualAcceleration, steps: int) -> ResidualAcceleration:
    """Cut up."""
    count = len(data.y) // steps

    def cut(a: np.ndarray) -> np.ndarray:
        return a[: count * steps, :, 0].reshape(count, steps, -1).transpose(1, 2, 0)

    return ResidualAcceleration(cut(data.y), cut(data.x), data.step_s, M_INV, TO_IMU, data.yaw_rate_1_s)


def test_likelihood_is_that_of_the_dense_covariance():
    rng = np.random.default_rng(1)
    T, dt = 12, 0.3
    p = rng.normal(size=(T, 3))
    y = rng.normal(size=(T, 3))
    y[:, 2], y[4, 0] = np.nan, np.nan  # yaw is not looked at, and one sample is missing
    nuisance = np.log([0.4, 0.7, 0.3, 0.2, 0.5, 0.1, 2.0])
    data = ResidualAcceleration(y[:, :, None], np.zeros((T, 6, 1)), dt, np.eye(3), TO_IMU, 0.5)
    found = log_likelihood(data, nuisance[None], p[:, :, None, None], np.array([0.2]), np.array([1.7]))[0]
    lag = dt * np.abs(np.arange(T)[:, None] - np.arange(T))
    wave, slow = np.exp(-0.2 * lag) * np.cos(1.7 * lag), np.exp(-lag / 2.0)
    C = np.kron(wave, np.ones((2, 2))) * np.outer(p[:, :2].ravel(), p[:, :2].ravel())
    C += np.kron(slow, np.diag([0.4**2, 0.7**2])) + np.kron(np.eye(T), np.diag([0.2**2, 0.5**2]))
    known = np.isfinite(y[:, :2].ravel())
    within = C[np.ix_(known, known)]
    wanted = multivariate_normal(np.zeros(known.sum()), within)  # type: ignore[arg-type]  # stubs say int
    wanted = wanted.logpdf(y[:, :2].ravel()[known])
    assert found == pytest.approx(wanted, abs=1e-8)


def test_what_is_left_over_does_not_ask_who_holds_it():
    """The same force as latent acceleration or as residual; samples 0.1 s apart, a hole, windows of a second."""
    rng = np.random.default_rng(2)
    W, K = 30, 10
    white, force = (0.1, 0.1, 0.02, 0.03), rng.normal(size=(W, K, 2))
    latent = rng.normal(size=(W, 3)) * [1.0, 1.0, 0.0]

    def of(d: np.ndarray, *blind: int) -> ResidualAcceleration:
        residuals = np.zeros((W, K, 4))
        residuals[..., 2:] = -(force - d[:, None, :2]) / white[2:]
        residuals[..., blind] = np.nan
        residuals[7] = np.nan
        z = np.zeros((W, 14))
        z[:, LATENT] = d
        state = SimpleNamespace(A=np.full((W, K + 1, 6, 6), -0.5), x=np.zeros((W, K + 1, 6)), M_inv=M_INV)
        t = np.arange(W)[:, None] + np.arange(K + 1) * 0.1
        windows = SimpleNamespace(size=(W, K), t_s=t, spans=(slice(0, W),))
        point = SimpleNamespace(residuals=residuals, z=z, state=state)
        fit = SimpleNamespace(physics=SimpleNamespace(windows=windows, vessel=boat("aritra")))
        return residual_acceleration(fit, SimpleNamespace(point=point, noise=SimpleNamespace(white=white)), 0.2, 10.0)  # type: ignore[arg-type]  # stand-ins

    one, other = of(latent), of(np.zeros((W, 3)))
    assert one.y.shape == (50, 3, 3) and np.isnan(one.y[35:40, :, 0]).all()
    np.testing.assert_allclose(one.y, other.y, atol=1e-12)
    means = force.reshape(W * 5, 2, 2).mean(axis=1)
    np.testing.assert_allclose(one.y[:35, :2, 0], means[:35], atol=1e-12)
    sideways = of(latent, SURGE)
    np.testing.assert_array_equal(sideways.y[:, 1], one.y[:, 1])
    assert np.isnan(sideways.y[:, 0]).all()


def test_noise_of_every_day_without_a_yaw_rate():
    rng, data, force = world(3, 0.5, minutes=2.0)
    seen = measured(rng, data, force)
    seen.y[:, 2] = np.nan
    about = initial_noise(seen)
    found, height = fit_ambient(seen, about, steps=3)
    assert np.isfinite(about).all() and np.isfinite(found).all() and np.isfinite(height)


@pytest.mark.long
def test_waves_are_found_with_direction_and_size():
    rng, data, force = world(3, waves.STEP_S)
    a = 0.8 * band(rng, len(force), 2.2, 0.04, data.step_s)
    q = np.radians(130.0) + np.pi - data.x[:, 2]
    data = measured(rng, data, force + waves.wave_force(q)[..., 0] * a[:, None])
    seen = waves.screen_waves(data)
    assert seen.nats > waves.QUICK_NATS and seen.T_p_s == pytest.approx(2.2, rel=0.08)
    found = waves.fit_waves(blocks(data, 150), seen)
    assert found.nats > 100 and found.over_body_fixed > 50 and not found.broad
    assert found.T_p_s == pytest.approx(2.2, rel=0.03)
    assert np.degrees(found.beta_rad) == pytest.approx(130.0, abs=5.0)  # and not 310: yaw tells
    size, share = waves.rms_force(data, found.beta_rad, found.T_p_s)
    assert size == pytest.approx(0.8, rel=0.25) and 0.03 < share < 0.2
    assert waves.beside_peak(data, found.beta_rad, found.T_p_s) < waves.OTHER


def test_two_peaks_are_seen():
    """Seed 12; of which one is the period."""
    rng, data, force = world(12, waves.STEP_S, 8.0)
    a = 0.7 * band(rng, len(force), 2.2, 0.03, data.step_s) + 0.7 * band(rng, len(force), 3.2, 0.03, data.step_s)
    q = np.radians(60.0) + np.pi - data.x[:, 2]
    data = measured(rng, data, force + waves.wave_force(q)[..., 0] * a[:, None])
    assert waves.beside_peak(data, np.radians(60.0), 2.2) > waves.OTHER
    assert waves.beside_peak(data, np.radians(60.0), 3.2) > waves.OTHER


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_ambient_force_is_no_wave(seed):
    rng, data, force = world(seed, waves.STEP_S)
    seen = waves.screen_waves(measured(rng, data, force))
    assert seen.nats < waves.QUICK_NATS or seen.F_w_N < waves.SMALLEST_N


@pytest.mark.long
def test_an_engine_that_oscillates_is_no_wave():
    """The same band, but along the boat's own axis: it does not know where north is. Seed 7."""
    rng, data, force = world(7, waves.STEP_S, 4.0)
    force[:, 0] += 1.0 * band(rng, len(force), 2.2, 0.04, data.step_s)
    data = measured(rng, data, force)
    found = waves.fit_waves(blocks(data, 150), waves.screen_waves(data))
    assert found.over_body_fixed < 0


def wind_along(data: ResidualAcceleration) -> np.ndarray:
    """Steady wind from north, (T, 3, 1) [N, N, N m]."""
    psi = data.x[:, 2]
    return np.stack([-0.8 * np.cos(psi), 1.6 * np.sin(psi), 0.1 * np.sin(2 * psi)], axis=1)


@pytest.mark.long
def test_a_gusty_wind_is_told_from_a_steady_one():
    """Seed 8; the fit has found the mean already, so only what comes and goes is left over."""
    rng, data, force = world(8, gusts.STEP_S, 10.0)
    speed = 1 + 0.35 * markov(rng, len(force), 9.0, data.step_s)
    left = wind_along(data)[..., 0] * (speed**2 / (1 + 0.35**2) - 1)[:, None]
    steady, gusty = measured(rng, data, force), measured(rng, data, force + left)
    found = gusts.fit_gusts(blocks(gusty, 200), _cut(wind_along(data), 200))
    assert found.nats > 30
    assert gusts.gustiness_of(found.size) == pytest.approx(0.35, rel=0.4)
    assert 4.0 < found.gust_time_s < 20.0
    steady_wind = gusts.fit_gusts(blocks(steady, 200), _cut(wind_along(data), 200))
    assert steady_wind.nats < 6


def _cut(force: np.ndarray, steps: int) -> np.ndarray:
    count = len(force) // steps
    return force[: count * steps, :, 0].reshape(count, steps, 3).transpose(1, 2, 0)


@pytest.mark.parametrize("gustiness", [0.1, 0.3, 0.5])
def test_gustiness_undoes_the_spread_of_squared_speed(gustiness):
    """Against a million draws, seed 9."""
    square = (1 + gustiness * np.random.default_rng(9).normal(size=1_000_000)) ** 2
    assert gusts.gustiness_of(float(square.std() / square.mean())) == pytest.approx(gustiness, rel=0.01)


def fixes(rng: np.random.Generator, count: int = 2000, outliers: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """Places of a drive [m], and everyday errors: normal, but for a few larger ones in no direction."""
    places = rng.uniform(5, 25, (count, 2))
    e = 0.07 * rng.normal(size=(count, 2))
    wild = rng.random(count) < outliers
    e[wild] += 0.5 * rng.normal(size=(wild.sum(), 2))
    return places, e


def test_fixes_without_line_of_sight_name_the_anchor_and_are_weighed_down():
    rng = np.random.default_rng(10)
    places, e = fixes(rng)
    away = places - np.array(ANCHORS["2"])
    hidden = rng.random(len(e)) < 0.06
    e[hidden] += (away / np.linalg.norm(away, axis=1)[:, None] * rng.exponential(0.8, (len(e), 1)))[hidden]
    best, second = nlos.fit_anchors(e, places + e, 0.07, ANCHORS)[:2]
    assert best.anchor == "2" and best.number == 2 and best.nats > 50 and best.nats > second.nats + 12
    sigma = np.sqrt(np.diag(best.posterior.covariance))
    at = best.posterior.at
    assert abs(np.log(best.share / (1 - best.share)) - np.log(0.06 / 0.94)) < 3 * sigma[nlos.SHARE]
    assert abs(at[nlos.EXTRA] - np.log(0.8)) < 3 * sigma[nlos.EXTRA]
    assert best.line_of_sight[hidden].mean() < 0.4 and best.line_of_sight[~hidden].mean() > 0.97


@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_errors_in_no_direction_are_not_an_anchors_doing(outliers):
    places, e = fixes(np.random.default_rng(11), outliers=outliers)
    assert nlos.fit_anchors(e, places + e, 0.07, ANCHORS)[0].nats < 0


def test_anchors_are_the_logs_or_else_corners_round_the_positions():
    run = SimpleNamespace(meta=SimpleNamespace(anchors_m={"a": (1.0, 2.0, -2.5)}))
    bare = SimpleNamespace(meta=SimpleNamespace(anchors_m={}))
    places = np.array([[0.0, 0.0], [20.0, 10.0]])
    assert nlos.anchors_of([run], places) == {"a": (1.0, 2.0)}  # type: ignore[list-item]  # stand-in
    corners = nlos.anchors_of([bare], places)  # type: ignore[list-item]  # stand-in
    assert corners["south-west"] == (-5.0, -5.0) and corners["north-east"] == (25.0, 15.0)


@pytest.mark.long
@pytest.mark.parametrize("lasting", [False, True])
def test_fixes_that_lie_further_off_by_chance_are_a_hidden_anchor_those_that_drift_together_are_not(lasting):
    """Seed 5, 1,500 fixes at 5 Hz. Drift of 0.3 m over 20 s, as a current that no model has yet makes it, looks hidden
    now and then; a twelfth of the fixes 0.7 m too long, one by one, are.
    """
    rng, n = np.random.default_rng(5), 1500
    places = 15 + 8 * np.stack([np.cos(np.arange(n) / 90), np.sin(np.arange(n) / 70)], axis=1)
    e = rng.normal(0, 0.07, (n, 2))
    if lasting:
        e += 0.3 * np.stack([markov(rng, n, 20.0, 0.2) for _ in range(2)], axis=1)
    else:
        away = (places - ANCHORS["1"]) / np.linalg.norm(places - ANCHORS["1"], axis=1)[:, None]
        e += ((rng.uniform(size=n) < 1 / 12) * rng.exponential(0.7, n))[:, None] * away
    boat_and_logs = SimpleNamespace(
        vessel=boat("aritra"),
        runs=[SimpleNamespace(meta=SimpleNamespace(anchors_m={k: (*a, -2.0) for k, a in ANCHORS.items()}))],
        windows=SimpleNamespace(fixes=SimpleNamespace(place_m=places + e)),
    )
    model = SimpleNamespace(point=SimpleNamespace(fix_residuals=-e / 0.07), noise=SimpleNamespace(fix_m=0.07))
    found = nlos_cause(SimpleNamespace(physics=boat_and_logs), model)  # type: ignore[arg-type]  # stand-ins
    assert nlos.fit_anchors(e, places + e, 0.07, ANCHORS)[0].nats > DECISIVE_NATS, "as independent fixes"
    assert found is not None and (found.candidate.nats > DECISIVE_NATS) == (not lasting)
