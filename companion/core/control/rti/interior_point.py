"""The interior-point method for the quadratic program of one stage, one control at a time, in SX.

For each control four limits a_j . [dc df] <= b_j (two where there is no rate limit), slacks s, multipliers z:

    c: +-(c + dc) <= +-c_max or min        c - f: +-(c + dc - f - df) <= rate

Each Newton step is one Riccati sweep with the weights w = z / s on the limits and the gradient
t = mu / s - w (b - s) added (`barrier`); the roll-out gives s_new = b - a . d, and
z_new = (mu - z (s_new - s)) / s. Steps keep 0.5 % away from the wall. It is used where
the active-set method goes round in circles, which it does where a force runs at its rate limit into its bound; its
number of steps is bounded.
Source: Wright (1997), Primal-Dual Interior-Point Methods, chapter 5; Rao, Wright, Rawlings (1998).
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

STEP_FRACTION = 0.995
"""Share of the way to the nearest limit that a step may take."""
MU_START = 1.0
"""mu to begin with [cost]; costs of a stage are of order 0.01 to 100."""
MU_END = 1e-9
"""Mean of s z that counts as solved [cost]."""
MOST_STEPS = 40
"""At most."""
LEAST_SLACK_N = 0.1
"""[N] that a slack begins with at least."""


class BoundPair(NamedTuple):
    """b of each limit, and the signs of dc and df in it."""

    b: list[ca.SX]
    dc: tuple[int, ...]
    df: tuple[int, ...]


def limits(c: ca.SX, f: ca.SX | None, low: ca.SX, high: ca.SX, rate: float) -> BoundPair:
    """The limits of one control about the guess."""
    bounds = [high - c, c - low]
    if f is None:
        return BoundPair(bounds, (1, -1), (0, 0))
    return BoundPair([*bounds, rate - (c - f), rate + (c - f)], (1, -1, 1, -1), (0, 0, -1, 1))


def initial_slacks(at: BoundPair) -> tuple[ca.SX, ca.SX]:
    """Slacks and multipliers to begin with."""
    s = ca.vertcat(*(ca.fmax(b, LEAST_SLACK_N) for b in at.b))
    return s, MU_START / s


class Barrier(NamedTuple):
    """What one control adds to the Hessian (cc, ff, cf) and to the gradient (c, f)."""

    cc: ca.SX
    ff: ca.SX
    cf: ca.SX
    c: ca.SX
    f: ca.SX


def barrier(at: BoundPair, s: ca.SX, z: ca.SX, mu: ca.SX) -> Barrier:
    """Weights and gradient of the limits."""
    cc = ff = cf = c = f = ca.SX(0)
    for j, b in enumerate(at.b):
        w = z[j] / s[j]
        t = mu / s[j] - w * (b - s[j])
        cc, ff, cf = cc + w * at.dc[j] ** 2, ff + w * at.df[j] ** 2, cf + w * at.dc[j] * at.df[j]
        c, f = c + t * at.dc[j], f + t * at.df[j]
    return Barrier(cc, ff, cf, c, f)


def slack_step(at: BoundPair, s: ca.SX, z: ca.SX, mu: ca.SX, dc: ca.SX, df: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Changes of s and z that belong to the roll-out's dc and df."""
    new = ca.vertcat(*(b - at.dc[j] * dc - at.df[j] * df for j, b in enumerate(at.b)))
    ds = new - s
    return ds, (mu - z * ds) / s - z


def step_to_boundary(value: ca.SX, change: ca.SX, share: ca.SX) -> ca.SX:
    """The smaller of `share` and the largest step that keeps every value positive, before `STEP_FRACTION`."""
    for j in range(value.numel()):
        share = ca.fmin(share, ca.if_else(change[j] < 0, -value[j] / change[j], 1e9))
    return share


def centring(share_s: ca.SX, share_z: ca.SX) -> ca.SX:
    """By how much mu may shrink after a step: much where the way was free, little where walls were near."""
    return ca.fmax(0.02, (1 - ca.fmin(share_s, share_z)) ** 2)


def active_code(s: ca.SX, z: ca.SX) -> ca.SX:
    """Which limit holds at the end, in the codes of `riccati`."""
    held = [z[j] > s[j] for j in range(s.numel())]
    chosen = ca.if_else(held[0], 1, ca.if_else(held[1], -1, 0))
    if len(held) == 2:
        return chosen
    return ca.if_else(held[2], 2, ca.if_else(held[3], -2, chosen))
