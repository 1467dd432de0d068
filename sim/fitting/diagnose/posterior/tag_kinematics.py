"""Where the tag is between two nodes of a window, and how it moves."""

from __future__ import annotations

import numpy as np

from sim.fitting.diagnose.catalogue.effect import TagKinematics
from sim.fitting.diagnose.posterior.physics import EffectPhysics


def tag_kinematics(
    physics: EffectPhysics, x: np.ndarray, nu_dot: np.ndarray, delta_s: np.ndarray, arm: np.ndarray, when: np.ndarray
) -> TagKinematics:
    """The tag `delta_s` (m,) after states x (m, 6) with accelerations nu_dot (m, 3), to second order."""
    c, s, r = np.cos(x[:, 2]), np.sin(x[:, 2]), x[:, 5]
    u, v = x[:, 3] - r * arm[1], x[:, 4] + r * arm[0]
    u_dot = nu_dot[:, 0] - nu_dot[:, 2] * arm[1] - r * v
    v_dot = nu_dot[:, 1] + nu_dot[:, 2] * arm[0] + r * u
    half = delta_s**2 / 2

    def turned(ahead: np.ndarray, across: np.ndarray) -> np.ndarray:
        return np.stack([c * ahead - s * across, s * ahead + c * across], axis=1)

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
