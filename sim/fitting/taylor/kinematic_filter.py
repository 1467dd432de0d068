"""Kinematic Kalman filter of the reference pipeline: positions and IMU, no vessel model.

    x = [x y | v_n v_e | b_ax b_ay]     p_dot = v,   v_dot = R(psi) (a - b),   b: random walk      (NED)
    [u v] = R(psi)^T [v_n v_e]

This is the filter of the paper (its section 4: UWB positions at 1 Hz, IMU at 30 Hz, speeds at 10 Hz); with
`accel_bias_sigma_m_s2 = 0` it has no biases, as in the paper. With psi measured the equations are linear. filterpy's
batch Kalman filter estimates the error of dead reckoning from the first position.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter

from companion.core.geometry.frames import R2

START_VELOCITY_SIGMA_M_S = 0.5
"""Sigma of the speed at the start; assumed: at rest or slow."""


@dataclass(frozen=True)
class KinematicData:
    """One log on one time grid of k samples, 10 Hz in the paper.

    t_s, psi_rad, r_rad_s  (k,)
    accel_m_s2             (k, 2) in body axes, level, at the body origin
    position_m             (k, 2) of the body origin in NED, NaN where there is none
    """

    t_s: np.ndarray
    psi_rad: np.ndarray
    r_rad_s: np.ndarray
    accel_m_s2: np.ndarray
    position_m: np.ndarray


@dataclass(frozen=True)
class KinematicNoise:
    """Standard deviations; the accelerometer's is that of one sample of the grid."""

    accel_sigma_m_s2: float
    accel_bias_sigma_m_s2: float
    accel_bias_walk_m_s2_sqrt_s: float
    position_sigma_m: float


@dataclass(frozen=True)
class KinematicEstimate:
    """`eta` (k, 3) [m, m, rad], `nu` (k, 3) [m/s, m/s, rad/s], `bias_m_s2` (k, 2), `P` (k, 6, 6) of x."""

    t_s: np.ndarray
    eta: np.ndarray
    nu: np.ndarray
    bias_m_s2: np.ndarray
    P: np.ndarray


def kinematic_filter(data: KinematicData, noise: KinematicNoise) -> KinematicEstimate:
    """Causal estimate at every sample. Raises ValueError where the log has no position."""
    reckoned, error, P = _filtered(data, noise)
    return _estimate(data, reckoned + error, P)


def _reckoned(data: KinematicData) -> np.ndarray:
    """Dead reckoning with zero bias from the first position at rest, shape (k, 6)."""
    valid = np.flatnonzero(np.isfinite(data.position_m).all(axis=1))
    if not len(valid):
        raise ValueError("the log has no position to start from")
    dt = np.diff(data.t_s)[:, None]
    a = np.einsum("kij,kj->ki", R2(data.psi_rad), data.accel_m_s2)[:-1]
    x = np.zeros((len(data.t_s), 6))
    x[1:, 2:4] = np.cumsum(a * dt, axis=0)
    x[:, :2] = data.position_m[valid[0]]
    x[1:, :2] += np.cumsum(x[:-1, 2:4] * dt + a * dt**2 / 2, axis=0)
    return x


def _transitions(data: KinematicData, noise: KinematicNoise) -> tuple[np.ndarray, np.ndarray]:
    """F and Q of the error state, (k, 6, 6) each; entry i leads from sample i - 1 to i, as filterpy counts."""
    k = len(data.t_s)
    F, Q = np.tile(np.eye(6), (k, 1, 1)), np.zeros((k, 6, 6))
    R = R2(data.psi_rad)
    for i, dt in enumerate(np.diff(data.t_s)):
        F[i + 1, :2, 2:4] = dt * np.eye(2)
        F[i + 1, :2, 4:] = -(dt**2) / 2 * R[i]
        F[i + 1, 2:4, 4:] = -dt * R[i]
        G = np.vstack([dt**2 / 2 * np.eye(2), dt * np.eye(2)])
        Q[i + 1, :4, :4] = G @ G.T * noise.accel_sigma_m_s2**2
        Q[i + 1, 4:, 4:] = np.eye(2) * noise.accel_bias_walk_m_s2_sqrt_s**2 * dt
    return F, Q + 1e-14 * np.eye(6)  # keeps the smoother's inverse defined where a state has no noise


def _filtered(data: KinematicData, noise: KinematicNoise) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Dead reckoning (k, 6), filtered error (k, 6) and its covariance (k, 6, 6)."""
    reckoned = _reckoned(data)
    kf = KalmanFilter(dim_x=6, dim_z=2)
    kf.x = np.zeros(6)
    kf.H = np.eye(2, 6)
    kf.R = np.eye(2) * noise.position_sigma_m**2
    sigma = [noise.position_sigma_m, START_VELOCITY_SIGMA_M_S, max(noise.accel_bias_sigma_m_s2, 1e-6)]
    kf.P = np.diag(np.repeat(np.square(sigma), 2))
    zs = [row if np.isfinite(row).all() else None for row in data.position_m - reckoned[:, :2]]
    F, Q = _transitions(data, noise)
    error, P, _, _ = kf.batch_filter(zs, Fs=F, Qs=Q)
    return reckoned, error, P


def _estimate(data: KinematicData, x: np.ndarray, P: np.ndarray) -> KinematicEstimate:
    """The estimate from the states x (k, 6) and their covariances P (k, 6, 6)."""
    body = np.einsum("kji,kj->ki", R2(data.psi_rad), x[:, 2:4])
    eta = np.column_stack([x[:, :2], data.psi_rad])
    return KinematicEstimate(data.t_s, eta, np.column_stack([body, data.r_rad_s]), x[:, 4:], P)
