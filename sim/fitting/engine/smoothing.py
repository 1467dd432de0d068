"""Rauch-Tung-Striebel smoother of kinematics: position, velocity, acceleration and sensor biases from a whole log.

Two linear Kalman filters with their smoothers (Sarkka, Bayesian Filtering and Smoothing), one after the other:

    stage  state                      measurements                                  process
    yaw    [psi r r_dot b_g]          psi,  r + b_g                                 r_dot, b_g: random walks
    plane  [p v a b], (2,) each, NED  p + R(psi) l_tag  at stamp - latency          a, b: random walks
                                      R(psi)^T a + b + (lever arm of the IMU)

    [u v] = R(psi)^T v,   u_dot = (R^T a)_x + v r,   v_dot = (R^T a)_y - u r

There is no vessel model in it, so the result may be used to fit one. The second stage takes psi, r and r_dot of the
first as known; the variance of psi enters only the covariance of the result. Samples are averaged over one step of the
grid around each instant, at their mean stamp. No rejection of outliers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import R2, point_acceleration
from companion.logs.runs.on_time import on_time
from companion.logs.runs.run import Run
from companion.logs.runs.unwrap import unwrapped

if TYPE_CHECKING:
    from filterpy.kalman import KalmanFilter

RATE_HZ = 10.0
"""Rate of the result, as in the paper."""
_START = {"v": 1.0, "a": 0.5, "r": 0.5, "r_dot": 0.5}  # sigmas before the first sample, SI units; assumed: a slow boat


@dataclass(frozen=True)
class SmootherNoise:
    """Standard deviations, one sigma of each sample; lever arms and latency.

    position_m .. accel_m_s2  white noise of the samples; position per axis
    .._bias_.., .._walk       biases: sigma at the start, and of their random walk per sqrt(s)
    jerk, yaw_jerk            random walk of the accelerations: root of its spectral density [m/s^2.5, rad/s^2.5].
                              Chosen once on simulated key-driven logs of the 1.47 m boat (least error of nu_dot,
                              errors within their sigmas)
    psi_offset_rad            slow error of the heading, which smoothing cannot remove
    tag_arm_m, imu_arm_m      forward, starboard of the body origin [m]
    latency_s                 age of a position at its stamp
    """

    position_m: float
    psi_rad: float
    r_rad_s: float
    accel_m_s2: float
    accel_bias_m_s2: float = 0.05
    accel_bias_walk: float = 5e-4
    gyro_bias_rad_s: float = 3e-3
    gyro_bias_walk: float = 2e-5
    jerk: float = 0.1
    yaw_jerk: float = 0.1
    psi_offset_rad: float = 0.0
    tag_arm_m: tuple[float, float] = (0.0, 0.0)
    imu_arm_m: tuple[float, float] = (0.0, 0.0)
    latency_s: float = 0.0

    @classmethod
    def of(cls, vessel: VesselFile) -> SmootherNoise:
        """From the sensors of a vessel file."""
        imu, tag = vessel.sensors.imu, vessel.sensors.position
        return cls(
            position_m=vessel.sensors.position_sigma_m,
            psi_rad=imu.heading_sigma_rad,
            r_rad_s=imu.gyro_sigma_rad_s,
            accel_m_s2=imu.accel_sigma_m_s2,
            accel_bias_m_s2=imu.accel_bias_sigma_m_s2,
            accel_bias_walk=imu.accel_bias_walk_m_s2_sqrt_s,
            gyro_bias_rad_s=imu.gyro_bias_sigma_rad_s,
            gyro_bias_walk=imu.gyro_bias_walk_rad_s_sqrt_s,
            psi_offset_rad=imu.heading_wander_sigma_rad,
            tag_arm_m=(tag.x_m, tag.y_m),
            imu_arm_m=(imu.x_m, imu.y_m),
            latency_s=tag.latency_s,
        )


@dataclass(frozen=True)
class Smoothed:
    """Motion of the body origin at k instants.

    t_s               (k,) [s]
    eta, nu, nu_dot   (k, 3) NED position [m] and unwrapped heading [rad]; body velocities; body accelerations
    P                 (k, 6, 6) covariance of [x y psi u v r]
    nu_dot_sigma      (k, 3) standard deviation of nu_dot
    bias              (k, 3) accelerometer x, y [m/s^2], gyroscope [rad/s]
    """

    t_s: np.ndarray
    eta: np.ndarray
    nu: np.ndarray
    nu_dot: np.ndarray
    P: np.ndarray
    nu_dot_sigma: np.ndarray
    bias: np.ndarray

    @property
    def nu_sigma(self) -> np.ndarray:
        """Standard deviation of [u v r], (k, 3)."""
        return np.sqrt(self.P[:, [3, 4, 5], [3, 4, 5]])


def smooth(run: Run, noise: SmootherNoise, rate_hz: float = RATE_HZ) -> Smoothed:
    """Smoothed motion on a grid of `rate_hz`, from the first measurement on. ValueError without heading or position."""
    t, run = run.measured_s(), on_time(run)
    grid = t[0] + np.arange(int((t[-1] - t[0]) * rate_hz + 1e-9) + 1) / rate_hz
    yaw, P_yaw = _smooth_yaw(run, noise, grid)
    plane, P_plane = _smooth_plane(run, noise, grid, yaw)
    P_yaw[:, 0, 0] += noise.psi_offset_rad**2
    return _combined(grid, yaw, P_yaw, plane, P_plane)


@dataclass(frozen=True)
class Binned:
    """Means of the samples around k instants: `z` (k, n), mean stamp minus instant `delta_s` (k,), `count` (k,)."""

    z: np.ndarray
    delta_s: np.ndarray
    count: np.ndarray


def binned(t_s: np.ndarray, values: np.ndarray, grid: np.ndarray) -> Binned:
    """Samples `values` (m,) or (m, n) averaged at the nearest instant of a uniform grid (k,).

    Samples beyond its ends are dropped; an instant without samples has count 0 and z = 0.
    """
    h = grid[1] - grid[0]
    at = np.rint((t_s - grid[0]) / h).astype(int)
    inside = (at >= 0) & (at < len(grid))
    at, t_s, values = at[inside], t_s[inside], _columns(values)[inside]
    count = np.bincount(at, minlength=len(grid))
    total = np.column_stack([np.bincount(at, column, minlength=len(grid)) for column in (t_s - grid[at], *values.T)])
    mean = total / np.maximum(count, 1)[:, None]
    return Binned(mean[:, 1:], mean[:, 0], count)


def _columns(values: np.ndarray) -> np.ndarray:
    """(m,) or (m, n) as (m, n); m may be 0."""
    return values[:, None] if values.ndim == 1 else values


def _smooth_yaw(run: Run, noise: SmootherNoise, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States [psi r r_dot b_g] (k, 4) at the grid (k,), and their covariances (k, 4, 4)."""
    t_psi, psi = unwrapped(run)
    if not len(psi):
        raise ValueError(f"{run.meta.source}: no heading (psi_rad) to smooth")
    heading = binned(t_psi, psi, grid)
    gyro = binned(*run.samples("r_rad_s"), grid)
    h = grid[1] - grid[0]
    kf = _kalman_filter(4, 1)
    kf.F, kf.Q = np.eye(4), np.zeros((4, 4))
    kf.F[:3, :3], kf.Q[:3, :3] = random_walk(h, noise.yaw_jerk)
    kf.Q[3, 3] = noise.gyro_bias_walk**2 * h + 1e-18
    kf.x = np.array([psi[0], 0.0, 0.0, 0.0])
    bias = noise.gyro_bias_rad_s if gyro.count.any() else 1e-6
    kf.P = np.diag(np.square([10 * noise.psi_rad, _START["r"], _START["r_dot"], bias]))

    def correct(i: int) -> None:
        if n := heading.count[i]:
            d = heading.delta_s[i]
            kf.update(heading.z[i], R=np.array([[noise.psi_rad**2 / n]]), H=np.array([[1.0, d, d * d / 2, 0.0]]))
        if n := gyro.count[i]:
            H = np.array([[0.0, 1.0, gyro.delta_s[i], 1.0]])
            kf.update(gyro.z[i], R=np.array([[noise.r_rad_s**2 / n]]), H=H)

    return _filter_and_smooth(kf, len(grid), correct)


def _smooth_plane(run: Run, noise: SmootherNoise, grid: np.ndarray, yaw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States [p v a b] (k, 8) at the grid (k,), and their covariances (k, 8, 8). `yaw`: states of the first stage."""
    t_p, tag = run.samples("north_m", "east_m")
    if not len(tag):
        raise ValueError(f"{run.meta.source}: no position (north_m, east_m) to smooth")
    t_p = t_p - noise.latency_s
    origin = tag - np.einsum("kij,j->ki", R2(np.interp(t_p, grid, yaw[:, 0])), noise.tag_arm_m)
    place = binned(t_p, origin, grid)
    accel = binned(*run.samples("ax_m_s2", "ay_m_s2"), grid)
    of_arm = point_acceleration((0.0, 0.0, yaw[:, 1]), (0.0, 0.0, yaw[:, 2]), noise.imu_arm_m)
    z_accel = accel.z - np.column_stack(of_arm)
    R = R2(yaw[:, 0])
    h = grid[1] - grid[0]
    eye = np.eye(2)
    kf = _kalman_filter(8, 2)
    kf.F, kf.Q = np.eye(8), np.zeros((8, 8))
    F, Q = random_walk(h, noise.jerk)
    kf.F[:6, :6], kf.Q[:6, :6] = np.kron(F, eye), np.kron(Q, eye)
    kf.Q[6:, 6:] = eye * (noise.accel_bias_walk**2 * h + 1e-18)
    kf.x = np.concatenate([origin[0], np.zeros(6)])
    bias = noise.accel_bias_m_s2 if accel.count.any() else 1e-6
    kf.P = np.diag(np.repeat(np.square([10 * noise.position_m, _START["v"], _START["a"], bias]), 2))
    H_p, H_a = np.zeros((2, 8)), np.zeros((2, 8))
    H_a[:, 6:] = eye

    def correct(i: int) -> None:
        if n := place.count[i]:
            d = place.delta_s[i]
            H_p[:, :2], H_p[:, 2:4], H_p[:, 4:6] = eye, d * eye, d * d / 2 * eye
            kf.update(place.z[i], R=eye * noise.position_m**2 / n, H=H_p)
        if n := accel.count[i]:
            H_a[:, 4:6] = R[i].T
            kf.update(z_accel[i], R=eye * noise.accel_m_s2**2 / n, H=H_a)

    return _filter_and_smooth(kf, len(grid), correct)


def random_walk(h: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """F and Q (3, 3) of [position velocity acceleration] over `h` [s]: white jerk of spectral density `density`^2."""
    F = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]])
    Q = np.array([[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h * h / 2], [h**3 / 6, h * h / 2, h]])
    return F, density**2 * Q


def _kalman_filter(states: int, measurements: int) -> KalmanFilter:
    from filterpy.kalman import KalmanFilter  # noqa: PLC0415 - slow to import: it brings all of scipy.stats

    return KalmanFilter(dim_x=states, dim_z=measurements)


def _filter_and_smooth(kf: KalmanFilter, k: int, correct) -> tuple[np.ndarray, np.ndarray]:
    """Kalman filter forwards over k instants, RTS smoother backwards: states (k, n), covariances (k, n, n).

    `correct(i)` applies the measurements at instant i to `kf`.
    """
    n = len(kf.x)
    x, P = np.empty((k, n)), np.empty((k, n, n))
    for i in range(k):
        if i:
            kf.predict()
        correct(i)
        x[i], P[i] = kf.x, kf.P
    x, P, _, _ = kf.rts_smoother(x, P)
    return x, P


def _combined(grid: np.ndarray, yaw: np.ndarray, P_yaw: np.ndarray, plane: np.ndarray, P_plane: np.ndarray) -> Smoothed:
    """Both stages in body axes; covariance of [x y psi u v r]: G P G^T, with the heading's variance in u and v."""
    k, R = len(grid), R2(yaw[:, 0])
    body = np.einsum("kji,kj->ki", R, plane[:, 2:4])
    accel = np.einsum("kji,kj->ki", R, plane[:, 4:6])
    r = yaw[:, 1]
    nu_dot = np.column_stack([accel[:, 0] + body[:, 1] * r, accel[:, 1] - body[:, 0] * r, yaw[:, 2]])
    G = np.zeros((k, 6, 12))  # d[x y psi u v r] / d[p v a b | psi r r_dot b_g]
    G[:, :2, :2] = np.eye(2)
    G[:, 2, 8] = G[:, 5, 9] = 1.0
    G[:, 3:5, 2:4] = np.swapaxes(R, 1, 2)
    G[:, 3, 8], G[:, 4, 8] = body[:, 1], -body[:, 0]
    P = np.zeros((k, 12, 12))
    P[:, :8, :8], P[:, 8:, 8:] = P_plane, P_yaw
    sigma = np.sqrt(np.column_stack([P_plane[:, 4, 4], P_plane[:, 5, 5], P_yaw[:, 2, 2]]))
    bias = np.column_stack([plane[:, 6:8], yaw[:, 3]])
    eta = np.column_stack([plane[:, :2], yaw[:, 0]])
    nu = np.column_stack([body, r])
    return Smoothed(grid, eta, nu, nu_dot, G @ P @ np.swapaxes(G, 1, 2), sigma, bias)
