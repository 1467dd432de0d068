"""A thruster that does not turn: one channel, one component.

e = f        D = [cos a, sin a, x sin a - y cos a]'
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from companion.core.configuration.vessel_file import ForceMap, Propulsion, Thruster
from companion.core.model.actuators.actuator import direction
from companion.core.model.actuators.channel import thrust_channel


class FixedThruster:
    """An `Actuator`."""

    at_rest = (True,)

    def __init__(self, t: Thruster, fmap: ForceMap, p: Propulsion):
        self.channels = (thrust_channel(t, fmap, p),)
        self.directions = direction(t.x_m, t.y_m, np.deg2rad(t.azimuth_deg))[:, None]

    def components(self, nu_r: Any, f: Any) -> list[Any]:
        """Its thrust."""
        return [f[0]]

    def limits(self, nu_r: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Those of its thrust."""
        (thrust,) = self.channels
        return np.array([thrust.lower]), np.array([thrust.upper])

    def controls(
        self, e: np.ndarray, nu_r: np.ndarray | None, now: np.ndarray, within_s: float = math.inf
    ) -> np.ndarray:
        """The force itself, within limits."""
        return np.clip(e, *self.limits(nu_r))
