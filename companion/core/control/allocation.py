"""From a wanted body force to bounded thruster forces, and from forces to pulse widths.

    f = argmin |W (B f - tau)|^2 + eps |f|^2   subject to  f_min <= f <= f_max

with W falling by a factor of 30 from yaw to surge to sway, so that what is out of reach is given up in that
order: sway first, yaw last. Where tau is within reach B f = tau (to 1e-3), and of all such f the smallest.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.thrusters import configuration_matrix, force_limits, pwm_from_force

_PRIORITY = np.array([30.0, 1.0, 900.0])  # X, Y, N: yaw before surge before sway
_EFFORT = 1e-2  # sqrt(eps): small beside the least weight, so that effort never buys force


def allocate(tau: np.ndarray, vessel: VesselFile) -> np.ndarray:
    """Thruster forces [N], shape (n,), for tau = [X N, Y N, N N m]; within limits whatever tau is.

    A tau that is not finite gives zero forces.
    """
    B = configuration_matrix(vessel)
    n = B.shape[1]
    if not np.all(np.isfinite(tau)):
        return np.zeros(n)
    lower, upper = force_limits(vessel)
    able, f = lower < upper, np.zeros(n)  # a dead thruster gets nothing
    A = np.vstack([_PRIORITY[:, None] * B, _EFFORT * np.eye(n)])[:, able]
    b = np.concatenate([_PRIORITY * np.asarray(tau, dtype=float), np.zeros(n)])
    if able.any():
        f[able] = lsq_linear(A, b, bounds=(lower[able], upper[able]), method="bvls").x
    return np.clip(f, lower, upper)


def pulse_widths(f_n: np.ndarray, vessel: VesselFile, voltage_v: float) -> tuple[int, ...]:
    """Pulse widths [us] in the vessel file's order for forces [N] at a battery voltage [V].

    Forces are clamped to the limits first; a force that is not finite becomes neutral.
    """
    lower, upper = force_limits(vessel)
    finite = np.where(np.isfinite(f_n), f_n, 0.0)
    bounded = np.clip(finite, lower, upper)
    return tuple(
        pwm_from_force(t, vessel.force_maps[t.force_map], float(f), voltage_v)
        for t, f in zip(vessel.thrusters, bounded, strict=True)
    )
