"""Kinematics of the UWB tag between two steps of a window."""

from __future__ import annotations

import numpy as np

from companion.core.geometry.frames import point_acceleration, point_velocity, rotate
from sim.fitting.diagnose.catalogue.effect import TagKinematics
from sim.fitting.diagnose.posterior.physics import EffectPhysics


def tag_kinematics(
    physics: EffectPhysics, x: np.ndarray, nu_dot: np.ndarray, delta_s: np.ndarray, arm: np.ndarray, when: np.ndarray
) -> TagKinematics:
    """Tag at lever `arm` (2,) [m] `delta_s` (m,) after states x (m, 6) with nu_dot (m, 3), Taylor to second order.

        v = [u - r l_y, v + r l_x],   a = [u_dot - r_dot l_y - r v_y, v_dot + r_dot l_x + r v_x]   (body axes)
        p(t + delta) = p + R(psi) (l + delta v + delta^2 / 2 a)                                    (NED)

    `when` (m,): time of the samples [s], for the clock since the first fix.
    """
    r, half = x[:, 5], delta_s**2 / 2
    nu, a = x[:, 3:].T, nu_dot.T
    u, v = point_velocity(nu, arm)
    u_dot, v_dot = point_acceleration(nu, a, arm)

    def turned(ahead: np.ndarray, across: np.ndarray) -> np.ndarray:
        return np.stack(rotate(x[:, 2], ahead, across), axis=1)

    def carried(x_m: float, y_m: float) -> np.ndarray:
        """R(psi) (l + delta v + delta^2 / 2 a) of the turn alone: the place above is linear in its lever arm."""
        still, arm = np.zeros_like(r), (x_m, y_m)
        du, dv = point_velocity((still, still, r), arm)
        da, db = point_acceleration((still, still, r), (still, still, a[2]), arm)
        return turned(x_m + delta_s * du + half * da, y_m + delta_s * dv + half * db)

    return TagKinematics(
        when - physics.first_fix_s,
        physics.fix_clock_s,
        x[:, 2] + delta_s * r,
        r,
        x[:, :2] + turned(arm[0] + delta_s * u + half * u_dot, arm[1] + delta_s * v + half * v_dot),
        turned(u + delta_s * u_dot, v + delta_s * v_dot),
        turned(u_dot, v_dot),
        physics.centre_m,
        carried,
    )
