"""SX functions of one stage of a problem, shared by the compiled and the interpreted real-time iteration.

With residual r and Jacobian J = dr/d[x c]: Gauss-Newton Hessian H = 2 J' J and gradient g = 2 J' r of |r|^2 (Nocedal &
Wright 2006, 10.3); D = [A B] = dF/d[x c], shape (nx, nx + nu); gap b = F(x, c) - x_next. Sparse matrices are passed as
the list of their varying entries; constant entries stay in the expressions.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from companion.core.control.ocp import Ocp

MOST_QPS = 12
"""Riccati sweeps at most while the active limits change; then the interior-point method. Assumed."""


@dataclass(frozen=True)
class Pattern:
    """`rows`, `columns` of the varying entries of a matrix; `rest`, shape `shape`: constant entries, 0 elsewhere."""

    shape: tuple[int, int]
    rows: np.ndarray
    columns: np.ndarray
    rest: np.ndarray

    @classmethod
    def of(cls, matrix: ca.SX) -> tuple[Pattern, ca.SX]:
        """The pattern, and the varying entries, shape (n,)."""
        sparse = ca.sparsify(matrix)
        rows, columns = (np.array(i, dtype=int) for i in sparse.sparsity().get_triplet())
        entries = [sparse.nz[k] for k in range(sparse.nnz())]
        varies = np.array([not e.is_constant() for e in entries], dtype=bool)
        rest = np.zeros(sparse.shape)
        for k in np.flatnonzero(~varies):
            rest[rows[k], columns[k]] = float(entries[k])
        chosen = [entries[k] for k in np.flatnonzero(varies)]
        return cls(sparse.shape, rows[varies], columns[varies], rest), ca.vertcat(ca.SX(0, 1), *chosen)

    @property
    def count(self) -> int:
        """Number of varying entries."""
        return len(self.rows)

    def filled(self, entries: ca.SX) -> ca.SX:
        """The matrix, sparse, from its varying entries."""
        matrix = ca.sparsify(ca.SX(ca.DM(self.rest)))
        for k in range(self.count):
            matrix[int(self.rows[k]), int(self.columns[k])] = entries[k]
        return matrix


@dataclass(frozen=True)
class StageFunctions:
    """Functions of one stage. `linear`: (x, c, ahead, p, q) -> D, b, H, g; `end`: (x, p, q) -> H, g;
    `look`: (x, c, ahead, p, q) -> gap, cost; `end_cost`: (x, p, q) -> cost. D, H as varying entries.
    """

    ocp: Ocp
    D: Pattern
    H: Pattern
    H_end: Pattern
    linear: ca.Function
    end: ca.Function
    look: ca.Function
    end_cost: ca.Function


def stage_functions(ocp: Ocp) -> StageFunctions:
    """Differentiate one stage of `ocp`."""
    x, c, p, q = ocp.x, ocp.c, ocp.p, ocp.q
    z, ahead = ca.vertcat(x, c), ca.SX.sym("ahead", ocp.nx)
    D, D_entries = Pattern.of(ocp.jacobian)
    J, J_end = ca.jacobian(ocp.residual, z), ca.jacobian(ocp.last, x)
    H, H_entries = Pattern.of(2 * J.T @ J)
    H_end, H_end_entries = Pattern.of(2 * J_end.T @ J_end)
    g, g_end = ca.densify(2 * J.T @ ocp.residual), ca.densify(2 * J_end.T @ ocp.last)
    gap = ca.densify(ocp.following - ahead)
    stage = [x, c, ahead, p, q]
    return StageFunctions(
        ocp, D, H, H_end,
        ca.Function("linear", stage, ca.cse([D_entries, gap, H_entries, g])),
        ca.Function("end", [x, p, q], ca.cse([H_end_entries, g_end])),
        ca.Function("look", stage, ca.cse([gap, ca.sumsqr(ocp.residual)])),
        ca.Function("end_cost", [x, p, q], [ca.sumsqr(ocp.last)]),
    )  # fmt: skip


def accumulated(ocp: Ocp, sums: ca.SX, gap: ca.SX, cost: ca.SX, x: ca.SX, c: ca.SX) -> ca.SX:
    """[cost, largest gap over scale, largest excess over a limit [N], sum of squared gaps], shape (4,), one stage added
    to `sums`.
    """
    gaps = ca.fabs(gap) / ca.DM(ocp.scale)
    excess = ca.fmax(c - ca.DM(ocp.c_max), ca.DM(ocp.c_min) - c)
    if ocp.forces is not None:
        excess = ca.fmax(excess, ca.fabs(c - x[ocp.forces : ocp.forces + ocp.nu]) - ocp.rate)
    return ca.vertcat(
        sums[0] + cost, ca.fmax(sums[1], ca.mmax(gaps)), ca.fmax(sums[2], ca.mmax(excess)), sums[3] + ca.sumsqr(gap)
    )
