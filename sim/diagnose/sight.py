"""Where the tag is between two nodes of a window, and how it moves."""

from __future__ import annotations

import numpy as np

from sim.diagnose.effect import Sight
from sim.diagnose.physics import Physics

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


def sight(
    physics: Physics, x: np.ndarray, nu_dot: np.ndarray, delta_s: np.ndarray, arm: np.ndarray, when: np.ndarray
) -> Sight:
    """The tag `delta_s` (m,) after states x (m, 6) with accelerations nu_dot (m, 3), to second order."""
    c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
    R = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)
    r = x[:, 5:6]
    velocity = x[:, 3:5] + r * (TURN @ arm)
    gain = nu_dot[:, :2] + nu_dot[:, 2:] * (TURN @ arm) + r * (velocity @ TURN.T)
    d = delta_s[:, None]
    shift = arm + d * velocity + d**2 / 2 * gain

    def turned(vector: np.ndarray) -> np.ndarray:
        return (R @ vector[..., None])[..., 0]

    return Sight(
        when,
        physics.fix_clock_s,
        x[:, 2] + delta_s * x[:, 5],
        x[:, 5],
        x[:, :2] + turned(shift),
        turned(velocity + d * gain),
        turned(gain),
        physics.centre_m,
    )
