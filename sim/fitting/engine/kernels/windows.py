"""Loops over windows, steps and columns, compiled by numba at their first call and cached.

They compute the same sums as array expressions would, without temporaries, so that the data of a window stays in the
cache of a core. Innermost loops go along columns, which lie next to each other in memory.

Sizes: W windows of K steps; C columns of the sensitivities S = dx/d[x0, d, q], the first X0_D of the window's node, the
other P of the parameters that move the boat.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

kernel = njit(cache=True, fastmath={"contract"})  # a * b + c may be one instruction; no other fast-math rule
X0_D = 9
"""Columns of S that belong to the node: state (6) and latent acceleration (3)."""
EARLY, LATE, MIDDLE = (1 / 2, 1 / 3, 1 / 8), (1 / 2, 1 / 6, 1 / 24), (2 / 3, 1 / 3, 0.0)
"""Weights of h, h^2 A, h^3 A^2 in the integral of exp(A (h - s)) a(s) over a step, to third order in h.

EARLY, LATE: of a at the start and at the end of the step, linear between; MIDDLE: of the bump, the parabola that a has
in the middle beyond the mean of both ends.
"""


@kernel
def _combined(weights: np.ndarray, i: int, rows: np.ndarray, out: np.ndarray, o: int) -> None:
    """out[o] (C,) = weights[i] (6,) times rows (6 or more, C)."""
    w0, w1, w2, w3, w4, w5 = weights[i, 0], weights[i, 1], weights[i, 2], weights[i, 3], weights[i, 4], weights[i, 5]
    for c in range(out.shape[1]):
        out[o, c] = (
            w0 * rows[0, c] + w1 * rows[1, c] + w2 * rows[2, c] + w3 * rows[3, c] + w4 * rows[4, c] + w5 * rows[5, c]
        )


@kernel
def add_times(value: float, row: np.ndarray, out: np.ndarray) -> None:
    """out (C,) += value times row (C,)."""
    for c in range(len(out)):
        out[c] += value * row[c]


@kernel
def _weights(
    hA: np.ndarray, h: float, powers: np.ndarray, Phi: np.ndarray, early: np.ndarray, late: np.ndarray, mid: np.ndarray
) -> None:
    """Transition Phi = exp(hA) of a step, to third order, and weights (6, 3) of the accelerations a (`EARLY` ..).

    hA (6, 6): h d(x_dot)/dx. `powers` (2, 6, 6): workspace for the square and the cube of hA.
    """
    square, cube = powers[0], powers[1]
    for i in range(6):
        _combined(hA, i, hA, square, i)
    for i in range(6):
        _combined(square, i, hA, cube, i)
    for i in range(6):
        for j in range(6):
            Phi[i, j] = hA[i, j] + square[i, j] / 2 + cube[i, j] / 6
        Phi[i, i] += 1.0
        for j in range(3):
            first, second = h * hA[i, 3 + j], h * square[i, 3 + j]
            early[i, j] = EARLY[1] * first + EARLY[2] * second
            late[i, j] = LATE[1] * first + LATE[2] * second
            mid[i, j] = MIDDLE[1] * first + MIDDLE[2] * second
        if i >= 3:
            early[i, i - 3] += h * EARLY[0]
            late[i, i - 3] += h * LATE[0]
            mid[i, i - 3] += h * MIDDLE[0]


@kernel
def _mean_rate(A: np.ndarray, w: int, k: int, h: float, hA: np.ndarray) -> None:
    """hA (6, 6) = h times the mean of A at both ends of step k."""
    for i in range(6):
        for j in range(6):
            hA[i, j] = h * (A[w, k, i, j] + A[w, k + 1, i, j]) / 2


@kernel
def _moved(S: np.ndarray, A: np.ndarray, a: np.ndarray, w: int, k: int, moved: np.ndarray) -> None:
    """Fill `moved` (9, C) with d[x; nu_dot]/d[x0, d, q] at step k of window w: S, and A S + d(nu_dot)/d[x0, d, q]."""
    C = S.shape[3]
    for i in range(6):
        for c in range(C):
            moved[i, c] = S[w, k, i, c]
    by_state = A[w, k]
    for i in range(3):
        _combined(by_state, 3 + i, moved, moved, 6 + i)
        moved[6 + i, 6 + i] += 1.0
        for c in range(C - X0_D):
            moved[6 + i, X0_D + c] += a[w, k, i, c]


@kernel
def propagate_sensitivities(
    A: np.ndarray, a: np.ndarray, bump: np.ndarray, bumped: np.ndarray, h: np.ndarray, S: np.ndarray
) -> None:
    """Fill the sensitivities S (W, K+1, 6, C) by the variational equation, from [I 0] at each node.

        S_dot = A S + [0; a]
        S_{k+1} = Phi_k S_k + integral of exp(A (h - s)) [0; a(s)] ds over the step,   Phi = exp(h A)

    A     (W, K+1, 6, 6) d(x_dot)/dx; over a step the mean of both ends counts
    a     (W, K+1, 3, P) d(nu_dot)/dq at the steps; that by the latent acceleration d is 1
    bump  (W, K, 3, B) a in the middle of steps beyond the mean of both ends, for the parameters `bumped` (B,)
    h     (W, K) step lengths [s]
    """
    W, K = h.shape
    hA, Phi, powers = np.empty((6, 6)), np.empty((6, 6)), np.empty((2, 6, 6))
    early, late, middle = np.empty((6, 3)), np.empty((6, 3)), np.empty((6, 3))
    C = S.shape[3]
    now, after = np.empty((6, C)), np.empty((6, C))
    for w in range(W):
        now[:] = 0.0
        for i in range(6):
            now[i, i] = 1.0
        S[w, 0] = now
        for k in range(K):
            # 1. Transition and weights of the step.
            _mean_rate(A, w, k, h[w, k], hA)
            _weights(hA, h[w, k], powers, Phi, early, late, middle)
            for i in range(6):
                # 2. after = Phi now
                p0, p1, p2, p3, p4, p5 = Phi[i, 0], Phi[i, 1], Phi[i, 2], Phi[i, 3], Phi[i, 4], Phi[i, 5]
                for c in range(C):
                    after[i, c] = (
                        p0 * now[0, c]
                        + p1 * now[1, c]
                        + p2 * now[2, c]
                        + p3 * now[3, c]
                        + p4 * now[4, c]
                        + p5 * now[5, c]
                    )
                # 3. + the integral: latent acceleration (a = 1), parameters, bumps
                for j in range(3):
                    after[i, 6 + j] += early[i, j] + late[i, j]
                e0, e1, e2, l0, l1, l2 = early[i, 0], early[i, 1], early[i, 2], late[i, 0], late[i, 1], late[i, 2]
                for c in range(C - X0_D):
                    after[i, X0_D + c] += (
                        e0 * a[w, k, 0, c] + e1 * a[w, k, 1, c] + e2 * a[w, k, 2, c]
                        + l0 * a[w, k + 1, 0, c] + l1 * a[w, k + 1, 1, c] + l2 * a[w, k + 1, 2, c]
                    )  # fmt: skip
                for b in range(len(bumped)):
                    for j in range(3):
                        after[i, X0_D + bumped[b]] += middle[i, j] * bump[w, k, j, b]
            for i in range(6):
                for c in range(C):
                    now[i, c] = S[w, k + 1, i, c] = after[i, c]


@kernel
def fill_imu_rows(
    S: np.ndarray,
    A: np.ndarray,
    a: np.ndarray,
    slopes: np.ndarray,
    direct: np.ndarray,
    scale: np.ndarray,
    place: np.ndarray,
    J: np.ndarray,
) -> None:
    """Fill the columns `place` (C,) of J (W, K, 4, ..): derivatives of psi, r, a_x, a_y, times `scale` (W, K, 4).

    slopes  (W, K, 4, 9) partial derivatives of the four by x y psi u v r u_dot v_dot r_dot
    direct  (W, K, 4, P) direct partial derivatives by the parameters; or (W, K, 4, 0): there are none
    S, A and a as of `propagate_sensitivities`. Rows whose scale is 0 stay as they are.
    """
    W, K = scale.shape[:2]
    C, extra = S.shape[3], direct.shape[3] > 0
    moved, row = np.empty((9, C)), np.empty(C)
    for w in range(W):
        for k in range(K):
            _moved(S, A, a, w, k, moved)
            for channel in range(4):
                weight = scale[w, k, channel]
                if weight == 0.0:
                    continue
                row[:] = 0.0
                for i in range(9):
                    slope = slopes[w, k, channel, i]
                    if slope != 0.0:
                        for c in range(C):
                            row[c] += slope * moved[i, c]
                if extra:
                    add_times(1.0, direct[w, k, channel], row[X0_D:])
                for c in range(C):
                    J[w, k, channel, place[c]] = weight * row[c]


@kernel
def whiten_rows(
    J: np.ndarray, channel: int, known: np.ndarray, h: np.ndarray, white: float, wander: float, wander_time_s: float
) -> None:
    """Turn heading rows J[:, :, channel] of J (W, K, n, C), in place, into innovations of unit variance.

    Scalar Kalman filter of the wander m, variance P, which is 0 at the node (the node's own wander is an unknown):

        S = P + white^2,   gain = P / S,   innovation = row - m,   out = innovation / sqrt(S)
        m <- decay (m + gain innovation),   P <- decay^2 P (1 - gain) + wander^2 (1 - decay^2)

    Where nothing was measured (`known`, (W, K)) the gain and the row are 0. See `noise.whiten`.
    """
    W, K, _, C = J.shape
    m = np.empty(C)
    for w in range(W):
        P = 0.0
        m[:] = 0.0
        for k in range(K):
            row, S, decay = J[w, k, channel], P + white**2, math.exp(-h[w, k] / wander_time_s)
            gain = P / S if known[w, k] else 0.0
            per_sigma = 1 / math.sqrt(S) if known[w, k] else 0.0
            for c in range(C):
                innovation = row[c] - m[c]
                row[c] = innovation * per_sigma
                m[c] = decay * (m[c] + gain * innovation)
            P = decay**2 * P * (1 - gain) + wander**2 * (1 - decay**2)


@kernel
def fill_fix_rows(
    S: np.ndarray,
    window: np.ndarray,
    index: np.ndarray,
    slopes: np.ndarray,
    direct: np.ndarray,
    scale: np.ndarray,
    place: np.ndarray,
    J: np.ndarray,
) -> None:
    """Fill the columns `place` of J (m, 2, ..): derivatives of positions (north, east), times `scale` (m,).

    window, index  (m,) window and step of S at or before each sample
    slopes         (m, 2, 6) partial derivatives by the state there
    direct         (m, 2, P) direct partial derivatives by the parameters; or (m, 2, 0): there are none
    """
    C = S.shape[3]
    rows = np.empty((2, C))
    for i in range(len(window)):
        for axis in range(2):
            _combined(slopes[i], axis, S[window[i], index[i]], rows, axis)
            if direct.shape[2]:
                add_times(1.0, direct[i, axis], rows[axis, X0_D:])
            for c in range(C):
                J[i, axis, place[c]] = scale[i] * rows[axis, c]


@kernel
def add_normal_equations(
    J: np.ndarray, residual: np.ndarray, window: np.ndarray, A: np.ndarray, B: np.ndarray, g: np.ndarray
) -> None:
    """Add J^T J and J^T r of rows J (n, L + P), residual (n,), to the blocks A (W, L, L), B (W, L, P), g (W, L).

    `window` (n,): window of each row.
    """
    L = A.shape[1]
    for i in range(len(J)):
        w, row = window[i], J[i]
        for m in range(L):
            value = row[m]
            if value != 0.0:
                g[w, m] += value * residual[i]
                add_times(value, row[:L], A[w, m])
                add_times(value, row[L:], B[w, m])


@kernel
def transposed_into(columns: np.ndarray, out: np.ndarray) -> None:
    """out (n, P) = transpose of columns (P, n)."""
    P, n = columns.shape
    for i in range(n):
        for p in range(P):
            out[i, p] = columns[p, i]
