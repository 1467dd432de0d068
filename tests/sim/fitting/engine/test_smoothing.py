"""7-point differences, the Lanczos filter and the smoother against their defining properties."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from companion.logs.runs.run import Run, RunMeta
from sim.fitting.engine.smoothing import SmootherNoise, random_walk, smooth
from sim.fitting.taylor.differences import BACKWARD, CENTRAL, FORWARD, derivative
from sim.fitting.taylor.lanczos import lanczos_filter, lanczos_weights
from sim.fitting.taylor.pipeline import paper_motion

NOISE = SmootherNoise(
    position_m=0.1,
    psi_rad=0.005,
    r_rad_s=0.005,
    accel_m_s2=0.05,
    tag_arm_m=(-0.2, 0.05),
    imu_arm_m=(0.1, -0.05),
    latency_s=0.08,
)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=1, max_size=7), st.integers(9, 30))
def test_differences_are_exact_up_to_degree_six(coefficients, k):
    y, t = Polynomial(coefficients), np.linspace(-1, 1, k)
    h = t[1] - t[0]
    assert np.allclose(derivative(y(t), h), y.deriv()(t), atol=1e-9)


def test_what_is_left_at_degree_seven():
    """y = t^7, y^(7) = 5040: h^6 5040 / 140 inside, 5040 / 7 at the ends."""
    h = 0.1
    t = np.arange(20) * h
    error = derivative(t**7, h) - 7 * t**6
    assert np.allclose(error[3:-3], -5040 / 140 * h**6, rtol=1e-6) or np.allclose(
        error[3:-3], 5040 / 140 * h**6, rtol=1e-6
    )
    assert np.allclose(np.abs(error[[0, 1, 2, -1, -2, -3]]), 5040 / 7 * h**6, rtol=1e-6)


def test_weights_are_the_textbooks_and_amplify_noise_as_stated():
    assert np.allclose(CENTRAL, np.array([-1, 9, -45, 0, 45, -9, 1]) / 60)
    assert np.allclose(FORWARD, -BACKWARD[::-1])
    assert np.linalg.norm(CENTRAL) == pytest.approx(1.08, abs=0.005)
    assert np.linalg.norm(FORWARD) == pytest.approx(12.58, abs=0.01)


def test_columns_go_their_own_way_and_too_few_samples_are_refused():
    y = np.column_stack([np.arange(12.0), -2 * np.arange(12.0)])
    assert np.allclose(derivative(y, 0.5), [2.0, -4.0])
    with pytest.raises(ValueError, match="need 9 samples, found 8"):
        derivative(np.zeros(8), 0.1)


def test_lanczos_response():
    w = lanczos_weights(1.0, 10.0, 20)
    f = np.array([0.0, 0.5, 1.0, 1.6, 3.0])
    response = np.array([np.sum(w * np.cos(2 * np.pi * x / 10 * np.arange(-20, 21))) for x in f])
    assert response[0] == pytest.approx(1.0)
    assert response[1] == pytest.approx(1.0, abs=0.02)
    assert response[2] == pytest.approx(0.5, abs=0.01)
    assert np.abs(response[3:]).max() < 0.02
    assert np.array_equal(w, w[::-1])


def test_lanczos_keeps_straight_lines_to_the_ends():
    line = 3.0 - 0.2 * np.arange(80.0)
    assert np.allclose(lanczos_filter(line, 10.0), line)
    assert np.allclose(lanczos_filter(np.column_stack([line, -line]), 10.0), np.column_stack([line, -line]))


def test_lanczos_refuses_what_it_cannot_do():
    with pytest.raises(ValueError, match=r"between 0 and 5\.0 Hz"):
        lanczos_weights(5.0, 10.0, 20)
    with pytest.raises(ValueError, match="more than 20 samples, found 20"):
        lanczos_filter(np.zeros(20), 10.0)


def motion(t):
    """A wandering circle: [x y psi u v r] and [u_dot v_dot r_dot], with the pose by fine quadrature."""
    fine = np.linspace(0, t[-1], 40 * len(t))
    u, v, r = 0.5 + 0.2 * np.sin(0.3 * fine), 0.1 * np.sin(0.2 * fine), 0.3 * np.sin(0.25 * fine)
    h = fine[1]
    psi = np.concatenate([[0], np.cumsum((r[1:] + r[:-1]) / 2 * h)])
    vel = np.column_stack([np.cos(psi) * u - np.sin(psi) * v, np.sin(psi) * u + np.cos(psi) * v])
    p = np.vstack([np.zeros(2), np.cumsum((vel[1:] + vel[:-1]) / 2 * h, axis=0)])
    table = np.column_stack([p, psi, u, v, r])
    x = np.column_stack([np.interp(t, fine, c) for c in table.T])
    nu_dot = np.column_stack([0.06 * np.cos(0.3 * t), 0.02 * np.cos(0.2 * t), 0.075 * np.cos(0.25 * t)])
    return x, nu_dot


def made_up(seed, seconds=120.0, imu=True, noise=NOISE, position_hz=1.0, scale=1.0):
    """A run of that motion at 30 Hz; positions are stamped late by the latency, at the tag."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 30)) / 30.0
    x, nu_dot = motion(t)
    u, v, r = x[:, 3:].T
    (lx, ly), (tx, ty) = noise.imu_arm_m, noise.tag_arm_m
    ax = nu_dot[:, 0] - v * r - r**2 * lx - nu_dot[:, 2] * ly
    ay = nu_dot[:, 1] + u * r + nu_dot[:, 2] * lx - r**2 * ly
    bias = rng.normal(0, noise.accel_bias_m_s2, 2) * scale
    draw = lambda sigma: scale * rng.normal(0, sigma, len(t))  # noqa: E731
    columns = {"t_s": t, "pwm_a": np.full(len(t), 1500.0), "battery_v": np.full(len(t), 15.0)}
    columns["psi_rad"] = (x[:, 2] + draw(noise.psi_rad) + np.pi) % (2 * np.pi) - np.pi
    columns["r_rad_s"] = r + scale * rng.normal(0, noise.gyro_bias_rad_s) + draw(noise.r_rad_s)
    columns["ax_m_s2"], columns["ay_m_s2"] = (
        ax + bias[0] + draw(noise.accel_m_s2),
        ay + bias[1] + draw(noise.accel_m_s2),
    )
    if not imu:
        for name in ("r_rad_s", "ax_m_s2", "ay_m_s2"):
            columns[name] = np.full(len(t), np.nan)
    late = np.maximum(t - noise.latency_s, 0.0)
    c, s = np.cos(np.interp(late, t, x[:, 2])), np.sin(np.interp(late, t, x[:, 2]))
    columns["north_m"] = np.interp(late, t, x[:, 0]) + c * tx - s * ty + draw(noise.position_m)
    columns["east_m"] = np.interp(late, t, x[:, 1]) + s * tx + c * ty + draw(noise.position_m)
    off = np.arange(len(t)) % round(30 / position_hz) != 0
    off[0] = True  # before the latency has passed
    columns["north_m"][off] = columns["east_m"][off] = np.nan
    return Run(pl.DataFrame(columns).fill_nan(None), RunMeta(source="made up")), t, x, nu_dot


def test_without_noise_arms_latency_and_bias_are_taken_out():
    run, t, x, nu_dot = made_up(0, scale=0.0)
    found = smooth(run, replace(NOISE, position_m=0.002, psi_rad=1e-4, r_rad_s=1e-4, accel_m_s2=1e-3, jerk=0.05))
    truth = np.column_stack([np.interp(found.t_s, t, c) for c in np.hstack([x, nu_dot]).T])
    middle = slice(50, -50)
    assert np.abs(found.eta - truth[:, :3])[middle].max() < 2e-3
    assert np.abs(found.nu - truth[:, 3:6])[middle].max() < 2e-3
    assert np.abs(found.nu_dot - truth[:, 6:])[middle].max() < 8e-3


def test_errors_are_as_large_as_the_covariance_says():
    ratios = []
    for seed in range(8):
        run, t, x, nu_dot = made_up(seed)
        found = smooth(run, replace(NOISE, jerk=0.03, yaw_jerk=0.05))
        truth = np.column_stack([np.interp(found.t_s, t, c) for c in np.hstack([x, nu_dot]).T])
        error = np.hstack([found.eta, found.nu, found.nu_dot]) - truth
        sigma = np.hstack([np.sqrt(np.diagonal(found.P, axis1=1, axis2=2)), found.nu_dot_sigma])
        ratios.append(((error / sigma) ** 2).mean(axis=0))
    mean = np.mean(ratios, axis=0)
    assert (mean < 2.0).all() and (mean > 0.2).all(), mean


def test_a_known_heading_offset_widens_u_and_v_alone():
    run, *_ = made_up(1, seconds=30)
    plain, wide = smooth(run, NOISE), smooth(run, replace(NOISE, psi_offset_rad=0.05))
    assert np.array_equal(plain.nu, wide.nu)
    assert (wide.P[:, 4, 4] > plain.P[:, 4, 4] + (0.05 * 0.25) ** 2).all()
    assert np.allclose(wide.P[:, 5, 5], plain.P[:, 5, 5])


def test_positions_and_heading_alone_are_enough():
    """As from motion capture: no IMU, 10 Hz and 2 mm."""
    capture = replace(NOISE, position_m=0.002, latency_s=0.0, jerk=0.05)
    run, t, x, _ = made_up(2, imu=False, noise=capture, position_hz=10.0)
    found = smooth(run, capture)
    truth = np.column_stack([np.interp(found.t_s, t, c) for c in x.T])
    assert np.sqrt(((found.nu - truth[:, 3:])[20:-20] ** 2).mean(axis=0)).max() < 0.01


def test_the_yaw_stage_equals_one_large_least_squares_problem():
    """Oracle: the whole heading history as one linear system, solved by numpy."""
    run, *_ = made_up(3, seconds=4.0)
    found = smooth(run, NOISE)
    k, h = len(found.t_s), 0.1
    F, Q = np.eye(4), np.zeros((4, 4))
    F[:3, :3], Q[:3, :3] = random_walk(h, NOISE.yaw_jerk)
    Q[3, 3] = NOISE.gyro_bias_walk**2 * h + 1e-18
    rows, rhs = [], []

    def add(block, value, covariance):
        half = np.linalg.inv(np.linalg.cholesky(np.atleast_2d(covariance)))
        rows.append(half @ block)
        rhs.append(half @ np.atleast_1d(value))

    t, psi = run.samples("psi_rad")
    first = np.zeros((4, 4 * k))
    first[:, :4] = np.eye(4)
    sigmas = [10 * NOISE.psi_rad, 0.5, 0.5, NOISE.gyro_bias_rad_s]
    add(first, [psi[0], 0, 0, 0], np.diag(np.square(sigmas)))
    for i in range(k - 1):
        block = np.zeros((4, 4 * k))
        block[:, 4 * i : 4 * i + 4], block[:, 4 * i + 4 : 4 * i + 8] = -F, np.eye(4)
        add(block, np.zeros(4), Q)
    for z, sigma, H in (
        (psi, NOISE.psi_rad, lambda d: [1, d, d * d / 2, 0]),
        (run.samples("r_rad_s")[1], NOISE.r_rad_s, lambda d: [0, 1, d, 1]),
    ):
        nearest = np.rint(t / h).astype(int)
        for i in range(k):
            mine = nearest == i
            block = np.zeros((1, 4 * k))
            block[0, 4 * i : 4 * i + 4] = H((t[mine] - found.t_s[i]).mean())
            add(block, z[mine].mean(), sigma**2 / mine.sum())
    best = np.linalg.lstsq(np.vstack(rows), np.concatenate(rhs), rcond=None)[0].reshape(k, 4)
    assert np.allclose(found.eta[:, 2], best[:, 0], atol=1e-6)
    assert np.allclose(found.nu[:, 2], best[:, 1], atol=1e-6)
    assert np.allclose(found.bias[:, 2], best[:, 3], atol=1e-6)


def test_the_papers_pipeline_pays_for_having_no_bias():
    run, t, x, _ = made_up(4)
    truth = np.column_stack([np.interp(np.arange(0, 119.9, 0.1), t, c) for c in x.T])[:, 3:]
    paper, better = paper_motion(run, NOISE), smooth(run, NOISE)
    k = min(len(paper.t_s), len(truth), len(better.t_s))
    rms = [np.sqrt(((m.nu[:k] - truth[:k])[50:, :2] ** 2).mean()) for m in (paper, better)]
    assert rms[1] < 0.03 < rms[0]
    assert np.allclose(paper.nu_dot[3:-3], derivative(paper.nu, 0.1)[3:-3])


@pytest.mark.parametrize(("columns", "words"), [(["psi_rad"], "no heading"), (["north_m", "east_m"], "no position")])
def test_a_run_that_cannot_be_smoothed_says_why(columns, words):
    run, *_ = made_up(0, seconds=5.0)
    blank = run.table.with_columns(pl.lit(None, dtype=pl.Float64).alias(name) for name in columns)
    with pytest.raises(ValueError, match=f"made up: {words}"):
        smooth(Run(blank, run.meta), NOISE)
