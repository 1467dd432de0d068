"""A gate that re-opens: did the boat go elsewhere, or has that anchor a bias?"""

import math

import msgspec
import numpy as np
import pytest

from companion.core.estimation.filter_state import B_RANGE
from companion.core.estimation.gates import Gate, Rejection
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.ranging.ranges import RangeFusion, RangeLayout, RangeMeasurement, RangeModel
from companion.core.estimation.ranging.uwb_fusion import UwbFusion
from companion.core.estimation.tuning import RANGE_GATE, EstimatorTuning
from companion.core.geometry.frames import rotate
from companion.core.messages import AnchorRange, UwbPosition, UwbRanges
from tests.companion.core.estimation.changed_runs import S, between, changed
from tests.companion.core.estimation.estimator_world import basin, estimate
from tests.support.vessel_fixtures import boat

NOW = 100 * S
ANCHORS = np.array([(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)])
LAYOUT = RangeLayout(position=(0, 1), velocity=(2, 3), bias=4)
FUSION = RangeFusion(KalmanEquations(8), LAYOUT, 0.1, RANGE_GATE, 0.3)
START = np.array([10.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
PLACE = (8.7, 8.7)
"""Where three of the ranges would have it."""


def distance(anchor, x):
    dx, dy = x[:2] - ANCHORS[anchor]
    d, row = math.hypot(dx, dy), np.zeros(8)
    row[0], row[1], row[4 + anchor] = dx / d, dy / d, 1.0
    return RangeModel(d + x[4 + anchor], row)


def reopened(others, agreed_s):
    """After the gate of anchor 0 re-opened: position and its bias. `others` were accepted `agreed_s` ago."""
    P = np.diag([0.1**2] * 2 + [0.01] * 2 + [0.05**2] * 4)
    z = math.dist(PLACE, ANCHORS[0])
    nu = z - distance(0, START).h
    before = tuple(Rejection(NOW - k * S, nu) for k in (2, 1))
    gates = [Gate(NOW - round(agreed_s * S)) if i in others else Gate() for i in range(4)]
    gates[0] = Gate(NOW - 3 * S, before)
    measured = RangeMeasurement(0, z, distance, lambda x: PLACE)
    fused = FUSION.fuse(START, P, gates, measured, NOW)
    assert fused.verdict == "reopened"
    return fused.x[:2], float(fused.x[4])


@pytest.mark.parametrize(
    ("others", "agreed_s", "moves"),
    [
        ((1, 3), 1.0, True),  # on a line across the way: they cannot tell
        ((1, 2), 1.0, False),  # 2 lies ahead: it would have noticed
        ((1, 2), 2.5, True),  # that was before the first rejection, 2 s ago
        ((2,), 1.0, True),  # one alone may be wrong itself
    ],
)
def test_two_anchors_that_agreed_and_would_have_noticed_keep_the_position(others, agreed_s, moves):
    position, bias = reopened(others, agreed_s)
    assert math.dist(position, PLACE if moves else START[:2]) < 0.2
    assert (abs(bias) > 0.8) is not moves


def test_tag_positions_of_another_place_are_followed_and_said(run, estimator) -> None:
    """8 m away from 12 s on, as if somebody had carried the boat; the gate re-opens before positions are missed."""

    def moved(m):
        if not isinstance(m, UwbRanges):
            return m
        eta = run.truth(m.t_rx_ns / S - 0.08)
        north, east = eta[:2] + rotate(eta[2], -0.2, 0.0) - [8.0 if between(m, 12, 99) else 0.0, 0.0]
        return UwbPosition(t_ns=m.t_ns, t_rx_ns=m.t_rx_ns, tag="t", x_m=east, y_m=north, z_m=0.4)

    said = [e for e in estimate(changed(run, moved), estimator).estimates if 16 * S < e.t_ns < 20 * S]
    assert all(e.health == "degraded" and "taken anew" in e.reason for e in said)
    assert abs(said[-1].north_m - run.truth(said[-1].t_ns / S)[0] + 8.0) < 0.5


@pytest.mark.parametrize(("away_m", "said"), [(8.0, True), (3.0, False)])
def test_a_lost_place_that_is_found_farther_away_than_it_may_be_is_said(running, estimator, away_m, said) -> None:
    """Of a boat that has been without ranges for long: 1 m of sigma."""
    fusion = UwbFusion(basin(), boat("aritra").sensors.uwb, EstimatorTuning(), KalmanEquations(B_RANGE + 4))
    now = estimator.belief(running, 3_300_000_000)
    P = now.P.copy()
    P[:2, :], P[:, :2] = 0.0, 0.0
    P[0, 0] = P[1, 1] = 1.0
    dx, dy = rotate(now.x[2], *fusion.arm(now)[:2])
    tag = (now.x[0] + dx - away_m, now.x[1] + dy, fusion.arm(now)[2])
    z = np.linalg.norm(tag - fusion.anchors_m, axis=1) + now.x[B_RANGE:]
    ranges = tuple(AnchorRange(anchor=a.id, range_m=float(d)) for a, d in zip(basin().anchors, z, strict=True))
    lost = msgspec.structs.replace(now, P=P)
    found, _ = fusion.fuse_ranges(lost, UwbRanges(t_ns=0, t_rx_ns=0, tag="test", ranges=ranges))
    assert found.x[0] == pytest.approx(now.x[0] - away_m, abs=0.3)
    assert (found.displaced_ns == now.t_ns) is said
