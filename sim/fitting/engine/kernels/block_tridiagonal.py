"""Loops over the nodes of a chain (`chain`), compiled by numba when they first run and kept between runs."""

from __future__ import annotations

import math

import numpy as np

from sim.fitting.engine.kernels.windows import add_times, kernel


@kernel
def add_ties(
    at: np.ndarray, F: np.ndarray, G: np.ndarray, rho: np.ndarray, each: np.ndarray,
    A: np.ndarray, following: np.ndarray, B: np.ndarray, g: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Add ties from nodes `at` (T,) to the next to the blocks A, following, B, g of all nodes.

    F (T, L, L), G (T, k, P) of the first k of L, rho (T, L); each (T, L): one over sigma. Returns the rows of G over
    their sigma, with rho over sigma behind them, (T k, P + 1).
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
    """Cholesky's factor (L, L), its lower triangle, of the first L columns of rows, which are used up for it.

    False where there is none.
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
    """Cholesky factors (W, L, L) of the nodes in their order and solved (W, L, L + P + 1) = factor^-1 [following B g].

    What comes before is eliminated. Returns the first node whose block is not positive definite, else -1. Loops along
    columns stand here in full: of few columns, `add_times` costs more than the sums.
    """
    W, L, P = B.shape
    columns = L + P + 1
    rows = np.empty((L, columns))  # [A B g]
    for w in range(W):
        factor, right = factors[w], solved[w]
        rows[:, :L] = A[w]
        rows[:, L : L + P] = B[w]
        rows[:, L + P] = g[w]
        if w > 0:
            before = solved[w - 1]
            for m in range(L):
                for i in range(L):
                    value = before[m, i]
                    if value != 0.0:
                        for c in range(columns):
                            rows[i, c] -= value * before[m, c]
        right[:, :L] = following[w]
        right[:, L:] = rows[:, L:]
        if not _factorised(rows, factor):
            return w
        for i in range(L):
            for m in range(i):
                value = factor[i, m]
                for c in range(columns):
                    right[i, c] -= value * right[m, c]
            right[i] *= 1 / factor[i, i]
    return -1


@kernel
def back_substitute(factors: np.ndarray, solved: np.ndarray, given: np.ndarray, dz: np.ndarray) -> None:
    """Steps dz (W, L) from the last node to the first: factor^T dz_w = -given_w - solved_w[:, :L] dz_{w+1}."""
    W, L = dz.shape
    for w in range(W - 1, -1, -1):
        for i in range(L):
            dz[w, i] = -given[w, i]
            if w + 1 < W:
                for j in range(L):
                    dz[w, i] -= solved[w, i, j] * dz[w + 1, j]
        for i in range(L - 1, -1, -1):
            for j in range(i + 1, L):
                dz[w, i] -= factors[w, j, i] * dz[w, j]
            dz[w, i] /= factors[w, i, i]
