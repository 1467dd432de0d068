"""The kinematic filter, against truth and against one large least-squares problem."""

import numpy as np
import pytest

from sim.fitting.taylor.kinematic_filter import (
    START_VELOCITY_SIGMA_M_S,
    KinematicData,
    KinematicNoise,
    kinematic_filter,
)

NOISE = KinematicNoise(
    accel_sigma_m_s2=0.05,
    accel_bias_sigma_m_s2=0.05,
    accel_bias_walk_m_s2_sqrt_s=0.0005,
    position_sigma_m=0.10,
)


def made_up(seed: int, seconds: float = 120.0) -> tuple[KinematicData, np.ndarray, np.ndarray]:
    """A circle with changing speed at 10 Hz, positions at 1 Hz; truth of position and of [u v]."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, 0.1)
    psi = 0.1 * t
    u = 0.5 + 0.2 * np.sin(0.3 * t)
    v = 0.05 * np.sin(0.2 * t)
    c, s = np.cos(psi), np.sin(psi)
    vel = np.column_stack([c * u - s * v, s * u + c * v])
    accel_ned = np.diff(vel, axis=0, append=vel[-1:]) / 0.1
    p = np.zeros_like(vel)
    p[1:] = np.cumsum(vel[:-1] * 0.1 + accel_ned[:-1] * 0.005, axis=0)
    body = np.column_stack([c * accel_ned[:, 0] + s * accel_ned[:, 1], -s * accel_ned[:, 0] + c * accel_ned[:, 1]])
    body += rng.normal(0, NOISE.accel_bias_sigma_m_s2, 2) + rng.normal(0, NOISE.accel_sigma_m_s2, body.shape)
    z = p + rng.normal(0, NOISE.position_sigma_m, p.shape)
    z[np.arange(len(t)) % 10 != 0] = np.nan
    return KinematicData(t, psi, np.full_like(t, 0.1), body, z), p, np.column_stack([u, v])


def test_speeds_without_a_speed_sensor() -> None:
    for seed in range(3):
        data, p, nu = made_up(seed)
        out = kinematic_filter(data, NOISE)
        late = slice(300, None)
        assert np.sqrt(((out.eta[late, :2] - p[late]) ** 2).sum(axis=1).mean()) < 0.12
        assert np.sqrt(((out.nu[late, :2] - nu[late]) ** 2).mean()) < 0.05


def test_without_bias_it_is_the_papers_filter_and_pays_for_it() -> None:
    data, _, nu = made_up(1)
    paper = KinematicNoise(0.05, 0.0, 0.0, 0.10)
    out, best = kinematic_filter(data, paper), kinematic_filter(data, NOISE)
    assert np.abs(out.bias_m_s2).max() < 1e-6
    late = slice(300, None)
    error = [np.sqrt(((o.nu[late, :2] - nu[late]) ** 2).mean()) for o in (out, best)]
    assert error[1] < error[0]


def test_filter_ends_where_one_large_least_squares_problem_ends() -> None:
    """Oracle: the whole log as one linear system, solved by numpy. Straight north, so axes decouple."""
    data, _, _ = made_up(2, seconds=6.0)
    k = len(data.t_s)
    data = KinematicData(data.t_s, np.zeros(k), data.r_rad_s, data.accel_m_s2, data.position_m)
    filtered = kinematic_filter(data, KinematicNoise(0.05, 0.0, 0.0, 0.10))
    dt, rows, rhs = 0.1, [], []

    def add(columns: dict[int, float], value: float, sigma: float) -> None:
        row = np.zeros(k + 2)
        for i, x in columns.items():
            row[i] = x / sigma
        rows.append(row)
        rhs.append(value / sigma)

    # unknowns: k accelerometer errors, start position, start speed
    z, a = data.position_m[:, 0], data.accel_m_s2[:, 0]
    add({k: 1.0}, z[0], NOISE.position_sigma_m)
    add({k + 1: 1.0}, 0.0, START_VELOCITY_SIGMA_M_S)
    for i in range(k):
        add({i: 1.0}, 0.0, NOISE.accel_sigma_m_s2)
        if np.isfinite(z[i]):
            lever = {j: dt**2 * (i - j - 0.5) for j in range(i)}
            known = sum(a[j] * g for j, g in lever.items())
            add({**lever, k: 1.0, k + 1: i * dt}, z[i] - known, NOISE.position_sigma_m)
    best = np.linalg.lstsq(np.array(rows), np.array(rhs), rcond=None)[0]
    speed = best[k + 1] + np.concatenate([[0.0], np.cumsum((a + best[:k])[:-1] * dt)])
    assert filtered.nu[-1, 0] == pytest.approx(speed[-1], abs=1e-4)


def test_a_log_without_positions_says_so() -> None:
    data, _, _ = made_up(0, seconds=5.0)
    none = KinematicData(data.t_s, data.psi_rad, data.r_rad_s, data.accel_m_s2, data.position_m * np.nan)
    with pytest.raises(ValueError, match="no position"):
        kinematic_filter(none, NOISE)
