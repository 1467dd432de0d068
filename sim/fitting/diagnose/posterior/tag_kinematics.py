"""Where the tag is between two nodes of a window, and how it moves."""

from __future__ import annotations

import numpy as np

from companion.core.geometry.frames import point_acceleration, point_velocity, rotate
from sim.fitting.diagnose.catalogue.effect import TagKinematics
from sim.fitting.diagnose.posterior.physics import EffectPhysics


def tag_kinematics(
    physics: EffectPhysics, x: np.ndarray, nu_dot: np.ndarray, delta_s: np.ndarray, arm: np.ndarray, when: np.ndarray
) -> TagKinematics:
    """The tag `delta_s` (m,) after states x (m, 6) with accelerations nu_dot (m, 3), to second order."""
    r, half = x[:, 5], delta_s**2 / 2
    u, v = point_velocity(x[:, 3:].T, arm)
    u_dot, v_dot = point_acceleration(x[:, 3:].T, nu_dot.T, arm)

    def turned(ahead: np.ndarray, across: np.ndarray) -> np.ndarray:
        return np.stack(rotate(x[:, 2], ahead, across), axis=1)

    return TagKinematics(
        when - physics.first_fix_s,
        physics.fix_clock_s,
        x[:, 2] + delta_s * r,
        r,
        x[:, :2] + turned(arm[0] + delta_s * u + half * u_dot, arm[1] + delta_s * v + half * v_dot),
        turned(u + delta_s * u_dot, v + delta_s * v_dot),
        turned(u_dot, v_dot),
        physics.centre_m,
    )
