"""The course of a mission before it is driven: its points, its length, and how long it takes."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.guidance.course import PathLimits, plan_course
from companion.core.guidance.path import Path, Waypoint
from companion.core.guidance.preview import preview
from companion.core.guidance.reference import GuidanceSettings, ReferenceTrack, Walker, course_rows


def path(*points):
    return Path(tuple(Waypoint(*p) for p in points))


def walked_s(route, settings):
    """How long the reference takes that guidance lays before the controller, from rest."""
    course = plan_course(route, settings.limits)
    track = ReferenceTrack(course, route.angles_rad[-1], settings)
    times = np.arange(0.0, 900.0, 0.1)
    rows = course_rows(track, Walker(0.0, route.angles_rad[0], 0.0, 0.0), times)
    end = np.array(course.at(course.length_m)[:2])
    return times[np.flatnonzero(np.hypot(*(rows[:, :2] - end).T) < 0.02)[0]]


def test_a_straight_leg_takes_its_length_over_the_speed_and_the_time_to_gain_and_lose_it():
    told = preview(path((0, 0), (10, 0)), PathLimits(crawl_m_s=1e-6))
    assert told.points == ((0.0, 0.0), (10.0, 0.0)) and told.length_m == 10
    assert told.duration_s == pytest.approx(10 / 0.5 + 0.5 / 0.15, abs=1e-3)


def test_one_waypoint_is_a_point():
    assert preview(path((3, 4)), PathLimits()) == (((3, 4),), 0.0, 0.0)


@given(st.lists(st.tuples(st.floats(2, 12), st.floats(-150, 150)), min_size=1, max_size=5))
@pytest.mark.long
def test_its_points_lie_on_the_course_and_its_time_is_that_of_the_reference(legs):
    points, heading = [(0.0, 0.0)], 0.0
    for length, turn in legs:
        heading += math.radians(turn)
        points.append((points[-1][0] + length * math.cos(heading), points[-1][1] + length * math.sin(heading)))
    route, settings = path(*points), GuidanceSettings()
    told, course = preview(route, settings.limits), plan_course(route, settings.limits)
    drawn_m = sum(math.dist(a, b) for a, b in zip(told.points, told.points[1:], strict=False))
    assert drawn_m == pytest.approx(course.length_m, rel=0.01) and told.length_m == course.length_m
    assert told.points[0] == points[0] and told.points[-1] == pytest.approx(points[-1], abs=1e-6)
    assert told.duration_s == pytest.approx(walked_s(route, settings), rel=0.15, abs=2.0)
