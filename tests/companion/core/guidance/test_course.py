"""The rounded course: smooth, close to the path, and driven within its limits (sampled every few mm)."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from companion.core.geometry.frames import ssa
from companion.core.guidance.course import PathLimits, corner_speed, hold_point, plan_course
from companion.core.guidance.path import Path, Waypoint
from tests.companion.core.guidance.polyline import distance_m

TURNS = st.floats(-3.14159, 3.14159)
LEGS = st.lists(st.tuples(TURNS, st.floats(0.3, 12.0), st.floats(0.1, 1.0)), min_size=1, max_size=5)
LIMITS = PathLimits()


def path_of(legs):
    north, east, angle = 2.0, 5.0, 0.4
    waypoints = [Waypoint(north, east)]
    for turn, length, speed in legs:
        angle += turn
        north, east = north + length * math.cos(angle), east + length * math.sin(angle)
        waypoints.append(Waypoint(north, east, speed))
    return Path(tuple(waypoints))


@settings(max_examples=40, deadline=None)
@given(LEGS)
def test_course_is_continuous_and_stays_close_to_the_path(legs):
    path = path_of(legs)
    course = plan_course(path, LIMITS)
    s = np.linspace(0, course.length_m, 1500)
    places = np.array([course.at(x) for x in s])
    steps = np.hypot(*np.diff(places[:, :2], axis=0).T)
    assert np.all(steps <= s[1] - s[0] + 1e-9)
    assert places[0, :2] == pytest.approx(path.points[0])
    assert places[-1, :2] == pytest.approx(path.points[-1], abs=1e-9)
    assert course.length_m <= path.length_m + 1e-9
    for north, east, _ in places[::20]:
        assert distance_m(path, north, east) <= LIMITS.corner_cut_m + 1e-9
    for at, point in zip(course.waypoints_m, path.points, strict=True):
        assert math.dist(course.at(at)[:2], point) <= LIMITS.corner_cut_m + 1e-9


@settings(max_examples=40, deadline=None)
@given(LEGS)
def test_tangent_is_the_direction_of_travel(legs):
    course = plan_course(path_of(legs), LIMITS)
    h = 1e-6
    for segment in course.segments:
        s = segment.start_m + 0.4 * segment.length_m
        (n0, e0, _), (n1, e1, _) = course.at(s - h), course.at(s + h)
        assert ssa(math.atan2(e1 - e0, n1 - n0) - course.at(s)[2]) == pytest.approx(0.0, abs=1e-4)


@settings(max_examples=40, deadline=None)
@given(LEGS)
@example([(0.0, 10.0, 1.0), (0.0, 0.4, 1.0)])
@example([(0.0, 0.4, 0.2), (0.0, 0.4, 1.0), (0.0, 0.4, 0.2), (0.0, 5.0, 1.0)])
def test_speed_obeys_the_limits(legs):
    course = plan_course(path_of(legs), LIMITS)
    s = np.linspace(0, course.length_m, 1500)
    v = np.array([course.speed_at(x) for x in s])
    moving = v[:-1] > LIMITS.crawl_m_s  # the crawl is where the profile is allowed to end in a step
    slope = np.diff(v**2) / (2 * np.diff(s))
    assert np.all(slope[moving] <= LIMITS.acceleration_m_s2 + 1e-6)
    settled = (v[1:] > LIMITS.crawl_m_s) & moving
    assert np.all(slope[settled] >= -LIMITS.deceleration_m_s2 - 1e-6)
    assert v[-1] == 0.0
    for segment in course.segments:
        inside = (s > segment.start_m) & (s < segment.start_m + segment.length_m)
        assert np.all(v[inside] <= segment.speed_m_s + 1e-12)
        driven = v[inside & (v > LIMITS.crawl_m_s)]
        assert np.all(driven**2 * abs(segment.curvature_1_m) <= LIMITS.lateral_m_s2 + 1e-9)
        assert np.all(driven * abs(segment.curvature_1_m) <= LIMITS.yaw_rate_rad_s + 1e-9)


@pytest.mark.parametrize("slow_deg", [15, 45, 90, 135])
def test_a_sharper_turn_is_slower(slow_deg):
    def speed(turn_deg):
        legs = [(0.0, 10.0, 1.0), (math.radians(turn_deg), 10.0, 1.0)]
        course = plan_course(path_of(legs), LIMITS)
        return course.speed_at(course.waypoints_m[1])

    assert speed(slow_deg) < speed(slow_deg - 15)


def test_a_right_angle_at_the_default_limits():
    course = plan_course(path_of([(0.0, 12.0, 0.5), (math.pi / 2, 12.0, 0.5)]), LIMITS)
    reach = 0.2 / math.tan(math.pi / 8)  # = radius, for a right angle
    assert [g.length_m for g in course.segments] == pytest.approx([12 - reach, reach * math.pi / 2, 12 - reach])
    assert course.segments[1].curvature_1_m == pytest.approx(1 / reach)
    assert course.speed_at(course.waypoints_m[1]) == pytest.approx(math.sqrt(0.15 * reach))


def test_a_reversal_is_driven_to_the_waypoint_and_back_at_a_crawl():
    course = plan_course(path_of([(0.0, 10.0, 0.5), (math.pi, 10.0, 0.5)]), LIMITS)
    assert len(course.segments) == 2
    assert course.length_m == pytest.approx(20.0)
    assert course.speed_at(10.0) == LIMITS.crawl_m_s


def test_a_small_circle_of_acceptance_makes_a_small_arc():
    path = Path((Waypoint(0, 0), Waypoint(5, 0, acceptance_m=0.1), Waypoint(5, 5)))
    course = plan_course(path, LIMITS)
    assert math.dist(course.at(course.waypoints_m[1])[:2], (5, 0)) == pytest.approx(0.05)


@settings(max_examples=60, deadline=None)
@given(LEGS, st.floats(0.0, 1.0), st.floats(-0.1, 0.1))
def test_follow_finds_the_place_it_was_given(legs, part, side):
    course = plan_course(path_of(legs), LIMITS)
    s = part * course.length_m
    segment = next(g for g in reversed(course.segments) if g.start_m <= s)
    ds = min(max(s - segment.start_m, 0.0), segment.length_m)
    assume(0.25 * segment.length_m < ds < 0.75 * segment.length_m)
    assume(side * segment.curvature_1_m < 0.9)
    north, east, angle = segment.at(ds)
    north, east = north - side * math.sin(angle), east + side * math.cos(angle)
    assert segment.nearest(north, east) == pytest.approx(ds, abs=1e-6)
    reach = 0.2 * segment.length_m  # the window stays inside the segment
    assert course.follow(north, east, s, reach, reach) == pytest.approx(s, abs=1e-6)


def test_follow_on_a_retraced_line_keeps_to_the_leg_being_driven():
    course = plan_course(path_of([(0.0, 10.0, 0.5), (math.pi, 10.0, 0.5)]), LIMITS)
    s, visited = 0.0, []
    for x in [*np.arange(0, 10.01, 0.05), *np.arange(10, 0, -0.05)]:
        s = course.follow(2 + x * math.cos(0.4), 5 + x * math.sin(0.4), s, 0.5, 0.3)
        visited.append(s)
    assert np.all(np.diff(visited) >= -1e-9)
    assert visited[-1] == pytest.approx(19.95)


def test_holding_is_a_course_of_no_length():
    course = hold_point(3.0, 4.0, 1.0, LIMITS)
    assert course.at(0.0) == (3.0, 4.0, 1.0)
    assert (course.length_m, course.speed_at(0.0)) == (0.0, 0.0)
    assert course.follow(9.0, 9.0, 0.0, 0.5, 0.5) == 0.0


def test_one_waypoint_is_no_course():
    with pytest.raises(ValueError, match="one waypoint"):
        plan_course(Path((Waypoint(0, 0),)), LIMITS)


def test_limits_must_be_positive_and_corner_speed_never_falls_below_the_crawl():
    with pytest.raises(ValueError, match="lateral_m_s2 must be a positive number, not 0"):
        PathLimits(lateral_m_s2=0.0)
    assert corner_speed(0.0, LIMITS) == LIMITS.crawl_m_s
