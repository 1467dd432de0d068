"""Primal-dual interior-point method for the quadratic program, in SX for one control of one stage.

Each control has limits a_j [dc df]' + s_j = b_j with slack s_j >= 0 and multiplier z_j >= 0 (four, or two where there
is no rate limit):

    c:  +-(c + dc) <= c_max or -c_min          c - f:  +-(c + dc - f - df) <= rate

Newton step on the perturbed optimality conditions s_j z_j = mu, the slacks eliminated:

    H += sum_j w_j a_j' a_j,   g += sum_j t_j a_j,   w_j = z_j / s_j,   t_j = mu / s_j - w_j (b_j - s_j)     `barrier`
    Riccati sweep and roll-out give [dc df]
    s_new = b - a [dc df]',   z_new = (mu - z (s_new - s)) / s                                            `slack_step`

Then s and z move by the fraction-to-the-boundary rule (`STEP_FRACTION`) and mu shrinks (`centring`). Used where the
active-set method cycles, which happens where a force runs at its rate limit into its bound. The number of steps is
bounded. Sources: Wright (1997), Primal-Dual Interior-Point Methods, chapter 5; Rao, Wright, Rawlings (1998).
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

STEP_FRACTION = 0.995
"""Largest share of the step to the boundary s = 0 or z = 0 (Wright 1997, chapter 5)."""
MU_START = 1.0
"""First mu [cost]; costs of a stage are of order 0.01 to 100. Assumed."""
MU_END = 1e-9
"""Mean of s z at which the program counts as solved [cost]; assumed."""
MOST_STEPS = 40
"""Newton steps at most; assumed."""
LEAST_SLACK_N = 0.1
"""Smallest first slack [N]; assumed."""


class BoundPair(NamedTuple):
    """Right-hand side b_j of each limit, and the factors of dc and df in a_j."""

    b: list[ca.SX]
    dc: tuple[int, ...]
    df: tuple[int, ...]


def limits(c: ca.SX, f: ca.SX | None, low: ca.SX, high: ca.SX, rate: float | ca.SX) -> BoundPair:
    """The limits of one control about the guess."""
    bounds = [high - c, c - low]
    if f is None:
        return BoundPair(bounds, (1, -1), (0, 0))
    return BoundPair([*bounds, rate - (c - f), rate + (c - f)], (1, -1, 1, -1), (0, 0, -1, 1))


def initial_slacks(at: BoundPair) -> tuple[ca.SX, ca.SX]:
    """First slacks s = max(b, `LEAST_SLACK_N`) and multipliers z = mu / s."""
    s = ca.vertcat(*(ca.fmax(b, LEAST_SLACK_N) for b in at.b))
    return s, MU_START / s


class Barrier(NamedTuple):
    """Entries that the limits of one control add to the Hessian (cc, ff, cf) and to the gradient (c, f)."""

    cc: ca.SX
    ff: ca.SX
    cf: ca.SX
    c: ca.SX
    f: ca.SX


def barrier(at: BoundPair, s: ca.SX, z: ca.SX, mu: ca.SX) -> Barrier:
    """Sums over the limits j of w_j a_j' a_j and t_j a_j."""
    cc = ff = cf = c = f = ca.SX(0)
    for j, b in enumerate(at.b):
        w = z[j] / s[j]
        t = mu / s[j] - w * (b - s[j])
        cc, ff, cf = cc + w * at.dc[j] ** 2, ff + w * at.df[j] ** 2, cf + w * at.dc[j] * at.df[j]
        c, f = c + t * at.dc[j], f + t * at.df[j]
    return Barrier(cc, ff, cf, c, f)


def slack_step(at: BoundPair, s: ca.SX, z: ca.SX, mu: ca.SX, dc: ca.SX, df: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Newton step (ds, dz) for the roll-out's dc and df."""
    new = ca.vertcat(*(b - at.dc[j] * dc - at.df[j] * df for j, b in enumerate(at.b)))
    ds = new - s
    return ds, (mu - z * ds) / s - z


def step_to_boundary(value: ca.SX, change: ca.SX, share: ca.SX) -> ca.SX:
    """min(share, largest step length along `change` with value >= 0); without the factor `STEP_FRACTION`."""
    for j in range(value.numel()):
        share = ca.fmin(share, ca.if_else(change[j] < 0, -value[j] / change[j], 1e9))
    return share


def centring(share_s: ca.SX, share_z: ca.SX) -> ca.SX:
    """Factor sigma of the next mu, max(0.02, (1 - alpha)^2): the shorter the step length alpha, the larger."""
    return ca.fmax(0.02, (1 - ca.fmin(share_s, share_z)) ** 2)


def active_code(s: ca.SX, z: ca.SX) -> ca.SX:
    """The active limit at the end, z_j > s_j, in the codes of `riccati`."""
    active = [z[j] > s[j] for j in range(s.numel())]
    chosen = ca.if_else(active[0], 1, ca.if_else(active[1], -1, 0))
    if len(active) == 2:
        return chosen
    return ca.if_else(active[2], 2, ca.if_else(active[3], -2, chosen))
