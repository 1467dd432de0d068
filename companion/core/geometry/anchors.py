"""Where anchors stand, and what a position from ranges to them is worth."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

SAME_PLACE_M = 0.5
"""Circles about two anchors that stand nearer together, in plan, give no place (`multilateration`); assumed."""
ONE_ANCHOR_M = 0.1
"""Two anchors cannot stand nearer together than they are large; assumed."""


def hdop(anchors_m: np.ndarray, north_m: float, east_m: float, down_m: float) -> float:
    """sqrt(trace((H^T H)^-1)), H: rows of unit vectors from anchors (m, 3) to the tag, north and east only. It is the
    position's sigma over a range's; infinite where the anchors leave a direction open.
    """
    away = np.array([north_m, east_m, down_m]) - anchors_m
    H = (away / np.maximum(np.linalg.norm(away, axis=1), 1e-6)[:, None])[:, :2]
    A = H.T @ H
    if np.linalg.matrix_rank(A, tol=1e-6) < 2:
        return math.inf
    return float(np.sqrt(np.trace(np.linalg.inv(A))))


def on_one_another(anchors_m: np.ndarray) -> tuple[int, int] | None:
    """Numbers of two anchors (m, 3) at one place, or None."""
    pairs = combinations(range(len(anchors_m)), 2)
    return next(((i, j) for i, j in pairs if math.dist(anchors_m[i], anchors_m[j]) < ONE_ANCHOR_M), None)


def in_one_place(anchors_m: np.ndarray) -> bool:
    """Whether all of several anchors (m, 3) stand so close together in plan that no position follows."""
    pairs = list(combinations(anchors_m[:, :2], 2))
    return bool(pairs) and all(math.dist(a, b) < SAME_PLACE_M for a, b in pairs)


def in_a_line(anchors_m: np.ndarray) -> bool:
    """Whether all anchors (m, 3) stand, in plan, within `SAME_PLACE_M` of one line: two places explain all ranges."""
    away = anchors_m[:, :2] - anchors_m[:, :2].mean(axis=0)
    across = np.linalg.svd(away)[2][-1]
    return bool(np.abs(away @ across).max() < SAME_PLACE_M)
