"""Guidance of a boat that is steered only while it makes way."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.guidance import guidance
from companion.core.guidance.course import PathLimits, plan_course
from companion.core.guidance.path import Path, Waypoint
from companion.core.guidance.progress import Passage
from companion.core.guidance.reference import GuidanceSettings
from companion.core.guidance.reference_row import Column
from companion.core.guidance.steerage import corner_problems, guidance_for, needs_way, turning_radius_m
from tests.support.vessel_fixtures import boat

RUDDER = guidance_for(boat("rudder"))
TIMES = np.arange(0.0, 4.01, 0.2)


def path(*points):
    return Path(tuple(Waypoint(*p) for p in points))


@pytest.mark.parametrize(("name", "way"), [("rudder", True), ("azimuth", False), ("aritra", False), ("twin", False)])
def test_who_needs_way(name, way):
    assert needs_way(boat(name)) is way
    assert (guidance_for(boat(name)) == GuidanceSettings()) is not way


def test_the_turning_radius_is_that_of_a_boat_of_this_size_and_grows_with_less_rudder():
    vessel = boat("rudder")
    (t,) = vessel.thrusters
    radius = turning_radius_m(vessel, 0.5)
    assert 0.5 * vessel.hull.length_m < radius < 3 * vessel.hull.length_m
    assert t.rudder is not None
    less = replace(vessel, thrusters=(replace(t, rudder=replace(t.rudder, angle_max_deg=15.0)),))
    assert turning_radius_m(less, 0.5) > 1.5 * radius


@given(st.floats(10, 120), st.sampled_from([-1, 1]), st.floats(0.8, 2.5))
def test_no_arc_of_the_course_is_tighter_than_the_boat_can_turn(turn_deg, side, radius):
    angle = math.radians(turn_deg) * side
    there = (12.0 + 12 * math.cos(angle), 12 * math.sin(angle))
    limits = PathLimits(turning_radius_m=radius)
    corner = path((0, 0), (12, 0), there)
    settings = replace(RUDDER, limits=limits)
    tightest = max(abs(s.curvature_1_m) for s in plan_course(corner, limits).segments)
    if not corner_problems(corner, settings):
        assert tightest <= 1 / radius + 1e-9
    else:
        assert radius * math.tan(abs(angle) / 2) > 0.45 * 12


def test_corners_without_room_are_named_and_others_are_not():
    assert corner_problems(path((0, 0), (12, 0), (12, 12)), RUDDER) == []
    (problem,) = corner_problems(path((0, 0), (12, 0), (12, 2), (0, 2)), RUDDER)[:1]
    assert (
        problem.startswith("waypoint 2 cannot be rounded: the turn of 90 deg needs")
        and "cannot turn on the spot" in problem
    )
    assert corner_problems(path((0, 0), (12, 0), (0, 0.1)), RUDDER)
    assert corner_problems(path((0, 0), (12, 0), (0, 0.1)), GuidanceSettings()) == []


@given(st.floats(-math.pi, math.pi), st.floats(0.0, 0.6))
def test_a_boat_that_needs_way_is_never_asked_to_stand_still_and_turn(psi, u):
    """Whatever its heading at the start of a leg, over the whole horizon once it has had time to gather way."""
    eta, nu = (3.0, 3.0, psi), (u, 0.0, 0.0)
    state = guidance.start(path((12, 3), (12, 12)), RUDDER, eta, nu, 0)
    for k in range(1, 31):
        state, _ = guidance.step(state, RUDDER, eta, nu, k * 100_000_000)
    rows = guidance.horizon(state, RUDDER, eta, nu, TIMES)
    assert (rows[:, Column.U] >= RUDDER.steerage_m_s - 1e-9).all()
    assert (np.abs(rows[:, Column.R]) <= RUDDER.limits.yaw_rate_rad_s + 1e-9).all()


def test_past_the_last_waypoint_it_is_done_and_no_station_is_asked_for():
    state = guidance.start(path((4, 0), (12, 0)), RUDDER, (3.9, 0.0, 0.0), (0.5, 0, 0), 0)
    for k, x in enumerate(np.arange(4.0, 12.6, 0.05), 1):
        state, reference = guidance.step(state, RUDDER, (float(x), 0.0, 0.0), (0.5, 0, 0), k * 100_000_000)
        if reference.phase == "leg":
            rows = guidance.horizon(state, RUDDER, (float(x), 0.0, 0.0), (0.5, 0, 0), TIMES)
            assert (rows[:, Column.STATION] == 0).all()
    assert state.phase == "done" and [p.waypoint for p in state.passed] == [0, 1]


@pytest.mark.parametrize("passed", [(), (Passage(0, "circle", 0.1, 0),)])
def test_within_the_circle_of_its_last_waypoint_it_is_done_at_the_start(passed):
    points = [(0, 0), (12, 0)][1 - len(passed) :]
    state = guidance.start(path(*points), RUDDER, (11.9, 0.0, 0.0), (0.0, 0, 0), 7, passed=passed)
    assert (
        state.phase == "done" and state.settled_ns == 7 and [p.waypoint for p in state.passed] == [*range(len(points))]
    )
    there = guidance.start(path(*points), GuidanceSettings(), (11.9, 0.0, 0.0), (0.0, 0, 0), 7, passed=passed)
    assert there.phase == "station" and there.settled_ns is None
