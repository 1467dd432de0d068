"""An `Ocp` as one nonlinear program in MX, the way a user of CasADi writes it, and the kept solvers on it.

w = [x_0 c_0 x_1 .. x_N], rows [gap_0 rate_0 gap_1 ..], the order that fatrop and hpipm want. A solver that has one step
only (`one_step`) and those that converge (`solver`) are called alike.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from companion.core.control.ocp import Ocp

QUIET: dict[str, Any] = {"print_time": False, "error_on_fail": False}
IPOPT: dict[str, Any] = {**QUIET, "ipopt.print_level": 0, "ipopt.sb": "yes"}
HPIPM_INF = 1e4
"""What hpipm takes for an absent bound: large against any step, small enough to keep it well scaled."""


class Nlp:
    """The program and its bounds. Parameters: [p_0 .. p_N q], and with `rows` x0 behind.

    As it is for IPOPT and hpipm: x_0 is fixed by its bounds, which IPOPT eliminates; gap_k = F(x_k, c_k) - x_{k+1}.
    `rows`, as fatrop wants it: x_0 = x0 is a row of g after gap_0; gaps with the other sign, without which its
    structure detection refuses.
    """

    def __init__(self, ocp: Ocp, *, rows: bool = False):
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        self.ocp = ocp
        F = ca.Function("F", [ocp.x, ocp.c, ocp.p, ocp.q], [ocp.following])
        stage = ca.Function("stage", [ocp.x, ocp.c, ocp.p, ocp.q], [ca.sumsqr(ocp.residual)])
        last = ca.Function("last", [ocp.x, ocp.p, ocp.q], [ca.sumsqr(ocp.last)])
        x, c = [ca.MX.sym(f"x{k}", n) for k in range(N + 1)], [ca.MX.sym(f"c{k}", m) for k in range(N)]
        p, q = [ca.MX.sym(f"p{k}", ocp.p.numel()) for k in range(N + 1)], ca.MX.sym("q", ocp.q.numel())
        x0 = ca.MX.sym("x0", n)
        cost, g, w, equal = 0, [], [], []
        for k in range(N):
            cost += stage(x[k], c[k], p[k], q)
            gap = F(x[k], c[k], p[k], q) - x[k + 1]
            g.append(-gap if rows else gap)
            equal += [True] * n
            if rows and k == 0:
                g.append(x[0] - x0)
                equal += [True] * n
            w += [x[k], c[k]]
            if ocp.forces is not None:
                g.append(c[k] - x[k][ocp.forces : ocp.forces + m])
                equal += [False] * m
        cost += last(x[N], p[N], q)
        self.equal = np.array(equal)
        self.problem = {
            "x": ca.vertcat(*w, x[N]),
            "p": ca.vertcat(*p, q, *([x0] if rows else [])),
            "f": cost,
            "g": ca.vertcat(*g),
        }
        free = np.full(n, np.inf)
        self.low = np.concatenate([np.tile(np.r_[-free, ocp.c_min], N), -free])
        self.high = np.concatenate([np.tile(np.r_[free, ocp.c_max], N), free])
        self.slack = np.zeros(self.equal.size)
        self.slack[~self.equal] = np.tile(np.broadcast_to(ocp.rate_n, m), N if ocp.forces is not None else 0)
        self._rows = rows

    def call(self, solver: ca.Function, w: np.ndarray, x0: np.ndarray, p: np.ndarray, q: np.ndarray) -> Any:
        """`solver` from the guess `w`."""
        low, high, given = self.low.copy(), self.high.copy(), [p.ravel(), q]
        if self._rows:
            given.append(x0)
        else:
            low[: x0.size] = high[: x0.size] = x0
        return solver(x0=w, p=np.concatenate(given), lbx=low, ubx=high, lbg=-self.slack, ubg=self.slack)

    def join(self, x: np.ndarray, c: np.ndarray) -> np.ndarray:
        """(N + 1, nx), (N, nu) -> w."""
        return np.concatenate([np.hstack([x[:-1], c]).ravel(), x[-1]])

    def split(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W -> (N + 1, nx), (N, nu)."""
        n, m = self.ocp.nx, self.ocp.nu
        z = w[:-n].reshape(self.ocp.stages, n + m)
        return np.vstack([z[:, :n], w[-n:]]), z[:, n:]

    def solver(self, name: str, *, expand: bool = False, tolerance: float | None = None) -> ca.Function:
        """ipopt or fatrop, to convergence, from the last solution; their own settings otherwise."""
        options: dict[str, Any] = dict(IPOPT if name == "ipopt" else QUIET)
        if name == "fatrop":
            options |= {"equality": self.equal.tolist(), "structure_detection": "auto", "fatrop.print_level": 0}
        if tolerance is not None:
            options[f"{name}.tol"] = tolerance
        return ca.nlpsol("solver", name, self.problem, options | ({"expand": True} if expand else {}))

    def one_step(self) -> ca.Function:
        """One Gauss-Newton step by CasADi's sqpmethod, the quadratic program by hpipm: what its wheel brings along."""
        ocp = self.ocp
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        rates = 0 if ocp.forces is None else m
        sizes = {"N": N, "nx": [n] * (N + 1), "nu": [m] * N + [0], "ng": [rates] * N + [0]}
        limits = {"inf": HPIPM_INF, "hpipm": {"mode": "balance", "iter_max": 50}}
        options = {
            **QUIET, "expand": True, "max_iter": 1, "hess_lag": self._gauss_newton(), "min_step_size": 0.0,
            "print_header": False, "print_iteration": False, "print_status": False,
            "qpsol": "hpipm", "qpsol_options": {**QUIET, **sizes, **limits},
        }  # fmt: skip
        return ca.nlpsol("solver", "sqpmethod", self.problem, options)

    def _gauss_newton(self) -> ca.Function:
        """(w, p, lam_f, lam_g) -> lam_f times the sum of 2 J^T J, which stands for the Hessian of the Lagrangian."""
        ocp = self.ocp
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        J, J_N = ca.jacobian(ocp.residual, ca.vertcat(ocp.x, ocp.c)), ca.jacobian(ocp.last, ocp.x)
        stage = ca.Function("stage", [ocp.x, ocp.c, ocp.p, ocp.q], [ca.densify(2 * J.T @ J)])
        last = ca.Function("last", [ocp.x, ocp.p, ocp.q], [ca.densify(2 * J_N.T @ J_N)])
        w, given = ca.MX.sym("w", self.low.size), ca.MX.sym("p", self.problem["p"].numel())
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.problem["g"].numel())
        z, x_N = ca.reshape(w[: N * (n + m)], n + m, N), w[N * (n + m) :]
        rows = ca.reshape(given[: (N + 1) * ocp.p.numel()], ocp.p.numel(), N + 1)
        q = given[rows.numel() :]
        blocks = [stage(z[:n, k], z[n:, k], rows[:, k], q) for k in range(N)]
        H = ca.diagcat(*blocks, last(x_N, rows[:, N], q))
        names = ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"]
        return ca.Function("nlp_hess_l", [w, given, lam_f, lam_g], [lam_f * H], *names)
