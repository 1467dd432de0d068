"""What a report on an identification says beside the numbers: what a hull can have, and what a boat can do."""

import pytest
from msgspec.structs import replace

from sim.fitting.engine.parameters import Parameters, file_values
from sim.fitting.identify.advice import MANOEUVRES, feasible, free_axes
from sim.fitting.identify.plausible import bands, without_dimension
from tests.support.vessel_fixtures import boat


@pytest.mark.parametrize(
    ("name", "strafes", "spins"),
    [
        ("aritra", True, True),
        ("azimuth", True, True),
        ("twin", False, True),
        ("blueboat", False, True),
        ("rudder", False, False),
    ],
)
def test_no_boat_is_asked_for_what_it_cannot_do(name, strafes, spins):
    can_do = [feasible(m, free_axes(boat(name))) for m in MANOEUVRES]
    asked = " ".join(can_do)
    assert ("strafe" in asked) == strafes and ("spins" in asked) == spins
    assert all(can_do)


def test_what_a_hull_can_have_holds_the_boats_of_this_project():
    """Each from another source: paper, data set, guess; and without dimensions a boat twice as long is the same."""
    for name in ("aritra", "twin", "blueboat", "rudder"):
        vessel = boat(name)
        values = dict(zip(Parameters(vessel).names, file_values(vessel), strict=True))
        for parameter, (low, high) in bands(vessel).items():
            assert low <= values[parameter] <= high, (name, parameter, values[parameter], (low, high))
    small = boat("aritra")
    large = replace(small, hull=replace(small.hull, length_m=2 * small.hull.length_m))
    assert without_dimension("M11_kg", 8.0, large) == pytest.approx(without_dimension("M11_kg", 1.0, small))
    assert without_dimension("N_rr_N_m_s2", 32.0, large) == pytest.approx(without_dimension("N_rr_N_m_s2", 1.0, small))
    assert without_dimension("lag_s", 1.0, small) is None
