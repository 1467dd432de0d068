"""The optimal control problem, built once: multiple shooting over N stages.

    min  sum_k |residual(x_k, c_k, row_k)|^2 + terminal |residual(x_N, row_N)|^2
    s.t. x_0 = x0,  x_{k+1} = F(x_k, c_k, d),  c_min <= c_k <= c_max,  |c_k - f_k| <= rate_limit T_lag

w = [x_0 c_0 x_1 c_1 .. x_N], rows [gap_0 rate_0 gap_1 rate_1 ..]: the order of hpipm. With f_dot =
(c - f) / T_lag the rate limit is local to a stage, so the structure stays that of an optimal control
problem. Both constraints hold for every x0 whose forces are within the limits: the problem is never infeasible.

Three functions share the stage: `qp` (Gauss-Newton Hessian, gradient, Jacobian), `measure` (cost and gaps)
and, for the rescue and the tests, `nlp`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from companion.core.control.nmpc.effort import control_residual
from companion.core.control.nmpc.settings import Actuation, NmpcSettings
from companion.core.control.nmpc.stage import advance, state_residual
from companion.core.geometry.fence import Fence, Level
from companion.core.guidance.reference_row import COLUMNS
from companion.core.model.integrate import VesselModel


@dataclass(frozen=True)
class NmpcProblem:
    """Sizes, bounds and functions. Inputs of all functions: w, rows (8, N + 1), d (3,)."""

    settings: NmpcSettings
    nx: int
    nu: int
    qp: ca.Function
    measure: ca.Function
    roll: ca.Function
    nlp: dict[str, Any]
    w_min: np.ndarray
    w_max: np.ndarray
    g_min: np.ndarray
    g_max: np.ndarray

    @property
    def stages(self) -> int:
        """N."""
        return self.settings.stages

    def join(self, x: np.ndarray, c: np.ndarray) -> np.ndarray:
        """(N + 1, nx), (N, nu) -> w."""
        return np.concatenate([np.hstack([x[:-1], c]).ravel(), x[-1]])

    def split(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W -> (N + 1, nx), (N, nu)."""
        z = w[: -self.nx].reshape(self.stages, self.nx + self.nu)
        return np.vstack([z[:, : self.nx], w[-self.nx :]]), z[:, self.nx :]


def _stage_functions(
    model: VesselModel, actuation: Actuation, s: NmpcSettings, levels: Sequence[Level]
) -> tuple[ca.Function, ca.Function, ca.Function]:
    """(x, c, row, d) -> linearised stage; the same without derivatives; last state."""
    n = model.B.shape[1]
    x, c = ca.SX.sym("x", 6 + n), ca.SX.sym("c", n)
    row, d = ca.SX.sym("row", len(COLUMNS)), ca.SX.sym("d", 3)
    z = ca.vertcat(x, c)
    x_next = ca.cse(advance(model, x, c, d, s.step_s))
    residual = ca.vertcat(state_residual(s, x, row, levels), control_residual(s, model, actuation, x, c, row, d))
    J = ca.jacobian(residual, z)
    linear = ca.Function(
        "stage",
        [x, c, row, d],
        [x_next, *(ca.densify(e) for e in (ca.jacobian(x_next, z), 2 * J.T @ J, 2 * J.T @ residual))],
    )
    plain = ca.Function("plain", [x, c, row, d], [x_next, ca.sumsqr(residual)])
    last = np.sqrt(s.terminal) * state_residual(s, x, row, levels)
    J_N = ca.jacobian(last, x)
    terminal = ca.Function(
        "terminal",
        [x, row],
        [ca.densify(2 * J_N.T @ J_N), ca.densify(2 * J_N.T @ last), ca.sumsqr(last)],
    )
    return linear, plain, terminal


def build(model: VesselModel, actuation: Actuation, settings: NmpcSettings, fence: Fence | None = None) -> NmpcProblem:
    """Build the functions for one model, its limits, settings and fence."""
    N, nu = settings.stages, model.B.shape[1]
    nx = 6 + nu
    linear, plain, terminal = _stage_functions(model, actuation, settings, fence.levels(ca.fmin) if fence else ())
    w = ca.MX.sym("w", N * (nx + nu) + nx)
    rows, d = ca.MX.sym("rows", len(COLUMNS), N + 1), ca.MX.sym("d", 3)
    Z, x_N = ca.reshape(w[: N * (nx + nu)], nx + nu, N), w[N * (nx + nu) :]
    X, C = Z[:nx, :], Z[nx:, :]
    ahead = ca.horzcat(X[:, 1:], x_N)
    along = ca.repmat(d, 1, N)

    x_next, D, H, g = linear.map(N)(X, C, rows[:, :N], along)
    H_N, g_N, cost_N = terminal(x_N, rows[:, N])
    rest = ca.vertcat(x_next - ahead, C - X[6:, :])
    blocks = ca.horzsplit(H, nx + nu)
    qp = ca.Function(
        "qp",
        [w, rows, d],
        [ca.diagcat(*blocks, H_N), ca.vertcat(ca.vec(g), g_N), _jacobian(D, N, nx, nu), ca.vec(rest)],
    )
    x_next, cost = plain.map(N)(X, C, rows[:, :N], along)
    g_plain = ca.vec(ca.vertcat(x_next - ahead, C - X[6:, :]))
    total = ca.sum2(cost) + cost_N
    limit = actuation.rate_limit_n_s * model.lag_s
    free, slack = np.full(nx, np.inf), np.full(nu, limit)
    return NmpcProblem(
        settings,
        nx,
        nu,
        qp,
        ca.Function("measure", [w, rows, d], [total, g_plain]),
        plain.mapaccum("roll", N),
        {"x": w, "p": ca.veccat(rows, d), "f": total, "g": g_plain},
        np.concatenate([np.tile(np.r_[-free, actuation.force_min_n], N), -free]),
        np.concatenate([np.tile(np.r_[free, actuation.force_max_n], N), free]),
        np.tile(np.r_[np.zeros(nx), -slack], N),
        np.tile(np.r_[np.zeros(nx), slack], N),
    )


def _jacobian(D: ca.MX, N: int, nx: int, nu: int) -> ca.MX:
    """Rows [A_k B_k -I; 0 -E I] down the diagonal, shape (N (nx + nu), N (nx + nu) + nx)."""
    nz = nx + nu
    width = N * nz + nx
    rate_rows = ca.sparsify(ca.DM(np.hstack([np.zeros((nu, 6)), -np.eye(nu), np.eye(nu)])))
    bands = []
    for k, block in enumerate(ca.horzsplit(D, nz)):
        after = width - (k + 1) * nz
        bands.append(ca.horzcat(ca.MX(nx, k * nz), block, -ca.MX.eye(nx), ca.MX(nx, after - nx)))
        bands.append(ca.horzcat(ca.MX(nu, k * nz), ca.MX(rate_rows), ca.MX(nu, after)))
    return ca.vertcat(*bands)
