"""Where guidance begins: the place to hold beside a fence, and the heading at the end of a mission started again."""

import math

import pytest

from companion.core.guidance.guidance import hold, start, step
from companion.core.guidance.path import Path, Waypoint
from companion.core.guidance.progress import Passage
from companion.core.guidance.reference import GuidanceSettings

SETTINGS = GuidanceSettings()


def test_hold_never_places_the_boat_where_it_is_not_clear():
    eta, nu = (3.0, 4.0, math.pi / 2), (2.0, 0.0, 0.0)
    for limit_m, east_m in ((10.0, 4.0), (20.0, 4.0 + 2.0**2 / 0.3)):
        state = hold(SETTINGS, eta, nu, 0, is_clear=lambda north_m, east_m, limit_m=limit_m: east_m < limit_m)
        _, ref = step(state, SETTINGS, eta, nu, 100_000_000)
        assert (ref.north_ref_m, ref.east_ref_m) == pytest.approx((3.0, east_m))


@pytest.mark.parametrize("here", [(9.4, 0.3), (10.3, 0.6), (10.8, 0.0), (9.6, 0.2), (4.0, -1.0)])
def test_the_heading_at_the_end_is_the_missions_wherever_it_is_started_again(here):
    path = Path((Waypoint(0, 0), Waypoint(10, 0)))
    passed = (Passage(0, "circle", 0.0, 0),)
    state = start(path, SETTINGS, (*here, 1.0), (0.0, 0.0, 0.0), 0, passed=passed)
    assert state.end_psi_rad == 0.0
