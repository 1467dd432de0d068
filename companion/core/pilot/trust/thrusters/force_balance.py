"""The wrench that the model does not explain, from specific force, yaw rate and the commanded thrust over one tick.

    w = M (nu_dot_measured - nu_dot_model(eta, nu, B f))                          [N, N, N m]
    a = what the model says that the accelerometer feels in level axes            [m/s^2]

u_dot, v_dot: mean specific force in level axes less its bias, moved from the IMU's place to the origin;
r_dot: difference of the yaw rate over the tick. f: forces that the commands give, with dead time and lag.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.estimation.filter_state import B_ACCEL, ETA, NU, FilterState
from companion.core.geometry.frames import point_acceleration, to_level
from companion.core.model.integrate import BufferedStep
from companion.core.model.manoeuvring import StructuredModel, mass_matrix


class ForceBalance:
    """Constant parts for one vessel."""

    def __init__(self, vessel: VesselFile):
        model, imu = StructuredModel.of(vessel), vessel.sensors.imu
        eta, nu, f = ca.SX.sym("eta", 3), ca.SX.sym("nu", 3), ca.SX.sym("f", len(vessel.controls))
        rate = model.nu_dot(eta, nu, model.thrust(eta, nu, f))
        self._rate = BufferedStep(ca.Function("nu_dot", [eta, nu, f], [ca.densify(rate)]))
        self._arm_m, self._M = (imu.x_m, imu.y_m), mass_matrix(vessel)

    def residual(
        self, before: FilterState, now: FilterState, force_m_s2: np.ndarray, r_dot_rad_s2: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """w (3,) and a (2,) of the tick between two filter states; `force_m_s2`: mean specific force in body axes."""
        nu = (before.x[NU] + now.x[NU]) / 2
        modelled = self._rate(now.x[ETA], nu, (before.f_n + now.f_n) / 2)
        level = np.array(to_level(*now.tilt, *map(float, force_m_s2))[:2]) - now.x[B_ACCEL]
        felt = np.array(point_acceleration(nu, modelled, self._arm_m))
        da = level - felt
        dr = r_dot_rad_s2 - modelled[2]
        x, y = self._arm_m
        return self._M @ np.array([da[0] + y * dr, da[1] - x * dr, dr]), felt
