"""Where a tag is, from ranges alone: every place that explains them, best first. No prior, no truth.

Each pair of anchors leaves two places (the two crossings of its circles). Every such place is a start for
iteratively re-weighted Gauss-Newton with Cauchy weights,

    w_i = 1 / (1 + (e_i / c)^2),   e_i = z_i - |p - a_i|

so one wild range loses its say. Anchors in a line leave a mirror image: both are returned. Of ranges that are not of
one instant, p = p_0 - v age, v ~ N(0, sigma_v): a boat that drifts.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from companion.core.geometry.anchors import SAME_PLACE_M

MAX_ITERATIONS = 60
CONVERGED_M = 1e-3
DRIFT_SIGMA_M_S = 0.3
"""Of a boat that does not drive; assumed."""


@dataclass(frozen=True, slots=True)
class PositionFix:
    """One place [m] of the tag; `inliers` (m,) marks the ranges within the spread; `cost`: Cauchy cost."""

    north_m: float
    east_m: float
    inliers: np.ndarray
    cost: float


def multilaterate(
    anchors_m: np.ndarray, ranges_m: np.ndarray, down_m: float, spread_m: float, age_s: np.ndarray | None = None
) -> list[PositionFix]:
    """Places that explain the ranges, cheapest first.

    `anchors_m` (m, 3) NED, `ranges_m` (m,), `down_m`: height of the tag, `spread_m`: a good range's residual; `age_s`
    (m,): how old each is, the newest first; the place is that of age 0. Fewer than two anchors in plan give an empty
    list.
    """
    age_s = np.zeros(len(ranges_m)) if age_s is None else age_s
    drop = anchors_m[:, 2] - down_m
    plane = np.sqrt(np.maximum(ranges_m**2 - drop**2, 0.0))
    _, newest = np.unique(anchors_m, axis=0, return_index=True)
    fixes: list[PositionFix] = []
    for start in _starts(anchors_m[newest, :2], plane[newest]):
        p, residuals = _refine(start, anchors_m, ranges_m, drop, spread_m / 2, age_s)
        cost = float(np.log1p((residuals / (spread_m / 2)) ** 2).sum())
        fixes.append(PositionFix(float(p[0]), float(p[1]), np.abs(residuals) <= spread_m, cost))
    fixes.sort(key=lambda fix: fix.cost)
    distinct: list[PositionFix] = []
    for fix in fixes:
        if all(np.hypot(fix.north_m - o.north_m, fix.east_m - o.east_m) > SAME_PLACE_M for o in distinct):
            distinct.append(fix)
    return distinct


def _starts(anchors: np.ndarray, radii: np.ndarray) -> list[np.ndarray]:
    """Crossings of the circles of every pair of anchors; the nearest approach where they do not meet."""
    starts = []
    for i, j in combinations(range(len(radii)), 2):
        base = anchors[j] - anchors[i]
        d = float(np.hypot(*base))
        if d < SAME_PLACE_M:
            continue
        along = (radii[i] ** 2 - radii[j] ** 2 + d**2) / (2 * d)
        across = float(np.sqrt(max(radii[i] ** 2 - along**2, 0.0)))
        e = base / d
        foot = anchors[i] + float(np.clip(along, -radii[i], radii[i])) * e
        starts += [foot + side * across * np.array([-e[1], e[0]]) for side in (1.0, -1.0)]
    return starts


def _refine(
    start: np.ndarray, anchors: np.ndarray, z: np.ndarray, drop: np.ndarray, scale: float, age_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Place (2,) and residuals (m,): Gauss-Newton with Cauchy weights, damped a little where the geometry is weak."""
    x = np.array([*start, 0.0, 0.0])
    prior = np.array([0.0, 0.0, 1.0, 1.0]) * (scale / DRIFT_SIGMA_M_S) ** 2
    for _ in range(MAX_ITERATIONS):
        e, toward = _residuals(x, anchors, z, drop, age_s)
        w = 1.0 / (1.0 + (e / scale) ** 2)
        J = np.hstack([toward, -age_s[:, None] * toward])
        A = J.T @ (w[:, None] * J) + np.diag(prior + 1e-6)
        step = np.linalg.solve(A, J.T @ (w * e) - prior * x)
        x = x + step
        if np.abs(step).sum() < CONVERGED_M:
            break
    return x[:2], _residuals(x, anchors, z, drop, age_s)[0]


def _residuals(
    x: np.ndarray, anchors: np.ndarray, z: np.ndarray, drop: np.ndarray, age_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """z - h (m,) and dh/dp (m, 2) at x = [p_0, v]."""
    delta = x[:2] - age_s[:, None] * x[2:] - anchors[:, :2]
    h = np.maximum(np.sqrt((delta**2).sum(axis=1) + drop**2), 1e-6)
    return z - h, delta / h[:, None]
