"""Measurement update by one UWB range, whatever else the filter estimates: gate, bias per anchor, re-opening.

    h(x) = |p_tag - a_i| + b_i

A `RangeLayout` says where the filter's state keeps position, velocity and the anchors' biases.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.estimation.gates import OPEN, Gate, GateRule, Verdict, judge
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.ranging.multilateration import multilaterate

VELOCITY_SIGMA_M_S = 0.5
"""Sigma of the velocity after the position turned out wrong; assumed."""
DISPLACED_M, DISPLACED_SIGMAS = 2.0, 3.29
"""A place farther away than this, and than so many sigma of the position, contradicts it. Gusts and waves that a model
does not know were seen to take a filter 1 m away. Assumed."""
PLACE_SIGMA_M = 2.0
"""Sigma of a sensor's position before it is fused; wide, so that the next ones decide. Assumed."""
FIX_SIGMA_M = 0.3
"""Sigma of a multilateration fix: three of a range, with what a drifting boat adds; assumed. A wider one lets two
ranges, of anchors on opposite sides, take the boat along the line that they do not see."""


@dataclass(frozen=True, slots=True)
class RangeLayout:
    """Indices into the state: north and east at `position`, two velocities, first anchor bias."""

    position: tuple[int, int]
    velocity: tuple[int, int]
    bias: int


class AnchorHistory(NamedTuple):
    """The latest range of an anchor."""

    t_ns: int
    range_m: float


class RangeModel(NamedTuple):
    """h [m] and its row of the Jacobian (n,) for one range."""

    h: float
    row: np.ndarray


class RangeMeasurement(NamedTuple):
    """One range: number of its anchor, and how the filter that gets it predicts ranges and finds places.

    `model`: anchor, state -> h and its row; `find`: state -> the nearest place that the ranges explain, or None;
    `regains`: it fits the place on which ranges agree, of a boat whose own is lost: no gate knows better.
    """

    anchor: int
    range_m: float
    model: Callable[[int, np.ndarray], RangeModel]
    find: Callable[[np.ndarray], tuple[float, float] | None]
    regains: bool = False


class OtherAnchors(NamedTuple):
    """Those beside one whose gate re-opens. `agreed`: two or more, or none, since it was rejected first;
    `are_accepted`: whether two are, of late.
    """

    agreed: tuple[int, ...]
    are_accepted: bool


class RangeUpdate(NamedTuple):
    """State, covariance and gate after one range, the verdict, innovation nu and its variance S."""

    x: np.ndarray
    P: np.ndarray
    gate: Gate
    verdict: Verdict
    innovation: float
    S: float


def line_of_sight(tag_m: np.ndarray, anchor_m: np.ndarray) -> tuple[float, np.ndarray]:
    """Distance [m] and the unit vector from the anchor to the tag, shape (3,)."""
    delta = tag_m - anchor_m
    distance = max(float(np.sqrt(delta @ delta)), 1e-3)
    return distance, delta / distance


@dataclass(frozen=True)
class RangeFusion:
    """One UWB range at a time into a filter whose state is laid out as `layout` says.

    `sigma_m`: white noise of a range; `rule`: of the anchors' gates; `spread_m`: residual of a range that fits a place.
    """

    algebra: KalmanEquations
    layout: RangeLayout
    sigma_m: float
    rule: GateRule
    spread_m: float

    def fuse(self, x: np.ndarray, P: np.ndarray, gates: Sequence[Gate], m: RangeMeasurement, t_ns: int) -> RangeUpdate:
        """Judge a range by its anchor's gate and, unless it is rejected, update x and P with it."""
        R = np.array([[self.sigma_m**2]])
        at, nu, S = self.innovation(x, P, m)
        gate = OPEN if m.regains else gates[m.anchor]
        verdict, gate = judge(gate, self.rule, t_ns, nu, math.sqrt(S))
        if verdict == "rejected":
            return RangeUpdate(x, P, gate, verdict, nu, S)
        correction = nu
        if verdict == "reopened":
            x, P = self._reopen(x, P, m, nu, self._others(gates, m.anchor, t_ns))
            at = m.model(m.anchor, x)
            correction = m.range_m - at.h
        x, P = self.algebra.update(x, P, np.array([correction]), at.row[None, :], R)
        return RangeUpdate(x, P, gate, verdict, nu, S)

    def innovation(self, x: np.ndarray, P: np.ndarray, m: RangeMeasurement) -> tuple[RangeModel, float, float]:
        """h and its row, nu = z - h, and its variance S."""
        at = m.model(m.anchor, x)
        return at, m.range_m - at.h, float(at.row @ P @ at.row) + self.sigma_m**2

    def best(self, x: np.ndarray, P: np.ndarray, ranges: Sequence[RangeMeasurement]) -> int:
        """Which fits best: the smallest nu^2 / S."""
        return int(np.argmin([nu**2 / S for _, nu, S in (self.innovation(x, P, m) for m in ranges)]))

    def _reopen(
        self, x: np.ndarray, P: np.ndarray, m: RangeMeasurement, nu: float, others: OtherAnchors
    ) -> tuple[np.ndarray, np.ndarray]:
        """State and covariance after a gate re-opened: is the position wrong, or this anchor's bias?

        The bias, if the range without it fits x (within `spread_m`): a reflection is over. The position, if the place
        nearest to x that three or more ranges explain explains this one too, and those of other anchors that agreed
        with x all the while: x moves there. The bias, if that place does not, or if there is none but two other anchors
        were accepted of late. Else the position again. What is wrong becomes uncertain by the innovation.
        """
        layout, place = self.layout, m.find(x)
        bias_m = float(x[layout.bias + m.anchor])
        is_over = abs(nu + bias_m) <= self.spread_m < abs(bias_m)
        if place and not is_over:
            moved = relocate(layout, x, P, place)
            expected = {m.anchor: m.range_m} | {i: m.model(i, x).h for i in others.agreed}
            if all(abs(h - m.model(i, moved[0]).h) <= self.spread_m for i, h in expected.items()):
                return moved
        if is_over or place or others.are_accepted:
            bias = (layout.bias + m.anchor,)
            return x, inflate(decorrelate(P, bias), bias, abs(nu))
        return x, inflate(inflate(P, layout.position, abs(nu)), layout.velocity, VELOCITY_SIGMA_M_S)

    def _others(self, gates: Sequence[Gate], anchor: int, t_ns: int) -> OtherAnchors:
        """The anchors beside this one."""
        first_s, ages_s = (t_ns - gates[anchor].rejections[0].t_ns) * 1e-9, [gate.starved_s(t_ns) for gate in gates]
        agreed = [i for i, age_s in enumerate(ages_s) if i != anchor and age_s < first_s]
        of_late = [age_s < 2 * self.rule.reopen_span_s for i, age_s in enumerate(ages_s) if i != anchor]
        return OtherAnchors(tuple(agreed) if len(agreed) >= 2 else (), sum(of_late) >= 2)


def explained_places(
    anchors_m: np.ndarray, latest: Sequence[AnchorHistory | None], biases_m: np.ndarray, t_ns: int, *,
    window_s: float, down_m: float, spread_m: float, at_least: int = 3,
) -> list[tuple[float, float]]:  # fmt: skip
    """Places of the tag [m] that so many of the recent ranges explain."""
    use = recent_anchors(latest, t_ns, window_s)
    if len(use) < 3:
        return []
    ranges = np.array([seen.range_m for i in use if (seen := latest[i])]) - biases_m[use]
    fixes = multilaterate(anchors_m[use], ranges, down_m, spread_m)
    return [(f.north_m, f.east_m) for f in fixes if f.inliers.sum() >= at_least]


def recent_anchors(latest: Sequence[AnchorHistory | None], t_ns: int, window_s: float) -> list[int]:
    """Numbers of the anchors whose latest range is no older than `window_s`."""
    oldest = t_ns - round(window_s * 1e9)
    return [i for i, seen in enumerate(latest) if seen and seen.t_ns >= oldest]


def relocate(
    layout: RangeLayout, x: np.ndarray, P: np.ndarray, place_m: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """State put at `place_m`, decorrelated from the rest; velocity variances inflated."""
    P, x = decorrelate(P, layout.position), x.copy()
    for i, value in zip(layout.position, place_m, strict=True):
        x[i], P[i, i] = value, FIX_SIGMA_M**2
    return x, inflate(P, layout.velocity, VELOCITY_SIGMA_M_S)


def position_sigma_m(layout: RangeLayout, P: np.ndarray) -> float:
    """Largest semi-axis of the position's one-sigma ellipse [m]."""
    i, j = layout.position
    half_sum, half_difference = (P[i, i] + P[j, j]) / 2, (P[i, i] - P[j, j]) / 2
    return float(np.sqrt(half_sum + np.hypot(half_difference, P[i, j])))


def contradicts(layout: RangeLayout, x: np.ndarray, P: np.ndarray, now: np.ndarray) -> bool:
    """Whether the position of x, with covariance P, speaks against that of `now`."""
    at = [*layout.position]
    away_m = math.dist(x[at], now[at])
    return away_m > max(DISPLACED_M, DISPLACED_SIGMAS * position_sigma_m(layout, P))


def inflate(P: np.ndarray, indices: Sequence[int], sigma: float | Sequence[float]) -> np.ndarray:
    """P with `sigma` squared added to the variances at `indices`; one sigma for all, or one for each."""
    P = P.copy()
    P[indices, indices] += np.square(sigma)
    return P


def decorrelate(P: np.ndarray, indices: Sequence[int]) -> np.ndarray:
    """P with the given states' correlations removed, their variances kept."""
    P = P.copy()
    for i in indices:
        variance = P[i, i]
        P[i, :] = 0.0
        P[:, i] = 0.0
        P[i, i] = variance
    return P
