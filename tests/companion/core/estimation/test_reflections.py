"""Reflections at the start and under way: an anchor that is wrong twice, ranges that agree against the filter."""

import math

import msgspec
import numpy as np
import pytest

from companion.core.estimation.estimator import Estimator
from companion.core.estimation.ranging.multilateration import multilaterate
from companion.core.geometry.frames import rotate
from companion.core.messages import AnchorRange, Attitude, UwbRanges
from tests.companion.core.estimation.estimator_world import basin
from tests.support.vessel_fixtures import boat

S = 1_000_000_000
PLACE = (8.0, 9.0)
ANCHORS_M = {a.id: np.array([a.north_m, a.east_m, a.down_m]) for a in basin().anchors}
FIRST, SECOND, THIRD, FOURTH = ANCHORS_M


def attitude(t_ns):
    angles = {"phi_rad": 0.0, "theta_rad": 0.0, "psi_rad": 0.3}
    return Attitude(t_ns=t_ns, t_rx_ns=t_ns, **angles, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=0.0)


def cycle(t_ns, place=PLACE, without=(), **wrong_m):
    """Ranges of a boat whose origin rests at `place`; `wrong_m`: how much too long, by anchor."""
    uwb = boat("aritra").sensors.uwb
    dx, dy = rotate(0.3, uwb.x_m, uwb.y_m)
    tag = np.array([place[0] + dx, place[1] + dy, uwb.z_m])
    ranges = tuple(
        AnchorRange(anchor=a, range_m=float(np.linalg.norm(tag - at)) + wrong_m.get(a, 0.0))
        for a, at in ANCHORS_M.items()
        if a not in without
    )
    return UwbRanges(t_ns=t_ns, t_rx_ns=t_ns + 80_000_000, tag="t", ranges=ranges)


class Watched:
    """An estimator that hears cycles of ranges once a second, and attitudes between."""

    def __init__(self):
        vessel = boat("aritra")
        uwb = msgspec.structs.replace(vessel.sensors.uwb, latency_s=0.0)
        self.estimator = Estimator(
            msgspec.structs.replace(vessel, sensors=msgspec.structs.replace(vessel.sensors, uwb=uwb)), basin()
        )
        self.state, self.t_ns = self.estimator.initial(), 0

    def hear(self, **how):
        """One second, at its end a cycle; the innovations of its ranges."""
        for k in range(10):
            self.state, _ = self.estimator.step(self.state, attitude(self.t_ns + k * S // 10))
        self.t_ns += S
        self.state, innovations = self.estimator.step(self.state, cycle(self.t_ns, **how))
        return innovations

    def off_m(self, place=PLACE):
        estimate = self.estimator.estimate(self.state, self.t_ns)
        assert estimate.health != "initialising", estimate.reason
        return math.dist((estimate.north_m, estimate.east_m), place)


@pytest.mark.parametrize("anchor", ANCHORS_M)
def test_an_anchor_that_is_wrong_twice_starts_no_filter_elsewhere(anchor):
    """Three ranges each time, of which one is a reflection: they fit a place nearly as well as good ones do."""
    boat_ = Watched()
    other = next(a for a in ANCHORS_M if a != anchor)
    for lost in (other, other):
        boat_.hear(without=(lost,), **{anchor: 1.5})
        if boat_.state.history:
            assert boat_.off_m() < 0.5
    for _ in range(3):
        boat_.hear()
    assert boat_.off_m() < 0.3


def test_two_ranges_along_one_line_do_not_take_a_filter_that_has_begun_across_it():
    boat_ = Watched()
    for _ in range(3):
        boat_.hear()
    boat_.hear(without=(SECOND, FOURTH), **{FIRST: 0.25, THIRD: 0.3})
    assert boat_.off_m() < 0.5


def test_a_reflection_is_judged_after_the_ranges_that_contradict_it():
    boat_ = Watched()
    while not boat_.state.history:
        boat_.hear()
    accepted = {i.sensor: i.accepted for i in boat_.hear(**{FIRST: 1.6})}
    assert accepted == {f"range {a}": a != FIRST for a in ANCHORS_M}
    assert boat_.off_m() < 0.3


def test_ranges_that_agree_on_another_place_twice_move_the_boat_there():
    boat_ = Watched()
    for _ in range(8):
        boat_.hear()
    there = (PLACE[0] + 1.5, PLACE[1] + 1.5)
    boat_.hear(place=there)
    assert boat_.off_m() < 1.0
    boat_.hear(place=there)
    assert boat_.off_m(there) < 0.5


def test_places_that_do_not_agree_with_each_other_do_not():
    boat_ = Watched()
    for _ in range(8):
        boat_.hear()
    for k in range(4):
        boat_.hear(place=(PLACE[0] + (3.0 if k % 2 else -3.0), PLACE[1] + 2.0 * k))
        assert boat_.off_m() < 1.0


@pytest.mark.parametrize("anchor", [FIRST, THIRD, FOURTH])
def test_a_lost_place_is_regained_by_one_cycle_though_one_range_is_a_reflection(anchor):
    """After six silent seconds the boat is 3.6 m away: other directions to its anchors, and gates of 1.6 m."""
    boat_ = Watched()
    for _ in range(8):
        boat_.hear()
    boat_.t_ns += 6 * S
    there = (PLACE[0] + 3.0, PLACE[1] - 2.0)
    accepted = {i.sensor: i.accepted for i in boat_.hear(place=there, **{anchor: 2.5})}
    assert accepted == {f"range {a}": a != anchor for a in ANCHORS_M}
    assert boat_.off_m(there) < 0.3


def test_two_reflections_at_once_do_not():
    boat_ = Watched()
    for _ in range(8):
        boat_.hear()
    for _ in range(3):
        boat_.hear(**{FIRST: 1.5, SECOND: 2.5})
        assert boat_.off_m() < 0.3


@pytest.mark.parametrize(("anchor", "lost"), [(SECOND, FOURTH), (FOURTH, SECOND)])
def test_a_reflection_that_lasted_and_is_over_does_not_move_the_boat(anchor, lost):
    """By its bias of 2 m, a place 2 m away explains three ranges, and the fourth is not there."""
    boat_ = Watched()
    for _ in range(8):
        boat_.hear()
    for _ in range(3):
        boat_.hear(**{anchor: 2.0})
    for without in ((), (lost,), (lost,), (), ()):
        boat_.hear(without=without)
        assert boat_.off_m() < 0.4


def test_a_drifting_boat_is_where_the_newest_ranges_say():
    anchors, drift = np.array([*ANCHORS_M.values()]), np.array([0.3, -0.2])
    age_s = np.repeat([0.0, 1.0, 2.0], len(anchors))
    tag = np.array([8.0, 9.0])
    at = np.column_stack([tag - age_s[:, None] * drift, np.full(len(age_s), -0.4)])
    each = np.tile(anchors, (3, 1))
    (fix,) = [f for f in multilaterate(each, np.linalg.norm(at - each, axis=1), -0.4, 0.6, age_s) if f.inliers.all()]
    assert math.dist((fix.north_m, fix.east_m), tag) < 0.1
