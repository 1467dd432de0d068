"""Residuals of the command: how much it takes beyond what the reference needs, against itself, and how fast it changes.

    fixed thrusters    [c - c_ss,  (I - B^+ B) c,  c - f]
    steered ones       [e(c) - e_ss,  (I - D^+ D) e(c),  S (c - f)]       D, e: `actuators`; S: 1 for N, 10 N for 1 rad

c_ss = B^+ tau_ss and e_ss = D^+ tau_ss: the least thrust that holds the reference against drag, loads and disturbance.
Components e are forces, so that effort has one meaning whatever turns; they are taken at the reference velocity. Where
not all of tau_ss can be had D^+ prefers as `allocation` does.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from companion.core.control.allocation import PRIORITY
from companion.core.control.nmpc.settings import Actuation, NmpcSettings
from companion.core.guidance.reference_row import Column as ref
from companion.core.model.actuators.channel import EQUAL_CHANGE
from companion.core.model.actuators.propulsion import ActuatorSet
from companion.core.model.integrate import FORCES, VesselModel


def control_residual(
    s: NmpcSettings, model: VesselModel, actuation: Actuation, x: Any, c: Any, row: Any, d: Any
) -> Any:
    """Weighted residuals of the command c (n,) in state x; forces over the `strength` of the thrusters."""
    if model.actuators is not None:
        return _steered_residual(s, model, model.actuators, actuation, x, c, row, d)
    B = model.B * actuation.able
    n = B.shape[1]
    projector = ca.DM(np.eye(n) - np.linalg.pinv(B) @ B)
    return ca.vertcat(
        np.sqrt(s.effort) / actuation.strength * (c - steady_force(model, B, row, d)),
        np.sqrt(s.null_space) / actuation.strength * ca.mtimes(projector, c),
        np.sqrt(s.rate) / actuation.strength * (c - x[FORCES]),
    )


def steady_force(model: VesselModel, B: np.ndarray, row: Any, d: Any) -> Any:
    """c_ss, shape (n,) [N], of fixed thrusters: smallest thrust that holds the reference velocity.

    `B`: columns of dead thrusters are 0. Where thrust depends on the motion, one fixed-point step is added:
    c_ss += B^+ (tau_ss - thrust(c_ss)).
    """
    eta_ref, nu_ref = _reference(row)
    tau_ss = steady_tau(model, row, d)
    B_plus = ca.DM(np.linalg.pinv(B))
    c_ss = ca.mtimes(B_plus, tau_ss)
    return c_ss if model.is_linear_in_f else c_ss + ca.mtimes(B_plus, tau_ss - model.thrust(eta_ref, nu_ref, c_ss))


def steady_tau(model: VesselModel, row: Any, d: Any) -> Any:
    """tau_ss, shape (3,) [N, N, N m]: holds the reference velocity at the reference heading.

    nu_dot is affine in tau with a constant slope S, so tau_ss = -S^+ nu_dot(eta_ref, nu_ref, d).
    """
    eta, nu, tau = ca.SX.sym("eta", 3), ca.SX.sym("nu", 3), ca.SX.sym("tau", 3)
    slope_of = ca.Function("slope", [eta, nu, tau], [ca.jacobian(model.nu_dot(eta, nu, tau), tau)])
    slope = np.array(slope_of(0, 0, 0))
    return -ca.mtimes(ca.DM(np.linalg.pinv(slope)), model.nu_dot(*_reference(row), d))


def _reference(row: Any) -> tuple[Any, Any]:
    """Pose and velocity of a reference row."""
    eta_ref = ca.vertcat(row[ref.NORTH], row[ref.EAST], row[ref.PSI])
    return eta_ref, ca.vertcat(row[ref.U], row[ref.V], row[ref.R])


def _steered_residual(
    s: NmpcSettings, model: VesselModel, actuators: ActuatorSet, actuation: Actuation, x: Any, c: Any, row: Any, d: Any
) -> Any:
    D = actuators.directions * np.array([actuation.able[place] for place in actuators.thrust_places])
    D_plus = np.linalg.pinv(PRIORITY[:, None] * D) * PRIORITY
    e = actuators.components(_reference(row)[1], c)
    against = np.eye(D.shape[1]) - D_plus @ D
    strength, scale = actuation.strength, EQUAL_CHANGE["N"] / actuation.equal_change
    return ca.vertcat(
        np.sqrt(s.effort) / strength * (e - ca.mtimes(ca.DM(D_plus), steady_tau(model, row, d))),
        np.sqrt(s.null_space) / strength * ca.mtimes(ca.sparsify(ca.DM(against), 1e-9), e),
        np.sqrt(s.rate) * scale * (c - x[FORCES]),
    )
