"""A gate that re-opens: did the boat go elsewhere, or has that anchor a bias?"""

import math

import numpy as np
import pytest

from companion.core.estimation.gates import Gate, Rejection
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.ranging.ranges import RangeFusion, RangeLayout, RangeMeasurement, RangeModel
from companion.core.estimation.tuning import RANGE_GATE

S = 1_000_000_000
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
