"""One stage of the optimal control problem: dynamics over one step, and the residuals of the cost.

    x = [x y psi | u v r | f_1..f_n],  c = [c_1..c_n] commands [N, rad], constant over the step
    f(t) = c + (f - c) exp(-t / T_lag)                       exact
    [eta, nu](t): Runge-Kutta of order 4 with tau(t) = B f(t) + d       B f: `VesselModel.thrust`

The lag is solved exactly because it is five times quicker than the step; the hull needs one step of 0.2 s.
d [N, N, N m] is a constant body force, the disturbance that the filter estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from companion.core.control.nmpc.settings import NmpcSettings
from companion.core.geometry.fence import Level
from companion.core.guidance.reference_row import Column as ref
from companion.core.model.integrate import ETA, FORCES, NU, VesselModel, eta_dot, rk4_step
from companion.core.model.thrust_lag import first_order_lag


def advance(model: VesselModel, x: Any, c: Any, d: Any, h: float) -> Any:
    """State after `h` seconds, shape (6 + n,)."""

    def force(t: float) -> Any:
        return first_order_lag(x[FORCES], c, t, model.lag_s)

    def rate(y: Any, t: float) -> Any:
        tau = model.thrust(y[ETA], y[NU], force(t)) + d
        return ca.vertcat(eta_dot(y[ETA], y[NU]), model.nu_dot(y[ETA], y[NU], tau))

    return ca.vertcat(rk4_step(rate, x[:6], h, (0.0, h / 2, h)), force(h))


def advance_jacobian(model: VesselModel, x: Any, c: Any, d: Any, h: float) -> Any:
    """Jacobian of `advance` with respect to [x c], shape (6 + n, 6 + 2 n), by the variational equation.

    Equal to CasADi's Jacobian of the whole step up to rounding, in two thirds of the operations.
    """
    n = x.numel() - 6
    y, f, unit = ca.SX.sym("y", 6), ca.SX.sym("f", n), ca.SX.eye(n)
    rate = ca.cse(ca.vertcat(eta_dot(y[ETA], y[NU]), model.nu_dot(y[ETA], y[NU], model.thrust(y[ETA], y[NU], f) + d)))
    slopes = ca.Function("slopes", [y, f, d], ca.cse([rate, ca.jacobian(rate, y), ca.jacobian(rate, f)]))

    def force(t: float) -> tuple[Any, Any]:
        left = first_order_lag(1.0, 0.0, t, model.lag_s)
        by_f, by_c = (ca.diag(left), ca.diag(1 - left)) if np.ndim(left) else (left * unit, (1 - left) * unit)
        return first_order_lag(x[FORCES], c, t, model.lag_s), ca.horzcat(ca.SX(n, 6), by_f, by_c)

    def variational(state: Any, t: float) -> Any:
        """d/dt [y, Y], Y = dy/d[x c]:   y_dot = g(y, f),   Y_dot = g_y Y + g_f df/d[x c]."""
        f_t, f_by = force(t)
        k, by_y, by_f = slopes(state[:, 0], f_t, d)
        return ca.horzcat(k, by_y @ state[:, 1:] + by_f @ f_by)

    start = ca.horzcat(x[:6], ca.SX.eye(6), ca.SX(6, 2 * n))
    return ca.vertcat(rk4_step(variational, start, h, (0.0, h / 2, h))[:, 1:], force(h)[1])


def _excess(value: Any, limit: float) -> Any:
    return ca.fmax(ca.fabs(value) - limit, 0.0)


def state_residual(s: NmpcSettings, x: Any, row: Any, levels: Sequence[Level] = ()) -> Any:
    """Weighted residuals of a state from its reference row and the fence; the sum of squares is the state cost."""
    sin, cos = ca.sin(row[ref.PATH_ANGLE]), ca.cos(row[ref.PATH_ANGLE])
    north, east = x[0] - row[ref.NORTH], x[1] - row[ref.EAST]
    weighted = [
        (s.cross_track, -sin * north + cos * east),
        (s.along_track, row[ref.STATION] * (cos * north + sin * east)),
        (s.heading, x[2] - row[ref.PSI]),
        (s.surge, x[3] - row[ref.U]),
        (s.sway, x[4] - row[ref.V]),
        (s.yaw_rate, x[5] - row[ref.R]),
    ]
    if s.speed_limit_m_s is not None:
        weighted += [(s.soft, _excess(x[3], s.speed_limit_m_s)), (s.soft, _excess(x[4], s.speed_limit_m_s))]
    if s.yaw_rate_limit_rad_s is not None:
        weighted.append((s.soft, _excess(x[5], s.yaw_rate_limit_rad_s)))
    weighted += [(s.fence, ca.fmax(s.fence_margin_m - level(x[0], x[1]), 0.0)) for level in levels]
    return ca.vertcat(*(np.sqrt(w) * residual for w, residual in weighted))
