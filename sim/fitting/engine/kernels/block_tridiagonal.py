"""Loops over the nodes of a chain (`engine.block_tridiagonal`), compiled by numba at their first call and cached.

Blocks as there: A (W, L, L), `following` = N (W, L, L), B (W, L, P), gradient g (W, L).
"""

from __future__ import annotations

import math

import numpy as np

from sim.fitting.engine.kernels.windows import add_times, kernel


@kernel
def add_ties(
    at: np.ndarray, F: np.ndarray, G: np.ndarray, rho: np.ndarray, each: np.ndarray,
    A: np.ndarray, following: np.ndarray, B: np.ndarray, g: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Add the continuity conditions from nodes `at` (T,) to the next to the blocks A, following, B, g.

        1/2 |rho + dz_{w+1} - F dz_w - G dw|^2_{Q^-1},   Q = diag(sigma^2)

    F (T, L, L), G (T, k, P) of the first k of L entries, rho (T, L); `each` (T, L): 1 / sigma. Entries of F that are 0
    are passed over. Returns the rows [G rho] / sigma, (T k, P + 1), from which the parameters' own blocks follow.
    """
    T, k, P = G.shape
    L = F.shape[1]
    border = np.empty((T * k, P + 1))
    for t in range(T):
        w = at[t]
        for i in range(L):
            weight = each[t, i] ** 2
            A[w + 1, i, i] += weight
            g[w + 1, i] += weight * rho[t, i]
            if i < k:
                border[t * k + i, :P] = each[t, i] * G[t, i]
                border[t * k + i, P] = each[t, i] * rho[t, i]
                add_times(-weight, G[t, i], B[w + 1, i])
            for j in range(L):
                value = weight * F[t, i, j]
                if value != 0.0:
                    following[w, j, i] -= value
                    g[w, j] -= value * rho[t, i]
                    add_times(value, F[t, i], A[w, j])
                    if i < k:
                        add_times(value, G[t, i], B[w, j])
    return border


@kernel
def _factorised(rows: np.ndarray, factor: np.ndarray) -> bool:
    """Write the Cholesky factor of the first L columns of `rows` (L, ..) into the lower triangle of `factor` (L, L).

    The columns are overwritten. False where the matrix is not positive definite.
    """
    L = len(factor)
    column = np.empty(L)
    for j in range(L):
        if not rows[j, j] > 0.0:  # or NaN
            return False
        root = math.sqrt(rows[j, j])
        for i in range(j + 1, L):
            column[i] = factor[i, j] = rows[i, j] / root
        factor[j, j] = root
        for i in range(j + 1, L):
            value = column[i]
            for c in range(j + 1, L):  # beyond the triangle too: whole rows are quicker
                rows[i, c] -= value * column[c]
    return True


@kernel
def eliminate(
    A: np.ndarray, following: np.ndarray, B: np.ndarray, g: np.ndarray, factors: np.ndarray, solved: np.ndarray
) -> int:
    """Block Cholesky factorisation of the nodes, first to last, with forward substitution of the border.

        C_w C_w^T = A_w - X_{w-1}^T X_{w-1}
        [X_w Y_w y_w] = C_w^-1 [N_w  B_w - X_{w-1}^T Y_{w-1}  g_w - X_{w-1}^T y_{w-1}]

    Fills `factors` (W, L, L) with C and `solved` (W, L, L + P + 1) with [X Y y]. Returns the index of the first node
    whose block is not positive definite, else -1. Loops along columns are written out: for a few columns a call of
    `add_times` costs more than the sums.
    """
    W, L, P = B.shape
    columns = L + P + 1
    rows = np.empty((L, columns))  # [A B g]
    for w in range(W):
        factor, right = factors[w], solved[w]
        rows[:, :L] = A[w]
        rows[:, L : L + P] = B[w]
        rows[:, L + P] = g[w]
        if w > 0:  # 1. subtract what the node before explains
            before = solved[w - 1]
            for m in range(L):
                for i in range(L):
                    value = before[m, i]
                    if value != 0.0:
                        for c in range(columns):
                            rows[i, c] -= value * before[m, c]
        right[:, :L] = following[w]
        right[:, L:] = rows[:, L:]
        if not _factorised(rows, factor):  # 2. factorise
            return w
        for i in range(L):  # 3. forward substitution
            for m in range(i):
                value = factor[i, m]
                for c in range(columns):
                    right[i, c] -= value * right[m, c]
            right[i] *= 1 / factor[i, i]
    return -1


@kernel
def back_substitute(factors: np.ndarray, solved: np.ndarray, right: np.ndarray, dz: np.ndarray) -> None:
    """Fill dz (W, L), last node to first: C_w^T dz_w = -right_w - X_w dz_{w+1}, with C and X of `eliminate`."""
    W, L = dz.shape
    for w in range(W - 1, -1, -1):
        for i in range(L):
            dz[w, i] = -right[w, i]
            if w + 1 < W:
                for j in range(L):
                    dz[w, i] -= solved[w, i, j] * dz[w + 1, j]
        for i in range(L - 1, -1, -1):
            for j in range(i + 1, L):
                dz[w, i] -= factors[w, j, i] * dz[w, j]
            dz[w, i] /= factors[w, i, i]
