"""Sensor noise of the fit: white noise of each sample, and slow errors as unknowns of each window's node.

    psi         = psi_true + offset + wander + white    wander: first-order Gauss-Markov, also within a window
    r, a_x, a_y = true + bias + white                   bias: random walk from node to node, constant in a window
    position    = tag + white

The latent acceleration d = [d_u d_v d_r] stands for what the model leaves out: nu_dot = model + d. It is constant
within a window and first-order Gauss-Markov from node to node. It is an acceleration and no force, because a force of
given size would explain more of the motion of a light boat and so bias the fit towards small inertia.

Discretisation of a first-order Gauss-Markov process over a span T: decay exp(-T / tau), variance
sigma^2 (1 - exp(-2 T / tau)); of a random walk: variance q^2 T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from sim.fitting.engine.kernels.windows import whiten_rows

NODE = ("x", "y", "psi", "u", "v", "r", "d_u", "d_v", "d_r", "b_ax", "b_ay", "b_r", "wander", "offset")
"""Unknowns of a node, in SI units: state, latent acceleration, sensor biases, slow errors of the heading."""
STATE, LATENT, BIAS_AX, BIAS_AY, BIAS_R, WANDER, OFFSET = slice(0, 6), slice(6, 9), 9, 10, 11, 12, 13
L = len(NODE)
START_SIGMA = (10.0, 10.0, 1.0, 1.0, 1.0, 0.5)  # x y psi u v r at the start of a run: as good as unknown
TIE_SIGMA = (5e-4, 5e-4, 1e-4, 5e-4, 5e-4, 2e-4)
"""Jump of x y psi u v r from one window to the next that counts as one sigma, per sqrt(s); assumed.

It stands for errors of the integration and for the rounding of command times.
"""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the sensor errors and of the latent acceleration.

    white          of each sample: psi [rad], r [rad/s], a_x, a_y [m/s^2]
    fix_m          of each position, per axis [m]
    wander_rad     of the heading's wander [rad], correlated over `wander_time_s` [s]
    bias           at the start of a run: a_x, a_y [m/s^2], r [rad/s]
    walk           of the biases' random walk: the same units per sqrt(s)
    offset_rad     of the heading's constant error [rad]
    latent         of the latent acceleration u_dot, v_dot [m/s^2], r_dot [rad/s^2], correlated over `latent_time_s` [s]
    slack          factor on `TIE_SIGMA`: above 1 while a fit is far from its solution
    """

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
        """Prior sigma of a node that opens a run, (L,), in the order of `NODE`."""
        return np.array([*START_SIGMA, *self.latent, *self.bias, self.wander_rad, self.offset_rad])

    def tie(self, span_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition from nodes to the next ones `span_s` (T,) later: decay factor and sigma of the noise, (T, L) each.

        The decay of the states is 1 here: they follow the model.
        """
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
    """Noise as stated in the sensor tables of the vessel file; no latent acceleration."""
    imu = vessel.sensors.imu
    accel, gyro = imu.accel_sigma_m_s2, imu.gyro_sigma_rad_s
    a_walk, g_walk = imu.accel_bias_walk_m_s2_sqrt_s, imu.gyro_bias_walk_rad_s_sqrt_s
    return Noise(
        white=(imu.heading_sigma_rad, gyro, accel, accel),
        fix_m=vessel.sensors.position_sigma_m,
        wander_rad=imu.heading_wander_sigma_rad,
        wander_time_s=imu.heading_wander_time_s,
        bias=(imu.accel_bias_sigma_m_s2, imu.accel_bias_sigma_m_s2, imu.gyro_bias_sigma_rad_s),
        walk=(a_walk, a_walk, g_walk),
    )


def whiten(rows: np.ndarray, known: np.ndarray, h_s: np.ndarray, noise: Noise) -> np.ndarray:
    """Heading rows (W, K, C) as innovations of unit variance; the noise is white plus the wander since the node.

    A scalar Kalman filter over each window predicts the wander from the rows before; what is left is white. Its gains
    depend on `known` (W, K) and the steps `h_s` (W, K) alone, so residuals and Jacobian columns pass it alike.
    """
    out = rows[:, :, None].copy()
    whiten_rows(out, 0, known, h_s, noise.white[0], noise.wander_rad, noise.wander_time_s)
    return out[:, :, 0]
