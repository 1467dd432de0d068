"""What explains ranges of a window best on a given path: they come late, the way by them is turned, or neither.

See `path_check` for the equations; plane vectors are complex numbers, north + i east.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.core.geometry.frames import ssa


class PathHypothesis(NamedTuple):
    """The ranges are late by so much, or the path by them is turned by so much."""

    delay_s: float = 0.0
    turn_rad: float = 0.0

    def agrees(self, other: PathHypothesis) -> bool:
        """Whether both say nearly the same: both late, or turned by nearly as much."""
        return bool(self.delay_s) == bool(other.delay_s) and abs(ssa(self.turn_rad - other.turn_rad)) <= SAME_TURN_RAD


STEP_RAD, SAME_TURN_RAD = math.radians(30), math.radians(61)
"""Two steps, and a little for rounding, are the same turn; assumed."""
HYPOTHESES = (
    PathHypothesis(),
    *(PathHypothesis(delay_s=delay_s) for delay_s in (0.5, 1.0, 1.5, 2.0)),
    *(PathHypothesis(turn_rad=ssa(k * STEP_RAD)) for k in range(2, 11)),
)
OUTLIER, REWEIGHTED = 3.0, 6
"""Geman and McClure's weights: a range that is off by so many sigmas counts for a quarter, and a reflection speaks for
or against nothing by more than 4.5 nats."""
UNKNOWN = 1e-6
"""Information of what may be anything: a sigma of a kilometre."""


class SeenRange(NamedTuple):
    """A range as a projection: `along_m` is the part of the tag's place along `u`, a unit vector from its anchor."""

    t_s: float
    u: complex
    along_m: float


class RangeWindow:
    """Ranges of a window, each with the same sigma [m]."""

    def __init__(self, seen: Sequence[SeenRange], sigma_m: float):
        self._t_s, self._u, self._along_m = (np.array(column) for column in zip(*seen, strict=True))
        self._sigma_m = sigma_m

    def best(
        self, t_s: np.ndarray, path: np.ndarray, shape: np.ndarray, sigmas: tuple[float, float, float]
    ) -> tuple[PathHypothesis, float]:
        """What explains them best on this path, and by how much better than `PathHypothesis()` [nats].

        `path` and `shape`: p and g at the times `t_s`, complex; `sigmas` of w, b and a. Nats are divided by how badly
        even the best explains them: errors that nothing of this is the cause of.
        """
        information = np.repeat([UNKNOWN, *(max(s**-2, UNKNOWN) for s in sigmas)], 2)
        at = [(self._t_s - h.delay_s, cmath.rect(1.0, h.turn_rad)) for h in HYPOTHESES]
        p, g = (np.array([turn * np.interp(t, t_s, values) for t, turn in at]) for values in (path, shape))
        costs = self._costs(p, g, information)
        best = int(np.argmin(costs))
        return HYPOTHESES[best], float(costs[0] - costs[best]) / max(1.0, 2 * float(costs[best]) / len(self._t_s))

    def _costs(self, path: np.ndarray, shape: np.ndarray, information: np.ndarray) -> np.ndarray:
        """Negative logarithm of the posterior at its maximum over c, w, b, a: iteratively reweighted least squares.

        For each hypothesis: p and g at the ranges, shapes (d, n); costs (d,).
        """
        toward, since_s = np.conj(self._u), np.broadcast_to(self._t_s - self._t_s[-1], shape.shape)
        shapes = np.ones_like(shape), since_s, shape, since_s**2 / 2
        parts = [toward * g * turn for g in shapes for turn in (1.0, 1.0j)]
        A = np.real(np.stack(parts, axis=-1)) / self._sigma_m
        b = (self._along_m - np.real(toward * path)) / self._sigma_m
        A_T, weight, theta, e = A.transpose(0, 2, 1), np.ones_like(b), np.zeros((len(b), 8)), b
        for _ in range(REWEIGHTED):
            weighted = A_T * weight[:, None, :]
            theta = np.linalg.solve(weighted @ A + np.diag(information), (weighted @ b[..., None]))[..., 0]
            e = np.abs(b - (A @ theta[..., None])[..., 0])
            weight = (1 + (e / OUTLIER) ** 2) ** -2
        data = (e**2 / (1 + (e / OUTLIER) ** 2)).sum(axis=1) / 2
        return data + (information * theta**2).sum(axis=1) / 2
