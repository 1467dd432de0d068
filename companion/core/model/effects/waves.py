"""Waves that rock the boat along one direction over ground: a narrow band of force without a mean.

    X = a cos q,  Y = 1.5 a sin q,  N = 0.25 m a sin 2q,   q = beta_wave + pi - psi
    a = F_w c,   c_dot = -g c - w s + noise,   s_dot = w c - g s + noise,   w = 2 pi / T_p,   g = 0.04 w

c and s of unit size. The simulated world draws a; filter, NMPC and fits take the mean, which is none.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from companion.core.geometry.frames import cos_sin
from companion.core.model.effects.term import LoadParameter, Term, Values

SWAY_SHARE, YAW_ARM_M = 1.5, 0.25  # of a small catamaran; assumed
WIDTH = 0.04  # g / w, relative half width of the band at half its height; assumed


def pattern(q_rad: Any) -> tuple[Any, Any, Any]:
    """Body force [N, N, N m] of a = 1 N at the angle q between the bow and where the waves run."""
    cos, sin = cos_sin(q_rad)
    return cos, SWAY_SHARE * sin, YAW_ARM_M * cos_sin(2 * q_rad)[1]


def next_phasor(p: Values, phasor: complex, dt_s: float, noise: complex) -> complex:
    """c + i s after dt_s, exactly; `noise`: two standard normal numbers as a complex one."""
    omega = 2 * np.pi / p["T_p_s"]
    kept = np.exp(-WIDTH * omega * dt_s)
    return complex(phasor * kept * np.exp(1j * omega * dt_s) + np.sqrt(1 - kept**2) * noise)


TERM = Term(
    "waves",
    "X = a cos q, Y = 1.5 a sin q, N = 0.25 m a sin 2q, q = beta_wave + pi - psi; a: rms F_w, period T_p, no mean",
    (
        LoadParameter("F_w_N", "N", 0.0, 0.0, 1000.0, "rms of the force along the waves"),
        LoadParameter("T_p_s", "s", 2.0, 0.2, 60.0, "period of the spectral peak"),
        LoadParameter("beta_wave_deg", "deg", 0.0, -360.0, 360.0, "direction they come from, from north"),
    ),
)
