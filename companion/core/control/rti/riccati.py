"""One stage of the quadratic program in SX: the Riccati step, and the roll-out that chooses the active limits.

Notation, in deviations dx (n,), dc (m,) from the guess (x, c), with columns [x c 1]:

    min  sum_k 1/2 [dx; dc]' H [dx; dc] + g' [dx; dc]    s.t.  dx+ = A dx + B dc + b,  D = [A B],  limits on dc

Riccati recursion backwards, V(dx) = 1/2 dx' P dx + p' dx being the cost-to-go of the next stage:

    Q = [H g] + D' (P [A B b] + [0 p])      cost of [dx; dc] at this stage before the choice of dc
    dc_i = gamma_i df_i + alpha_i           active i: c_i at a bound (gamma = 0) or c_i - f_i at the rate limit (1)
    Q_cc,FF K_F = -(Q_c,F + Q_cc,FA K_A)    free controls F: the minimum; A: the active ones; Q_c = [Q_cx q_c]
    W = Q_c + Q_cc K                        gradient with respect to dc, zero for free controls
    P = Q_xx + Q_xc K + K' W                symmetric, positive semidefinite; p is its last column

Primal-dual active-set method: after the roll-out a free control beyond a limit becomes active there, and an active one
whose multiplier has the wrong sign (gradient pointing inwards) becomes free. When no code changes, the quadratic
program is solved exactly. Codes of `active`: 0 free, +-1 upper or lower bound, +-2 upper or lower rate limit.

All expressions hold for any number of columns: the compiled kernels take columns as lanes, the interpreter takes all
at once. Sources: Rawlings, Mayne, Diehl (2017), 8.8; Hintermueller, Ito, Kunisch (2002), SIAM J. Optim. 13(3).
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from companion.core.control.ocp import Ocp

ACTIVATE_N = 1e-9
"""A free control becomes active where it exceeds a limit by more than this [N]; rounding, assumed."""
RELEASE = 1e-9
"""An active control becomes free where its gradient points inwards by more than this [1/N]; rounding, assumed."""


def state_control_cost(P: ca.SX, p: ca.SX, D: ca.SX, columns: ca.SX, one: ca.SX, h: ca.SX) -> ca.SX:
    """Q = h + D' (P columns + p one), shape (nx + nu, k).

    `columns`, `h`, `one`: the same k columns of [A B b], [H g] and [0 .. 0 1].
    """
    return h + D.T @ (P @ columns + p @ one)


class ActiveLaw(NamedTuple):
    """Which controls are active (1 or 0), and their law dc = gamma df + alpha: each shape (nu, 1)."""

    active: ca.SX
    gamma: ca.SX
    alpha: ca.SX


def active_law(ocp: Ocp, code: ca.SX, x: ca.SX, c: ca.SX) -> ActiveLaw:
    """The law of the active controls, from codes, state and controls of the guess."""
    up, rate = code > 0, ca.fabs(code) > 1.5
    alpha = ca.if_else(up, ca.DM(ocp.c_max), ca.DM(ocp.c_min)) - c
    if ocp.forces is None:
        return ActiveLaw(code != 0, ca.SX.zeros(ocp.nu), alpha)
    f = x[ocp.forces : ocp.forces + ocp.nu]
    off = f + ca.if_else(up, ocp.rate, -ocp.rate) - c
    return ActiveLaw(code != 0, rate, ca.if_else(rate, off, alpha))


def factor(Q_cc: ca.SX, active: ca.SX) -> tuple[list[list[ca.SX]], list[ca.SX]]:
    """Cholesky factor L of Q_cc, rows and columns of active controls replaced by those of the identity.

    Returns the rows below the diagonal, and 1 / L_ii.
    """
    n = Q_cc.shape[0]
    free = 1 - active
    L: list[list[ca.SX]] = []
    inverse: list[ca.SX] = []
    for i in range(n):
        row: list[ca.SX] = []
        for j in range(i):
            row.append((free[i] * free[j] * Q_cc[i, j] - sum(row[t] * L[j][t] for t in range(j))) * inverse[j])
        diagonal = free[i] * Q_cc[i, i] + active[i] - sum(e * e for e in row)
        inverse.append(1 / ca.sqrt(diagonal))
        L.append(row)
    return L, inverse


def gains(
    Q_c: ca.SX, Q_cc: ca.SX, law: ActiveLaw, L: list[list[ca.SX]], inverse: list[ca.SX], force: ca.SX, one: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """K and W, shapes (nu, k), from k columns of the rows c of Q. `force` (nu, k): 1 at the column of f_i."""
    n = Q_cc.shape[0]
    # 1. rows of the active controls: K_A = gamma df + alpha; zero for the free ones
    K = [law.active[i] * (law.gamma[i] * force[i, :] + law.alpha[i] * one) for i in range(n)]
    K_active = ca.vertcat(*K)
    right = Q_c + Q_cc @ K_active
    # 2. free controls: L L' z = right by forward and backward substitution
    z: list[ca.SX] = []
    for i in range(n):
        z.append(((1 - law.active[i]) * right[i, :] - sum(L[i][t] * z[t] for t in range(i))) * inverse[i])
    for i in reversed(range(n)):
        z[i] = (z[i] - sum(L[t][i] * z[t] for t in range(i + 1, n))) * inverse[i]
    # 3. K, and the gradient W = Q_c + Q_cc K
    K_all = K_active - ca.vertcat(*z)
    return K_all, Q_c + Q_cc @ K_all


def previous_cost_to_go(Q_x: ca.SX, Q_cx: ca.SX, K_x: ca.SX, K: ca.SX, W: ca.SX) -> ca.SX:
    """[P p] of this stage, shape (nx, k): Q_x + Q_xc K + K_x' W."""
    return Q_x + Q_cx.T @ K + K_x.T @ W


class RollOutStage(NamedTuple):
    """One stage of the roll-out: dc (nu,), dx of the next stage (nx,), new codes (nu,), how many codes changed."""

    dc: ca.SX
    following: ca.SX
    code: ca.SX
    changed: ca.SX


def roll_out_stage(
    ocp: Ocp, dx: ca.SX, K: ca.SX, W: ca.SX, D: ca.SX, b: ca.SX, x: ca.SX, c: ca.SX, code: ca.SX
) -> RollOutStage:
    """Apply dc = K [dx; 1], and choose the active limits by primal feasibility and sign of the multiplier.

    K, W: (nu, nx + 1); D (nx, nx + nu), b (nx,); x, c: the guess; code (nu,): limits active so far.
    """
    # 1. control, and its gradient
    dx_one = ca.vertcat(dx, 1)
    dc = K @ dx_one
    gradient = W @ dx_one
    new = c + dc
    # 2. the nearer of bound and rate limit on each side, and its code
    low, high = ca.SX(ca.DM(ocp.c_min)), ca.SX(ca.DM(ocp.c_max))
    low_code, high_code = -ca.SX.ones(ocp.nu), ca.SX.ones(ocp.nu)
    if ocp.forces is not None:
        span = slice(ocp.forces, ocp.forces + ocp.nu)
        f = x[span] + dx[span]
        low_code = ca.if_else(f - ocp.rate > low, -2, -1)
        high_code = ca.if_else(f + ocp.rate < high, 2, 1)
        low, high = ca.fmax(low, f - ocp.rate), ca.fmin(high, f + ocp.rate)
    # 3. primal-dual active set
    over, under = new > high + ACTIVATE_N, new < low - ACTIVATE_N
    release = ca.logic_or(ca.logic_and(code > 0, gradient > RELEASE), ca.logic_and(code < 0, gradient < -RELEASE))
    chosen = ca.if_else(over, high_code, ca.if_else(under, low_code, ca.if_else(release, 0, code)))
    for i in np.flatnonzero(ocp.c_min >= ocp.c_max):
        chosen[int(i)] = 1  # a dead thruster: always at its bound
    return RollOutStage(dc, ca.vertcat(D @ ca.vertcat(dx, dc) + b), chosen, ca.sum1(chosen != code))
