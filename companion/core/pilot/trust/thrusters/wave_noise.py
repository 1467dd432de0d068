"""Waves in the wrench that the model does not explain: noise of one band (Fossen 2021, section 13.2), in each axis

    x1_dot = x2        x2_dot = -omega_0^2 x1 - 2 zeta omega_0 x2 + white noise        wave = x2

As states of a Kalman filter they leave innovations that are white, as far as waves are of this band. Commands that
answer waves explain nothing then, for nobody knows an innovation beforehand; and as waves have no mean, what is steady
is not taken for them.
"""

from __future__ import annotations

import math

import numpy as np

OMEGA_RAD_S, ZETA = 3.0, 0.3
"""Waves of 1.3 to 3.5 s, as a small boat meets them: assumed."""
STATIONARY = np.diag([OMEGA_RAD_S**-2, 1.0])
"""Covariance of [x1 x2] of a wave of variance 1."""


def transition(dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Phi (2, 2) of [x1 x2] over a tick, and the covariance of what is new in it for a wave of variance 1."""
    damping, omega = ZETA * OMEGA_RAD_S, OMEGA_RAD_S * math.sqrt(1 - ZETA**2)
    c, s = math.cos(omega * dt_s), math.sin(omega * dt_s) / omega
    Phi = math.exp(-damping * dt_s) * np.array([[c + damping * s, s], [-(OMEGA_RAD_S**2) * s, c - damping * s]])
    return Phi, STATIONARY - Phi @ STATIONARY @ Phi.T
