"""A thruster that a servo turns: two channels, thrust T and angle delta beyond its azimuth a.

    e = [T cos delta, T sin delta]        D: directions a and a + 90 deg

To turn by more than a right angle it pushes the other way instead: it never flips through the far side.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np

from companion.core.configuration.servos import Steering
from companion.core.configuration.vessel_file import ForceMap, Propulsion, Thruster
from companion.core.model.actuators.actuator import direction
from companion.core.model.actuators.channel import angle_channel, thrust_channel

IDLE_N = 0.2
"""Forces below this do not turn the servo; assumed: no boat feels them."""


class AzimuthThruster:
    """An `Actuator`."""

    at_rest = (True, True)

    def __init__(self, t: Thruster, steering: Steering, fmap: ForceMap, p: Propulsion):
        self.channels = (thrust_channel(t, fmap, p), angle_channel(steering))
        a = math.radians(t.azimuth_deg)
        self.directions = np.column_stack([direction(t.x_m, t.y_m, a), direction(t.x_m, t.y_m, a + math.pi / 2)])

    def components(self, nu_r: Any, f: Any) -> list[Any]:
        """Thrust along the azimuth and across it."""
        return [f[0] * ca.cos(f[1]), f[0] * ca.sin(f[1])]

    def limits(self, nu_r: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """The box around what it reaches; `controls` keeps to the disc in it."""
        thrust, angle = self.channels
        most = max(thrust.upper, -thrust.lower)
        across = most * math.sin(min(angle.upper, math.pi / 2))
        ahead, astern = thrust.upper, thrust.lower
        if angle.upper > math.pi / 2:
            ahead, astern = max(ahead, -astern), -max(ahead, -astern)
        return np.array([astern, -across]), np.array([ahead, across])

    def controls(
        self, e: np.ndarray, nu_r: np.ndarray | None, now: np.ndarray, within_s: float = math.inf
    ) -> np.ndarray:
        """Angle and thrust: of the two angles (thrust ahead or astern) the one nearer to the present one.

        The angle is what the servo reaches `within_s`, and the thrust what of e lies along that: none is given while it
        still points elsewhere.
        """
        thrust, angle = self.channels
        size, delta = math.hypot(*e), float(now[1])
        if size > IDLE_N:
            ahead = math.atan2(e[1], e[0])
            ways = [ahead + k * math.pi for k in (-2, -1, 0, 1, 2)]
            within = [way for way in ways if angle.lower - 1e-9 <= way <= angle.upper + 1e-9]
            delta = min(within or ways, key=lambda way: abs(way - float(now[1])))
        turn = angle.rate * within_s
        delta = min(max(delta, angle.lower, now[1] - turn), angle.upper, now[1] + turn)
        along = e[0] * math.cos(delta) + e[1] * math.sin(delta)
        return np.array([min(max(along, thrust.lower), thrust.upper), delta])
