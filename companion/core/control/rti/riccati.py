"""One stage of the quadratic program, in SX: Riccati step, and roll-out with the choice of active limits.

In deviations from the guess, with [x c 1] for columns,

    min sum 1/2 [dx dc 1] [H g; g' .] [dx dc 1]'   s.t.  dx+ = A dx + B dc + b,  limits on dc

    Q = [H g] + [A B]' (P [A B b] + [0 p])              cost-to-go before the choice of dc
    dc_i = gamma_i df_i + alpha_i                       where limit i is active: c_i at a bound, or f_i off by the rate
    K: dc = K [dx 1], the minimum over those that are free;  W = Q_c [1 K] = gradient there: nil where free
    P = Q_xx + Q_xc K + K' W                            symmetric, positive semidefinite

A primal-dual active-set method chooses the limits: after the roll-out a free control beyond a limit is put on it,
an active one whose gradient pulls inwards is let go; where nothing changes the program is solved exactly. Codes of
`active`: 0 free, +-1 at a bound, +-2 at the rate limit. Every expression is written for any number of columns: the
compiled kernel takes them as lanes, the interpreter all at once.
Sources: Rawlings, Mayne, Diehl (2017), 8.8; Hintermueller, Ito, Kunisch (2002), SIAM J. Optim. 13(3).
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from companion.core.control.ocp import Ocp

ACTIVATE_N = 1e-9
"""[N] beyond a limit that makes it active."""
RELEASE = 1e-9
"""Gradient inwards [1/N] that lets an active limit go."""


def state_control_cost(P: ca.SX, p: ca.SX, D: ca.SX, columns: ca.SX, one: ca.SX, h: ca.SX) -> ca.SX:
    """Q, shape (nx + nu, columns), of columns [A B b], [H g], and `one` = [0 .. 0 1]."""
    return h + D.T @ (P @ columns + p @ one)


class ActiveLaw(NamedTuple):
    """Which controls are active, and their law: each shape (nu, 1)."""

    active: ca.SX
    gamma: ca.SX
    alpha: ca.SX


def active_law(ocp: Ocp, code: ca.SX, x: ca.SX, c: ca.SX) -> ActiveLaw:
    """The law of each active control, from its code and the guess."""
    up, rate = code > 0, ca.fabs(code) > 1.5
    alpha = ca.if_else(up, ca.DM(ocp.c_max), ca.DM(ocp.c_min)) - c
    if ocp.forces is None:
        return ActiveLaw(code != 0, ca.SX.zeros(ocp.nu), alpha)
    f = x[ocp.forces : ocp.forces + ocp.nu]
    off = f + ca.if_else(up, ocp.rate_n, -ocp.rate_n) - c
    return ActiveLaw(code != 0, rate, ca.if_else(rate, off, alpha))


def factor(Q_cc: ca.SX, active: ca.SX) -> tuple[list[list[ca.SX]], list[ca.SX]]:
    """Cholesky factor of Q_cc with rows and columns of active controls replaced by the unit's; 1 / its diagonal."""
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
    """K and W, shapes (nu, columns), from rows c of Q. `force` (nu, columns): 1 at the column of f_i."""
    n = Q_cc.shape[0]
    K = [law.active[i] * (law.gamma[i] * force[i, :] + law.alpha[i] * one) for i in range(n)]
    K_held = ca.vertcat(*K)
    right = Q_c + Q_cc @ K_held
    z: list[ca.SX] = []
    for i in range(n):
        z.append(((1 - law.active[i]) * right[i, :] - sum(L[i][t] * z[t] for t in range(i))) * inverse[i])
    for i in reversed(range(n)):
        z[i] = (z[i] - sum(L[t][i] * z[t] for t in range(i + 1, n))) * inverse[i]
    K_all = K_held - ca.vertcat(*z)
    return K_all, Q_c + Q_cc @ K_all


def previous_cost_to_go(Q_x: ca.SX, Q_cx: ca.SX, K_x: ca.SX, K: ca.SX, W: ca.SX) -> ca.SX:
    """P (and p, in the last column) of the stage before, shape (nx, columns)."""
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
    """Apply dc = K [dx 1] and look which limits ought to be active. K, W: (nu, nx + 1)."""
    at = ca.vertcat(dx, 1)
    dc = K @ at
    pull = W @ at
    new = c + dc
    low, high = ca.SX(ca.DM(ocp.c_min)), ca.SX(ca.DM(ocp.c_max))
    low_code, high_code = -ca.SX.ones(ocp.nu), ca.SX.ones(ocp.nu)
    if ocp.forces is not None:
        span = slice(ocp.forces, ocp.forces + ocp.nu)
        f = x[span] + dx[span]
        low_code = ca.if_else(f - ocp.rate_n > low, -2, -1)
        high_code = ca.if_else(f + ocp.rate_n < high, 2, 1)
        low, high = ca.fmax(low, f - ocp.rate_n), ca.fmin(high, f + ocp.rate_n)
    over, under = new > high + ACTIVATE_N, new < low - ACTIVATE_N
    let_go = ca.logic_or(ca.logic_and(code > 0, pull > RELEASE), ca.logic_and(code < 0, pull < -RELEASE))
    chosen = ca.if_else(over, high_code, ca.if_else(under, low_code, ca.if_else(let_go, 0, code)))
    for i in np.flatnonzero(ocp.c_min >= ocp.c_max):
        chosen[int(i)] = 1
    return RollOutStage(dc, ca.vertcat(D @ ca.vertcat(dx, dc) + b), chosen, ca.sum1(chosen != code))
