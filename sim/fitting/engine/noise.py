"""Sensor noise of the fit: white noise per sample, and what drifts slowly, as one node value per window.

    psi = psi_true + offset + wander + white      wander: Gauss-Markov, changing within a window too
    r, a_x, a_y = true + bias + white             bias: random walk from node to node
    fix = tag + white

The latent acceleration, Gauss-Markov from node to node and constant within a window, is what the model leaves out. As a
force it would favour light boats, for which the same force explains more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from sim.fitting.engine.kernels.windows import whiten_rows

NODE = ("x", "y", "psi", "u", "v", "r", "d_u", "d_v", "d_r", "b_ax", "b_ay", "b_r", "wander", "offset")
STATE, LATENT, BIAS_AX, BIAS_AY, BIAS_R, WANDER, OFFSET = slice(0, 6), slice(6, 9), 9, 10, 11, 12, 13
L = len(NODE)
START_SIGMA = (10.0, 10.0, 1.0, 1.0, 1.0, 0.5)  # x y psi u v r at the start of a run: as good as unknown
TIE_SIGMA = (5e-4, 5e-4, 1e-4, 5e-4, 5e-4, 2e-4)  # what a state may jump per sqrt(s): integration and command rounding


@dataclass(frozen=True)
class Noise:
    """One sigma each. `white`: psi [rad], r [rad/s], a_x, a_y; `latent`: u_dot, v_dot, r_dot [m/s^2, rad/s^2]."""

    white: tuple[float, float, float, float]
    fix_m: float
    wander_rad: float
    wander_time_s: float
    bias: tuple[float, float, float]
    walk: tuple[float, float, float]
    offset_rad: float = 0.02  # mounting and declination; assumed
    latent: tuple[float, float, float] = (0.0, 0.0, 0.0)
    latent_time_s: float = 5.0
    slack: float = 1.0  # times TIE_SIGMA

    def node_start(self) -> np.ndarray:
        """Sigma of a node that opens a run, shape (L,)."""
        return np.array([*START_SIGMA, *self.latent, *self.bias, self.wander_rad, self.offset_rad])

    def tie(self, span_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Decay and sigma from one node to the next after `span_s`, shapes (W, L); states decay by the model."""
        span = span_s[:, None]
        decay, sigma = np.ones((len(span_s), L)), np.full((len(span_s), L), 1e-6)
        sigma[:, STATE] = self.slack * np.array(TIE_SIGMA) * np.sqrt(span)
        latent = np.exp(-span / self.latent_time_s)
        decay[:, LATENT] = latent
        sigma[:, LATENT] = np.array(self.latent) * np.sqrt(1 - latent**2)
        sigma[:, BIAS_AX : BIAS_R + 1] = np.maximum(np.array(self.walk) * np.sqrt(span), 1e-7)
        wander = np.exp(-span / self.wander_time_s)
        decay[:, [WANDER]] = wander
        sigma[:, [WANDER]] = np.maximum(self.wander_rad * np.sqrt(1 - wander**2), 1e-7)
        return decay, sigma


def noise_of(vessel: VesselFile) -> Noise:
    """Noise as the vessel file's sensor tables have it."""
    imu, uwb = vessel.sensors.imu, vessel.sensors.uwb
    accel, gyro = imu.accel_sigma_m_s2, imu.gyro_sigma_rad_s
    a_walk, g_walk = imu.accel_bias_walk_m_s2_sqrt_s, imu.gyro_bias_walk_rad_s_sqrt_s
    return Noise(
        white=(imu.heading_sigma_rad, gyro, accel, accel),
        fix_m=uwb.range_sigma_m,
        wander_rad=imu.heading_wander_sigma_rad,
        wander_time_s=imu.heading_wander_time_s,
        bias=(imu.accel_bias_sigma_m_s2, imu.accel_bias_sigma_m_s2, imu.gyro_bias_sigma_rad_s),
        walk=(a_walk, a_walk, g_walk),
    )


def whiten(rows: np.ndarray, known: np.ndarray, h_s: np.ndarray, noise: Noise) -> np.ndarray:
    """Heading rows (W, K, C) as innovations of unit variance: white noise plus wander that starts from the node's.

    Scalar Kalman filter per window; its gains do not depend on the rows, so residual and Jacobian pass it alike.
    """
    out = rows[:, :, None].copy()
    whiten_rows(out, 0, known, h_s, noise.white[0], noise.wander_rad, noise.wander_time_s)
    return out[:, :, 0]
