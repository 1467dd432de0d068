"""What the sensors say of a track. Attitude and IMU share an instant; a fix is stamped when its bytes arrive.

a = nu_dot + omega x nu at the IMU's place, minus gravity by roll and pitch; turned, scaled, biased, noisy
psi = true + offset + A sin(psi - psi_0) + B sin 2 psi + slow wander + noise
fix = (p + R(psi) arm) (1 + scale) + noise;   stamp = t + latency + drift t
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from tests.hidden.plant.sail import Track
from tests.hidden.plant.world import BASIN_M, STEP_S, G, Sense, World

ANCHORS = ((0.0, 0.0), (BASIN_M, 0.0), (BASIN_M, BASIN_M), (0.0, BASIN_M))
RECORD_S = 600.0


@dataclass
class Readings:
    """IMU rows (t, psi, r, ax, ay, phi, theta), shape (n, 7); fixes (stamp, north, east), shape (k, 3)."""

    imu: np.ndarray
    fixes: np.ndarray
    tilt_told: bool


def readings(world: World, track: Track, rng: np.random.Generator) -> Readings:
    """Noisy readings of a track."""
    sense = world.sense
    clean = imu_clean(world, track.t0 + track.imu_step * STEP_S, track.state, track.rate, track.tilt)
    n = len(clean)
    noise = rng.standard_normal((n, 6))
    noise *= (sense.heading_sigma, sense.gyro_sigma, sense.accel_sigma, sense.accel_sigma,
              sense.tilt_sigma, sense.tilt_sigma)  # fmt: skip
    out = clean + noise
    out[:, 0] += sense.wander * _slow(n, 1 / (sense.imu_hz * sense.wander_time), rng)
    out[:, 0] = (out[:, 0] + np.pi) % (2 * np.pi) - np.pi
    if sense.ahrs_s:
        out[:, 4:] += _following(sense, track)
    imu = np.column_stack([track.imu_step * STEP_S, out])
    return Readings(imu, _fixes(world, track, rng), sense.tilt_told)


def _following(sense: Sense, track: Track) -> np.ndarray:
    """Error of roll and pitch [rad], shape (n, 2), of an AHRS that takes the specific force for gravity's, slowly."""
    state, rate = track.state, track.rate
    a_x, a_y = rate[:, 3] - state[:, 4] * state[:, 5], rate[:, 4] + state[:, 3] * state[:, 5]
    share = 1 - np.exp(-1 / (sense.imu_hz * sense.ahrs_s))
    return np.asarray(lfilter([share], [1, share - 1], np.column_stack([-a_y, a_x]) / G, axis=0))


def imu_clean(world: World, t: np.ndarray, state: np.ndarray, rate: np.ndarray, heel: np.ndarray) -> np.ndarray:
    """psi (not wrapped), r, ax, ay, phi, theta without noise, shape (n, 6); t on the common clock."""
    s = world.sense
    psi, u, v, r = state[:, 2], state[:, 3], state[:, 4], state[:, 5]
    u_dot, v_dot, r_dot = rate[:, 3], rate[:, 4], rate[:, 5]
    phi, theta = heel[:, 0], heel[:, 1]
    ax = u_dot - v * r - s.imu_x * r**2 - s.imu_y * r_dot + G * np.sin(theta)
    ay = v_dot + u * r + s.imu_x * r_dot - s.imu_y * r**2 - G * np.cos(theta) * np.sin(phi)
    a = np.radians(s.misalign_deg)
    turned_x, turned_y = np.cos(a) * ax + np.sin(a) * ay, np.cos(a) * ay - np.sin(a) * ax
    grown = 1 + s.accel_drift * t / RECORD_S
    return np.column_stack(
        [
            psi + np.radians(heading_error_deg(world, state)),
            (1 + s.gyro_scale) * r + s.gyro_bias * (1 + s.gyro_drift * t / RECORD_S),
            s.accel_scale[0] * turned_x + s.accel_bias[0] * grown,
            s.accel_scale[1] * turned_y + s.accel_bias[1] * grown,
            phi,
            theta,
        ]
    )


def heading_error_deg(world: World, state: np.ndarray) -> np.ndarray:
    """Constant, by heading, by place [deg]."""
    s, psi = world.sense, state[:, 2]
    size, north, east, radius = world.odd.magnet
    away2 = (state[:, 0] - north) ** 2 + (state[:, 1] - east) ** 2
    by_heading = s.iron_deg * np.sin(psi - np.radians(s.iron_at_deg)) + s.soft_iron_deg * np.sin(2 * psi)
    return s.heading_deg + by_heading + size * np.exp(-away2 / (2 * radius**2))


def fix_clean(sense: Sense, state: np.ndarray) -> np.ndarray:
    """Place of the tag as the UWB frame has it, without noise, shape (n, 2)."""
    c, sn = np.cos(state[:, 2]), np.sin(state[:, 2])
    tag = state[:, :2] + np.column_stack([c * sense.uwb_x - sn * sense.uwb_y, sn * sense.uwb_x + c * sense.uwb_y])
    return tag * np.array([1 + sense.scale * sense.scale_north, 1 + sense.scale])


def stamp_delay(sense: Sense, t: np.ndarray) -> np.ndarray:
    """By how much a fix measured at t (since the log's first row) is older than its stamp [s]."""
    drift = sense.drift * t * (t / 300.0 if sense.drift_late else 1.0)
    return sense.latency + drift


def _fixes(world: World, track: Track, rng: np.random.Generator) -> np.ndarray:
    sense, state, t = world.sense, track.fix_state, track.fix_step * STEP_S
    fix = fix_clean(sense, state)
    n = len(fix)
    phase = rng.uniform(0, 2 * np.pi, 2)
    fix = fix + sense.warp_m * np.sin(2 * np.pi / 9.0 * state[:, 1::-1] + phase)
    fix = fix + sense.uwb_sigma * rng.standard_normal((n, 2))
    fix = fix + _blocked(sense, state, rng)
    if sense.slow_fix_m:
        step = 1 / (sense.uwb_hz * sense.slow_fix_s)
        fix = fix + sense.slow_fix_m * np.column_stack([_slow(n, step, rng), _slow(n, step, rng)])
    odd = (rng.uniform(size=n) < sense.odd_fixes) * rng.uniform(0.3, 1.2, n)
    angle = rng.uniform(0, 2 * np.pi, n)
    fix = fix + odd[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    stamp = t + stamp_delay(sense, t)
    keep = (rng.uniform(size=n) >= sense.lost_fixes) & (stamp >= 0) & (stamp < track.steps * STEP_S)
    if sense.outage[0]:
        begins = np.flatnonzero(rng.uniform(size=n) < sense.outage[0])
        ends = t[begins] + rng.exponential(sense.outage[1], len(begins))
        keep &= ~((t >= t[begins, None]) & (t < ends[:, None])).any(axis=0)
    return np.column_stack([stamp, fix])[keep]


def _blocked(sense: Sense, state: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Fixes pushed away from an anchor that is seen past an obstacle."""
    n = len(state)
    chance, extra = np.full(n, sense.nlos), sense.nlos_m * rng.exponential(1.0, n)
    away = state[:, :2] - np.array(ANCHORS[sense.nlos_anchor])
    if sense.nlos_zone:
        near = (np.abs(away) < BASIN_M / 2).all(axis=1)
        chance = np.where(near, np.minimum(1.0, 4 * sense.nlos), 0.0)
    hit = rng.uniform(size=n) < chance
    return (hit * extra / np.maximum(np.linalg.norm(away, axis=1), 0.1))[:, None] * away


def _slow(n: int, step: float, rng: np.random.Generator) -> np.ndarray:
    """Gauss-Markov of unit size whose time constant is 1/step samples."""
    decay = np.exp(-step)
    noise = rng.standard_normal(n) * np.sqrt(1 - decay**2)
    value, out = float(rng.standard_normal()), np.empty(n)
    for i, e in enumerate(noise.tolist()):
        value = decay * value + e
        out[i] = value
    return out
