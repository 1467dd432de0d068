"""Path geometry against complex numbers and brute force; the steering laws against their equations."""

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.guidance.path import Path, Waypoint, crab_angle, ilos_rate, los_heading

LEGS = st.lists(st.tuples(st.floats(-3.1, 3.1), st.floats(1.0, 15.0)), min_size=1, max_size=6)
COORDINATE = st.floats(-20, 20)


def path_of(legs, north=3.0, east=-2.0, **waypoint):
    points, angle = [complex(north, east)], 0.0
    for turn, length in legs:
        angle += turn
        points.append(points[-1] + length * cmath.exp(1j * angle))
    return Path(tuple(Waypoint(p.real, p.imag, **waypoint) for p in points))


@given(LEGS)
def test_lengths_and_angles_are_those_it_was_made_of(legs):
    path = path_of(legs)
    assert path.lengths_m == pytest.approx([length for _, length in legs])
    assert path.length_m == pytest.approx(sum(length for _, length in legs))
    for angle, expected in zip(path.angles_rad, np.cumsum([turn for turn, _ in legs]), strict=True):
        assert cmath.exp(1j * angle) == pytest.approx(cmath.exp(1j * expected), abs=1e-9)


@given(LEGS, COORDINATE, COORDINATE)
def test_errors_are_the_point_in_the_axes_of_the_leg(legs, north, east):
    path = path_of(legs)
    for leg, (a, b) in enumerate(zip(path.points, path.points[1:], strict=False)):
        along = complex(b[0] - a[0], b[1] - a[1])
        expected = complex(north - a[0], east - a[1]) / (along / abs(along))
        assert complex(*path.errors(leg, north, east)) == pytest.approx(expected, abs=1e-8)


def test_cross_track_error_is_positive_to_starboard():
    north_bound = Path((Waypoint(0, 0), Waypoint(10, 0)))
    assert north_bound.errors(0, 4.0, 1.0) == pytest.approx((4.0, 1.0))


@pytest.mark.parametrize(
    ("waypoints", "message"),
    [
        ((), "waypoint 1: a path needs at least one"),
        ((Waypoint(0, 0), Waypoint(math.nan, 0)), "waypoint 2: position is not finite"),
        ((Waypoint(0, 0), Waypoint(0, 0.01)), "waypoint 2: lies within 0.05 m"),
        ((Waypoint(0, 0, speed_m_s=0.0),), "waypoint 1: speed: expected above 0, at most 20, found 0"),
        (
            (Waypoint(0, 0, acceptance_m=-1.0),),
            "waypoint 1: acceptance radius: expected above 0, at most 100, found -1",
        ),
        ((Waypoint(0, 0, speed_m_s=math.inf),), "waypoint 1: speed: expected above 0"),
    ],
)
def test_what_is_no_path_is_refused_with_the_waypoint(waypoints, message):
    with pytest.raises(ValueError, match=message):
        Path(waypoints)


def test_los_aims_at_the_point_a_lookahead_ahead_on_the_line():
    for angle, y_e, lookahead in [(0.3, 2.0, 3.0), (-2.0, -1.0, 1.5), (3.0, 40.0, 2.0)]:
        heading = los_heading(angle, y_e, lookahead)
        aim = complex(lookahead, -y_e) * cmath.exp(1j * angle)
        assert cmath.exp(1j * heading) == pytest.approx(aim / abs(aim))


@given(st.floats(-0.5, 0.5), st.floats(0.5, 4.0), st.floats(0.1, 2.0))
def test_ilos_rests_where_the_heading_cancels_the_drift(drift_rad, lookahead, kappa):
    y_int = lookahead * math.tan(drift_rad) / kappa
    assert ilos_rate(0.0, y_int, lookahead, kappa) == 0.0
    assert los_heading(1.0, 0.0, lookahead, kappa=kappa, y_int_m=y_int) == pytest.approx(1.0 - drift_rad)


def test_crab_angle_is_left_alone_at_rest():
    assert crab_angle(0.5, 0.5) == pytest.approx(math.pi / 4)
    assert crab_angle(0.05, 0.5) == 0.0
