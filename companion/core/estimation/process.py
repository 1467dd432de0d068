"""Process and IMU equations of the filter, from the one vessel model, with exact Jacobians by CasADi.

    s = [x y psi | u v r | X_d Y_d N_d]        latent body force d [N, N, N m]: what the model leaves out
    eta_dot = R(psi) nu,   nu_dot = model(eta, nu, tau + d),   d constant over a step

Specific force at the IMU's place in level axes: `frames.point_acceleration`; what roll and pitch do at its height is
added by `inertial`.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from companion.core.estimation.filter_state import SPEED
from companion.core.geometry.frames import point_acceleration
from companion.core.model.integrate import BufferedStep, VesselModel, eta_dot, rk4

STATES = 9


def at_rest(s: np.ndarray) -> np.ndarray:
    """s (9,) without surge and sway: where equations of a boat whose speed nobody knows are linearised.

    Drag is quadratic. A tangent that moves with the estimate makes two readings of one acceleration tell speed from
    force, which none can; one that stays does not (first-estimates Jacobian: Huang, Mourikis, Roumeliotis 2010).
    """
    resting = s.copy()
    resting[SPEED] = 0.0
    return resting


class Process:
    """Compiled-once functions for one model: `step` for the prediction, `acceleration` for the measurement.

    Both take `drive(f)`: what thruster forces f do, tau = B f, or f itself where that depends on the motion.
    """

    def __init__(self, model: VesselModel, imu_arm_m: tuple[float, float]):
        self._B = model.B if model.is_linear_in_f else None
        self._step = BufferedStep(process_function(model))
        self._acceleration = BufferedStep(acceleration_function(model, imu_arm_m))

    def drive(self, f_n: np.ndarray) -> np.ndarray:
        """What `step` and `imu` take for thruster forces f (n,) [N]."""
        return f_n if self._B is None else self._B @ f_n

    def step(self, s: np.ndarray, drive: np.ndarray, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
        """State after dt_s, (9,), and its Jacobian, (9, 9)."""
        return _split(self._step(s, drive, dt_s), STATES)

    def acceleration(self, s: np.ndarray, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """[a_x a_y] as an unbiased IMU in a level boat would give them, shape (2,), and the Jacobian, shape (2, 9)."""
        return _split(self._acceleration(s, drive), 2)


def _split(packed: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """[value, Jacobian] out of one column-major vector."""
    return packed[:rows], packed[rows:].reshape((rows, STATES), order="F")


def _packed(value: ca.SX, s: ca.SX) -> ca.SX:
    """Value and its Jacobian to s as one dense column."""
    return ca.densify(ca.vec(ca.horzcat(value, ca.jacobian(value, s))))


def _driven(model: VesselModel) -> tuple[ca.SX, Callable[[ca.SX, ca.SX], ca.SX]]:
    """The symbol for `Process.drive`, and (eta, nu) -> tau with it."""
    if model.is_linear_in_f:
        tau = ca.SX.sym("tau", 3)
        return tau, lambda eta, nu: tau
    f = ca.SX.sym("f", model.B.shape[1])
    return f, lambda eta, nu: model.thrust(eta, nu, f)


def process_function(model: VesselModel) -> ca.Function:
    """CasADi function (s, drive, dt) -> vec[s_next, ds_next/ds]; one Runge-Kutta step."""
    s, dt = ca.SX.sym("s", STATES), ca.SX.sym("dt")
    drive, tau = _driven(model)

    def rate(w: ca.SX) -> ca.SX:
        eta, nu, d = w[:3], w[3:6], w[6:9]
        return ca.vertcat(eta_dot(eta, nu), model.nu_dot(eta, nu, tau(eta, nu) + d), ca.DM.zeros(3))

    s_next = rk4(rate, s, dt)
    return ca.Function("process", [s, drive, dt], [_packed(s_next, s)])


def acceleration_function(model: VesselModel, arm_m: tuple[float, float]) -> ca.Function:
    """CasADi function (s, drive) -> vec[(a_x, a_y), Jacobian]."""
    s = ca.SX.sym("s", STATES)
    drive, tau = _driven(model)
    eta, nu, d = s[:3], s[3:6], s[6:9]
    a_x, a_y = point_acceleration(nu, model.nu_dot(eta, nu, tau(eta, nu) + d), arm_m)
    return ca.Function("acceleration", [s, drive], [_packed(ca.vertcat(a_x, a_y), s)])
