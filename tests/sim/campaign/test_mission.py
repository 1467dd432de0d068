"""Figures of a mission from its track: what station the boat should have kept, and what cannot be said."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sim.campaign.mission import judged
from sim.world.score import TrueTrack, tracking
from tests.support.drive_fixture import setup

TWO = ((9.0, 9.0), (16.0, 9.0))


def still(north_m: float, east_m: float) -> TrueTrack:
    """Ten seconds at that place, bow east."""
    rows = np.tile([north_m, east_m, math.pi / 2, 0.0, 0.0, 0.0], (100, 1))
    return TrueTrack(
        t_s=np.arange(100) * 0.1,
        truth=rows,
        estimate=rows.copy(),
        P=np.tile(np.eye(6), (100, 1, 1)),
        u_ref=np.zeros(100),
        leg=np.zeros(100, dtype=int),
        on_leg=np.zeros(100, dtype=bool),
    )


@pytest.mark.parametrize(
    ("points", "end_deg", "error_deg"), [(TWO, None, 90.0), (TWO, 90.0, 0.0), (TWO[1:], 45.0, 45.0)]
)
def test_the_heading_on_station_is_judged_by_the_one_that_the_mission_asks_for(points, end_deg, error_deg):
    settings = setup(points).pilot
    end = None if end_deg is None else math.radians(end_deg)
    settings = replace(settings, mission=replace(settings.mission, end_heading_rad=end))
    figures = judged(still(*points[-1]), settings, 5.0)
    assert (figures["station_error_m"], figures["station_error_deg"]) == pytest.approx((0.0, error_deg))


def test_one_waypoint_without_an_end_heading_asks_for_none():
    figures = judged(still(16.0, 8.0), setup(TWO[1:]).pilot, 5.0)
    assert figures["station_error_m"] == pytest.approx(1.0) and math.isnan(figures["station_error_deg"])


def test_no_corner_driven_is_no_overshoot():
    """One leg; two legs of which the first alone is driven; both, 0.4 m beyond the corner."""
    points = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    row = np.array([[5.0, 0.0, 0.0, 0.5, 0.0, 0.0], [10.4, 3.0, 0.0, 0.5, 0.0, 0.0]])
    track = replace(still(0.0, 0.0), truth=row, u_ref=np.zeros(2), leg=np.array([0, 1]), on_leg=np.array([True, False]))
    assert math.isnan(tracking(track, points[:2])["overshoot_m"]) and math.isnan(tracking(track, points)["overshoot_m"])
    assert tracking(replace(track, on_leg=np.array([True, True])), points)["overshoot_m"] == pytest.approx(0.4)


def test_a_boat_that_drifts_at_its_end_has_no_station():
    drifting = setup(TWO, "rudder").pilot
    assert drifting.guidance.end == "drift"
    figures = judged(still(*TWO[1]), drifting, 5.0)
    assert figures["station_error_m"] is figures["station_error_deg"] is None


def test_a_boat_that_did_not_end_on_station_has_no_error_there():
    figures = judged(still(*TWO[1]), setup(TWO).pilot, None)
    assert figures["station_error_m"] is figures["station_error_deg"] is None
