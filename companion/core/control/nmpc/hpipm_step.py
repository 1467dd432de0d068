"""One Gauss-Newton step by hpipm: linearise about w, solve the quadratic program, add dw.

    min 1/2 dw^T H dw + g^T dw   s.t.  g_min <= g(w) + A dw <= g_max,  w_min <= w + dw <= w_max

Linearisation, hpipm and the check of its solution are one CasADi function, called through buffers: arrays are read and
written in place, nothing is allocated. An instance therefore belongs to one thread at a time.

The plugin gives no status when it is called from inside a function. So the optimality conditions are checked:
stationarity |H dw + g + A^T lam_a + lam_x|, and feasibility of the step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from companion.core.control.nmpc.problem import NmpcProblem
from companion.core.control.nmpc.warm_start import LARGEST

INF = 1e4
"""hpipm treats this as an absent bound: large against any step, small enough to keep it well scaled."""
QP_ITERATIONS = 50
"""Interior-point iterations of one quadratic program; 6 to 15 are usual."""
KKT_TOLERANCE = 1e-4
"""Largest residual of a solved quadratic program; gradients are of order 1 to 1e3."""


class Step(NamedTuple):
    """Result of a step: w, residual of the quadratic program, cost and g at w."""

    w: np.ndarray
    kkt: float
    cost: float
    g: np.ndarray

    @property
    def solved(self) -> bool:
        """Every number finite, none of w beyond `LARGEST`, and the quadratic program solved."""
        finite = np.isfinite(self.cost) and np.isfinite(self.g).all() and (np.abs(self.w) <= LARGEST).all()
        return bool(self.kkt <= KKT_TOLERANCE and finite)


def _function(p: NmpcProblem) -> ca.Function:
    """(w, rows, d) -> (w + dw, kkt, cost, g): `NmpcProblem.qp`, hpipm and `NmpcProblem.measure` joined."""
    options: dict[str, Any] = {
        "N": p.stages,
        "nx": [p.nx] * (p.stages + 1),
        "nu": [p.nu] * p.stages + [0],
        "ng": [p.nu] * p.stages + [0],
        "inf": INF,
        "hpipm": {"mode": "balance", "iter_max": QP_ITERATIONS},
        "error_on_fail": False,
    }
    solver = ca.conic("qp", "hpipm", {"h": p.qp.sparsity_out(0), "a": p.qp.sparsity_out(2)}, options)
    w, rows, d = (ca.MX.sym(n, p.qp.sparsity_in(i)) for i, n in enumerate(("w", "rows", "d")))
    H, g, A, rest = p.qp(w, rows, d)
    fixed = ca.MX.zeros(p.nx)
    low = ca.vertcat(fixed, p.w_min[p.nx :] - w[p.nx :])
    high = ca.vertcat(fixed, p.w_max[p.nx :] - w[p.nx :])
    low_g, high_g = p.g_min - rest, p.g_max - rest
    solution = solver(h=H, g=g, a=A, lbx=low, ubx=high, lba=low_g, uba=high_g)
    # the plugin writes all its results: each must be used, else CasADi passes it a null pointer
    dw, lam_a, lam_x = solution["x"], solution["lam_a"], solution["lam_x"]
    dg = ca.mtimes(A, dw)
    residuals = ca.vertcat(
        ca.fabs(ca.mtimes(H, dw) + g + ca.mtimes(A.T, lam_a) + lam_x),
        low - dw,
        dw - high,
        low_g - dg,
        dg - high_g,
    )
    cost, g_next = p.measure(w + dw, rows, d)
    return ca.Function("step", [w, rows, d], [w + dw, ca.mmax(residuals), cost, g_next])


class QpStep:
    """The step of one problem, with its buffers."""

    def __init__(self, problem: NmpcProblem):
        function = _function(problem)
        buffer: tuple[Any, Any] = function.buffer()
        self._buffer, self._call = buffer
        self._in = [np.zeros(function.nnz_in(i)) for i in range(3)]
        self._out = [np.zeros(function.nnz_out(i)) for i in range(4)]
        for i, array in enumerate(self._in):
            self._buffer.set_arg(i, array.data)
        for i, array in enumerate(self._out):
            self._buffer.set_res(i, array.data)

    def __call__(self, w: np.ndarray, rows: np.ndarray, d: np.ndarray) -> Step | None:
        """One full step, or None where the linearisation is not finite.

        The first nx entries of `w` are x0 and stay; `rows` is (N + 1, 8).
        """
        self._in[0][:] = w
        self._in[1][:] = rows.ravel()
        self._in[2][:] = d
        try:
            self._call()
        except RuntimeError:  # CasADi refuses a quadratic program with NaN in it
            return None
        w_next, kkt, cost, g = self._out
        return Step(w_next.copy(), float(kkt[0]), float(cost[0]), g.copy())
