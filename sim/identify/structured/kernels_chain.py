"""Loops over the nodes of a chain (`chain`), compiled by numba when they first run and kept between runs."""

from __future__ import annotations

import math

import numpy as np

from sim.identify.structured.kernels import add_times, kernel


@kernel
def tie(
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
def _factorised(A: np.ndarray) -> bool:
    """Cholesky's factor in the lower triangle of A (L, L), in place; False where there is none."""
    for j in range(len(A)):
        for m in range(j):
            A[j, j] -= A[j, m] ** 2
        if not A[j, j] > 0.0:  # or NaN
            return False
        A[j, j] = math.sqrt(A[j, j])
        for i in range(j + 1, len(A)):
            for m in range(j):
                A[i, j] -= A[i, m] * A[j, m]
            A[i, j] /= A[j, j]
    return True


@kernel
def eliminate(
    A: np.ndarray, following: np.ndarray, B: np.ndarray, g: np.ndarray, factors: np.ndarray, solved: np.ndarray
) -> int:
    """Cholesky factors (W, L, L) of the nodes in their order and solved (W, L, L + P + 1) = factor^-1 [following B g].

    What comes before is eliminated. Returns the first node whose block is not positive definite, else -1.
    """
    W, L, P = B.shape
    for w in range(W):
        factor, right = factors[w], solved[w]
        factor[:] = A[w]
        right[:, :L] = following[w]
        right[:, L : L + P] = B[w]
        right[:, L + P] = g[w]
        if w > 0:
            before = solved[w - 1]
            for m in range(L):
                for i in range(L):
                    if before[m, i] != 0.0:
                        add_times(-before[m, i], before[m, : i + 1], factor[i, : i + 1])
                        add_times(-before[m, i], before[m, L:], right[i, L:])
        if not _factorised(factor):
            return w
        for i in range(L):
            for m in range(i):
                add_times(-factor[i, m], right[m], right[i])
            right[i] *= 1 / factor[i, i]
    return -1


@kernel
def back(factors: np.ndarray, solved: np.ndarray, given: np.ndarray, dz: np.ndarray) -> None:
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
