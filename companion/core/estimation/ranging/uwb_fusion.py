"""Measurement updates by UWB: ranges, or the tag's own position where it sends no ranges.

range     |k (p + R(psi) l) - a_i| + b_i      l: lever arm of the tag in level axes, a_i: anchor, k = 1 + `scale`
position  p + R(psi) l                        north and east judged one by one; corrected for k before it arrives here
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.sensors import Uwb
from companion.core.configuration.site_file import Site
from companion.core.estimation.filter_state import B_RANGE, LAYOUT, AgreedPlace, FilterState, Result, innovation_message
from companion.core.estimation.gates import Gate, all_accepted_ns, judge
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.ranging.ranges import (
    PLACE_SIGMA_M,
    VELOCITY_SIGMA_M_S,
    AnchorHistory,
    RangeFusion,
    RangeMeasurement,
    RangeModel,
    contradicts,
    decorrelate,
    explained_places,
    inflate,
    line_of_sight,
    position_sigma_m,
    recent_anchors,
    relocate,
)
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.geometry.frames import rotate, to_level
from companion.core.messages import UwbPosition, UwbRanges
from companion.core.model.sensor_errors import apply_uwb_scale, correct_uwb_scale
from companion.core.sensors.uwb import HEALTH

ASTRAY_NS, ASTRAY_M = 900_000_000, 1.5
"""Two cycles at 1 Hz whose places are no farther apart than a boat goes: reflections seldom do that. Assumed."""


class UwbFusion:
    """Constant parts of the UWB equations; the methods are pure."""

    def __init__(self, site: Site, uwb: Uwb, tuning: EstimatorTuning, algebra: KalmanEquations):
        self._uwb, self._tuning, self._algebra = uwb, tuning, algebra
        self._ranges = RangeFusion(algebra, LAYOUT, uwb.range_sigma_m, tuning.range_gate, tuning.fix_spread_m)
        self._ids = [a.id for a in site.anchors]
        self.number = {a.id: i for i, a in enumerate(site.anchors)}
        self.anchors_m = np.array([(a.north_m, a.east_m, a.down_m) for a in site.anchors]).reshape(-1, 3)

    def arm(self, belief: FilterState) -> tuple[float, float, float]:
        """Lever arm of the tag in level axes [m]."""
        return to_level(*belief.tilt, self._uwb.x_m, self._uwb.y_m, self._uwb.z_m)

    def fuse_ranges(self, belief: FilterState, m: UwbRanges) -> Result:
        """One cycle of the tag, range by range; anchors that the site file does not know are left out.

        What fits best comes first: a reflection is judged after the ranges that contradict it.
        """
        known = [(self.number[r.anchor], r.range_m) for r in m.ranges if r.anchor in self.number]
        latest = list(belief.latest)
        for i, range_m in known:
            latest[i] = AnchorHistory(belief.t_ns, range_m)
        belief = replace(belief, latest=tuple(latest))
        x, P, gates, innovations = belief.x, belief.P, list(belief.anchor_gates), []
        position_ns = belief.position_ns
        arm = self.arm(belief)
        model, find = partial(self.range_model, arm), partial(self._find, belief.latest, belief.t_ns, arm)
        left = [RangeMeasurement(i, range_m, model, find) for i, range_m in known]
        if position_sigma_m(LAYOUT, P) > HEALTH.degraded_sigma_m:
            left = self._regaining(belief, arm, left)
        while left:
            one = left.pop(self._ranges.best(x, P, left))
            fused = self._ranges.fuse(x, P, gates, one, belief.t_ns)
            x, P, gates[one.anchor] = fused.x, fused.P, fused.gate
            accepted = fused.verdict != "rejected"
            position_ns = belief.t_ns if accepted else position_ns
            nu, S = np.array([fused.innovation]), np.array([[fused.S]])
            innovations.append(innovation_message(belief.t_ns, f"range {self._ids[one.anchor]}", nu, S, accepted))
        after = replace(
            belief, x=x, P=P, anchor_gates=tuple(gates), position_ns=position_ns,
            ranges_ns=belief.t_ns if known else belief.ranges_ns, displaced_ns=_displaced_ns(belief, x),
        )  # fmt: skip
        return self._agreed(after, arm), tuple(innovations)

    def _regaining(
        self, belief: FilterState, arm: tuple[float, float, float], ranges: Sequence[RangeMeasurement]
    ) -> list[RangeMeasurement]:
        """The ranges of a boat whose place is lost, seen from the only one that all but one at hand agree on, if so.

        From metres away the directions of the anchors are others, and gates would reject what is right.
        """
        use = recent_anchors(belief.latest, belief.t_ns, self._tuning.fix_window_s)
        places = self._agreed_places(belief, arm, use)
        if len(places) != 1:
            return list(ranges)
        there = np.array([*places[0], *belief.x[2:]])
        model = partial(self._model_near, there, arm)
        return [
            m._replace(model=model, regains=True) if self._fits(there, arm, [(m.anchor, m.range_m)]) else m
            for m in ranges
        ]

    def _model_near(self, there: np.ndarray, arm: tuple[float, float, float], anchor: int, x: np.ndarray) -> RangeModel:
        """`range_model` at x by its tangent at the state `there`."""
        at = self.range_model(arm, anchor, there)
        return RangeModel(at.h + float(at.row @ (x - there)), at.row)

    def _agreed_places(
        self, belief: FilterState, arm: tuple[float, float, float], use: Sequence[int]
    ) -> list[tuple[float, float]]:
        """Places of the body origin that all ranges of the anchors `use`, but one at most, agree on; three at least."""
        return self._places(belief.latest, belief.t_ns, arm, belief.x, max(3, len(use) - 1))

    def _agreed(self, belief: FilterState, arm: tuple[float, float, float]) -> FilterState:
        """The filter state moved to the only place that the ranges at hand, all but one at most, agree on.

        Not before they have done so for `ASTRAY_NS`, about one place, only if two are rejected, and only to where those
        that are not fit, too: the filter runs away, from whatever its model does not know, and each gate for itself
        would wait for rejections that stay the same.
        """
        use = recent_anchors(belief.latest, belief.t_ns, self._tuning.fix_window_s)
        if len(use) < 3:
            return belief
        rejecting = [i for i in use if belief.anchor_gates[i].rejections]
        if len(rejecting) < 2:
            return replace(belief, astray=None)
        accepted = [(i, seen.range_m) for i in use if i not in rejecting and (seen := belief.latest[i])]
        places = [
            place
            for place in self._agreed_places(belief, arm, use)
            if self._fits(np.array([*place, *belief.x[2:]]), arm, accepted)
        ]
        if len(places) != 1:
            return replace(belief, astray=None)
        first = belief.astray
        if first is None or math.dist((first.north_m, first.east_m), places[0]) > ASTRAY_M:
            return replace(belief, astray=AgreedPlace(belief.t_ns, *places[0]))
        if belief.t_ns - first.t_ns < ASTRAY_NS:
            return belief
        x, P = relocate(LAYOUT, belief.x, belief.P, places[0])
        gates = tuple(Gate(belief.t_ns) if i in use else gate for i, gate in enumerate(belief.anchor_gates))
        return replace(
            belief, x=x, P=P, anchor_gates=gates, astray=None, position_ns=belief.t_ns,
            displaced_ns=_displaced_ns(belief, x),
        )  # fmt: skip

    def _fits(self, x: np.ndarray, arm: tuple[float, float, float], ranges: Sequence[tuple[int, float]]) -> bool:
        """Whether a state explains ranges, each (number of its anchor, range [m])."""
        return all(abs(z - self.range_model(arm, i, x).h) <= self._tuning.fix_spread_m for i, z in ranges)

    def range_model(self, arm: tuple[float, float, float], anchor: int, x: np.ndarray) -> RangeModel:
        """Distance from the anchor to the tag plus bias, and the derivatives to x, y, psi, bias."""
        dx, dy = rotate(x[2], arm[0], arm[1])
        north, east = apply_uwb_scale(self._uwb, x[0] + dx, x[1] + dy)
        distance, e = line_of_sight(np.array([north, east, arm[2]]), self.anchors_m[anchor])
        e = (1 + self._uwb.scale) * e
        row = np.zeros(len(x))
        row[0], row[1], row[2], row[B_RANGE + anchor] = e[0], e[1], -e[0] * dy + e[1] * dx, 1.0
        return RangeModel(distance + x[B_RANGE + anchor], row)

    def _find(
        self, latest: tuple[AnchorHistory | None, ...], t_ns: int, arm: tuple[float, float, float], x: np.ndarray
    ) -> tuple[float, float] | None:
        """Place of the body origin nearest to x that the ranges at hand explain."""
        return min(self._places(latest, t_ns, arm, x, 3), key=lambda p: math.dist(p, x[:2]), default=None)

    def _places(
        self, latest: tuple[AnchorHistory | None, ...], t_ns: int, arm: tuple[float, float, float], x: np.ndarray,
        at_least: int,
    ) -> list[tuple[float, float]]:  # fmt: skip
        """Places of the body origin that so many of the ranges at hand explain; heading and biases as in x."""
        dx, dy = rotate(x[2], arm[0], arm[1])
        places = explained_places(
            self.anchors_m, latest, x[B_RANGE:], t_ns, window_s=self._tuning.fix_window_s, down_m=arm[2],
            spread_m=self._tuning.fix_spread_m, at_least=at_least,
        )  # fmt: skip
        tags = (correct_uwb_scale(self._uwb, *place) for place in places)
        return [(north - dx, east - dy) for north, east in tags]

    def fuse_position(self, belief: FilterState, m: UwbPosition) -> Result:
        """The tag's own position, site ENU; left out while ranges arrive, from which the tag computed it."""
        silent_ns = round(HEALTH.timeout_s * 1e9)
        if belief.ranges_ns is not None and belief.t_ns - belief.ranges_ns < silent_ns:
            return belief, ()
        arm = self.arm(belief)
        x, P, gates, innovations = belief.x, belief.P, list(belief.position_gates), []
        R = np.array([[self._uwb.range_sigma_m**2]])
        for axis, (name, z) in enumerate((("north", m.y_m), ("east", m.x_m))):
            dx, dy = rotate(x[2], arm[0], arm[1])
            H = np.zeros((1, len(x)))
            H[0, axis], H[0, 2] = 1.0, (-dy, dx)[axis]
            nu = np.array([z - x[axis] - (dx, dy)[axis]])
            S = H @ P @ H.T + R
            rule = self._tuning.position_gate
            verdict, gates[axis] = judge(gates[axis], rule, belief.t_ns, float(nu[0]), math.sqrt(S[0, 0]))
            innovations.append(innovation_message(belief.t_ns, f"position {name}", nu, S, verdict != "rejected"))
            if verdict == "rejected":
                continue
            if verdict == "reopened":
                P = inflate(decorrelate(P, (axis,)), (axis,), max(PLACE_SIGMA_M, abs(float(nu[0]))))
                P = inflate(P, LAYOUT.velocity, VELOCITY_SIGMA_M_S)
            x, P = self._algebra.update(x, P, nu, H, R)
        after = replace(
            belief, x=x, P=P, position_gates=tuple(gates), position_ns=all_accepted_ns(gates, belief.position_ns),
            displaced_ns=_displaced_ns(belief, x),
        )  # fmt: skip
        return after, tuple(innovations)


def _displaced_ns(belief: FilterState, x: np.ndarray) -> int | None:
    """When positions last moved the boat against its motion: now, if the state x contradicts the one before."""
    return belief.t_ns if contradicts(LAYOUT, belief.x, belief.P, x) else belief.displaced_ns
