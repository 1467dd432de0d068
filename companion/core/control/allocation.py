"""From a wanted body force to bounded commands, and from commands to pulse widths.

    e = argmin |W (D e - tau)|^2 + eps |e|^2   subject to  e_min <= e <= e_max

with W falling by a factor of 30 from yaw to surge to sway, so that what is out of reach is given up in that
order: sway first, yaw last. Where tau is within reach D e = tau (to 1e-3), and of all such e the smallest.

Fixed thrusters: D = B, e = f, the thrusts. Others: e are the components of `actuators`, each within what it reaches at
the present velocity, and each actuator says what to command for its own.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import lsq_linear

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.actuators.propulsion import ActuatorSet, channels_of, is_steered
from companion.core.model.thrusters import configuration_matrix, force_limits

PRIORITY = np.array([30.0, 1.0, 900.0])
"""Of X, Y, N: yaw before surge before sway."""
_EFFORT = 1e-2  # sqrt(eps): small beside the least weight, so that effort never buys force


def allocate(
    tau: np.ndarray,
    vessel: VesselFile,
    *,
    nu_r: np.ndarray | None = None,
    now: np.ndarray | None = None,
    within_s: float = math.inf,
) -> np.ndarray:
    """Commands (n,) [N; angles rad] for tau = [X N, Y N, N N m]; within limits whatever tau is.

    `nu_r`: velocity through the water, None: not known; `now`: what is commanded already, None: 0; `within_s`: until
    the next command, see `Actuator.controls`. A boat of fixed thrusters needs none of them. A tau that is not finite
    gives zeros.
    """
    n = len(vessel.controls)
    if not np.all(np.isfinite(tau)):
        return np.zeros(n)
    if not is_steered(vessel):
        return _smallest(tau, configuration_matrix(vessel), *force_limits(vessel))
    actuators = ActuatorSet.of(vessel)
    e = _smallest(tau, actuators.directions, *actuators.limits(nu_r))
    return actuators.controls(e, nu_r, np.zeros(n) if now is None else now, within_s)


def _smallest(tau: np.ndarray, D: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """e above, shape (m,)."""
    able, e = lower < upper, np.zeros(D.shape[1])  # a dead thruster gets nothing
    A = np.vstack([PRIORITY[:, None] * D, _EFFORT * np.eye(len(e))])[:, able]
    b = np.concatenate([PRIORITY * np.asarray(tau, dtype=float), np.zeros(len(e))])
    if able.any():
        e[able] = lsq_linear(A, b, bounds=(lower[able], upper[able]), method="bvls").x
    return np.clip(e, lower, upper)


def pulse_widths(f: np.ndarray, vessel: VesselFile, voltage_v: float) -> tuple[int, ...]:
    """Pulse widths [us] in the order of f, for commands at a battery voltage [V].

    Commands are clamped to the limits first; one that is not finite becomes neutral.
    """
    channels = channels_of(vessel)
    wanted = np.where(np.isfinite(f), f, 0.0)
    return tuple(
        c.pulse(float(np.clip(value, c.lower, c.upper)), voltage_v) for c, value in zip(channels, wanted, strict=True)
    )
