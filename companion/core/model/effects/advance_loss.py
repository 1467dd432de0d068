"""Thrust lost to speed through the water along the thruster.

    f' = f - (k |f| + k_s sqrt|f|) u_a,   u_a = (u_r - y r) cos a + (v_r + x r) sin a

k (`propulsion.advance_loss_s_m`): share of the thrust lost per m/s. k_s (`propulsion.advance_loss_sqrt_N_s_m`): with
f = T_nn n |n| the loss T_nu |n| u_a of Fossen (2011), section 9. Both rounded off below `SMOOTH_N`: no slope at f = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from companion.core.model.effects.elementwise import library

SMOOTH_N = 0.1
"""Forces below which size, root and jet are rounded off; assumed: small beside any force that moves the boat."""


def size(force_N: Any) -> Any:
    """|f|, smooth and 0 at f = 0: f^2 / sqrt(f^2 + e^2)."""
    return force_N**2 / library(force_N).sqrt(force_N**2 + SMOOTH_N**2)


def advanced(f: Sequence[Any], positions: np.ndarray, nu_r: Any, k_s_m: Any, k_sqrt: float = 0.0) -> list[Any]:
    """f' [N] of the forces f of n thrusters at `positions` (n, 3), x [m], y [m], azimuth [rad], at nu_r."""
    out = []
    for force, (x, y, a) in zip(f, positions, strict=True):
        u_a = (nu_r[0] - y * nu_r[2]) * np.cos(a) + (nu_r[1] + x * nu_r[2]) * np.sin(a)
        lost = k_s_m * size(force)
        if k_sqrt:
            lost = lost + k_sqrt * force**2 / (force**2 + SMOOTH_N**2) ** 0.75
        out.append(force - lost * u_a)
    return out
