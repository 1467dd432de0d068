"""A propeller with a rudder in its race: two channels, thrust T and rudder angle delta.

    e = [T - F sin delta, -F cos delta]        D: along x at the propeller's y, along y at the rudder's x
    F = 1/2 rho A f_a U (u_R sin delta - v_R cos delta),  U^2 = u_R^2 + v_R^2,  f_a = 6.13 L / (L + 2.25)
    u_R^2 = eta u_P^2 + (1 - eta) u^2,    u_P = u + kappa (sqrt(u^2 + 2 T / (rho A_P)) - u)
    v_R = -gamma (v + x r)

F: normal force on the rudder [N]; u, v, r: velocity through the water; A: `area_m2`, L: `aspect_ratio`, A_P: disc of
the propeller; eta, kappa, gamma: `race_share`, `race_gain`, `straightening`. u and T count only where they drive water
over the rudder from ahead: a boat that goes astern, or lies still without thrust, is not steered.
Sources: MMG standard method, Yasukawa and Yoshimura (2015), J. Mar. Sci. Technol. 20, 37-52 (F, f_a by Fujii, u_R;
without interaction with the hull: t_R = a_H = 0); race: momentum theory of the actuator disc; Fossen (2021), 9.5.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np

from companion.core.configuration.servos import Rudder
from companion.core.configuration.vessel_file import ForceMap, Propulsion, Thruster
from companion.core.constants import WATER_KG_M3
from companion.core.model.actuators.actuator import direction, positive
from companion.core.model.actuators.channel import angle_channel, thrust_channel

SLOW_M_S, WEAK_N = 0.02, 0.05
"""Speed and thrust below which flow is rounded off; assumed: no rudder feels them."""
GRID = 61
"""Angles at which the side force is looked up."""


class RudderPropeller:
    """An `Actuator`."""

    at_rest = (True, False)

    def __init__(self, t: Thruster, rudder: Rudder, fmap: ForceMap, p: Propulsion):
        self._rudder = rudder
        self.channels = (thrust_channel(t, fmap, p), angle_channel(rudder))
        side = direction(rudder.x_m, t.y_m, math.pi / 2)
        self.directions = np.column_stack([direction(t.x_m, t.y_m, 0.0), side])

    def components(self, nu_r: Any, f: Any) -> list[Any]:
        """Thrust less the rudder's drag; side force of the rudder."""
        normal = self.normal_force(nu_r, f[0], f[1])
        return [f[0] - normal * ca.sin(f[1]), -normal * ca.cos(f[1])]

    def normal_force(self, nu_r: Any, thrust_n: Any, angle_rad: Any) -> Any:
        """F [N], positive on the side that turns the boat to starboard."""
        k = self._rudder
        u, v, r = nu_r[0], nu_r[1], nu_r[2]
        disc_m2 = math.pi / 4 * k.propeller_diameter_m**2
        # 1. the race: final speed by momentum theory, of which `race_gain` is reached at the rudder
        ahead = positive(u, SLOW_M_S)
        final = ca.sqrt(ahead**2 + 2 * positive(thrust_n, WEAK_N) / (WATER_KG_M3 * disc_m2) + SLOW_M_S**2)
        race = ahead + k.race_gain * (final - ca.sqrt(ahead**2 + SLOW_M_S**2))
        # 2. mean square of the flow over the rudder, and the flow across it
        square = k.race_share * race**2 + (1 - k.race_share) * ahead**2
        along = ca.sqrt(square + 1e-9) - math.sqrt(1e-9)
        across = -k.straightening * (v + k.x_m * r)
        # 3. normal force
        slope = 6.13 * k.aspect_ratio / (k.aspect_ratio + 2.25)
        speed = ca.sqrt(along**2 + across**2 + 1e-9)
        into = along * ca.sin(angle_rad) - across * ca.cos(angle_rad)
        return 0.5 * WATER_KG_M3 * k.area_m2 * slope * speed * into

    def limits(self, nu_r: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Thrust, and the rudder's side force at the propeller's largest thrust ahead."""
        thrust, _ = self.channels
        side = [force for _, force in self._side_forces(nu_r, thrust.upper)]
        return np.array([thrust.lower, min(side)]), np.array([thrust.upper, max(side)])

    def controls(
        self, e: np.ndarray, nu_r: np.ndarray | None, now: np.ndarray, within_s: float = math.inf
    ) -> np.ndarray:
        """Thrust as it is wanted; the angle that gives the side force at the inflow of this thrust.

        Where the velocity is not known, or there is no flow, the angle that gives it to a boat at rest at full thrust.
        """
        thrust, _ = self.channels
        t = min(max(float(e[0]), thrust.lower), thrust.upper)
        angles, sides = zip(*self._side_forces(nu_r, thrust.upper if nu_r is None else t), strict=True)
        if max(map(abs, sides)) < WEAK_N:
            angles, sides = zip(*self._side_forces(None, thrust.upper), strict=True)
        order = np.argsort(sides)
        return np.array([t, float(np.interp(e[1], np.array(sides)[order], np.array(angles)[order]))])

    def _side_forces(self, nu_r: np.ndarray | None, thrust_n: float) -> list[tuple[float, float]]:
        """(angle, side force) over all angles; `nu_r` None: at rest."""
        _, angle = self.channels
        flow = (0.0, 0.0, 0.0) if nu_r is None else nu_r
        return [
            (float(a), float(self.components(flow, (thrust_n, float(a)))[1]))
            for a in np.linspace(angle.lower, angle.upper, GRID)
        ]
