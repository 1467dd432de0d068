"""Ways of connecting thrusters: which are tried, what each does to B, and that doing it twice undoes it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Wash
from companion.core.model.thrusters import configuration_matrix, force_from_pwm
from sim.fitting.wiring.thrusters import exchanged, restored, reversed_ones, ways
from tests.support.vessel_fixtures import boat

BOAT, TWIN = boat("aritra"), boat("twin")
NAMES = [t.name for t in BOAT.thrusters]
X, Y, N = range(3)


def by_name(vessel):
    return {way.name: way for way in ways(vessel)}


def test_the_reference_boat_has_these_single_faults():
    single = [way.name for way in ways(BOAT) if way.faults == 1]
    assert sum(name.startswith("swapped:") for name in single) == 6
    assert sum(name.startswith("reversed:") for name in single) == 5
    assert [name for name in single if name.startswith("mirrored:")] == [
        "mirrored:port_starboard", "mirrored:fore_aft", "mirrored:both",
    ]  # fmt: skip
    assert ways(BOAT)[0].vessel == BOAT and ways(BOAT)[0].faults == 0


def test_two_thrusters_mirrored_are_two_swapped():
    assert [way.name for way in ways(TWIN) if way.faults == 1] == [
        "reversed:port", "reversed:starboard", "reversed:all", "swapped:port+starboard", "dead:port", "dead:starboard",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "signs"),
    [("mirrored:port_starboard", (1, -1, -1)), ("mirrored:fore_aft", (1, -1, 1)), ("mirrored:both", (1, 1, -1))],
)
def test_what_a_mirrored_boat_does_with_each_force_asked_for(name, signs):
    """45 degrees in X: mirrored sides turn sway and yaw round, fore with aft sway alone, both together yaw alone."""
    asked = np.linalg.pinv(configuration_matrix(BOAT))
    got = configuration_matrix(by_name(BOAT)[name].vessel) @ asked
    np.testing.assert_allclose(got, np.diag(signs), atol=1e-12)


@given(st.permutations(NAMES), st.sets(st.sampled_from(NAMES)))
def test_changed_places_and_turned_thrusters_keep_names_and_go_back(order, turned):
    moves = dict(zip(NAMES, order, strict=True))
    back = {there: name for name, there in moves.items()}
    washed = replace(
        BOAT, propulsion=replace(BOAT.propulsion, wash=(Wash(behind=NAMES[0], ahead=NAMES[2], share=0.1),))
    )
    moved = reversed_ones(exchanged(washed, moves, "why"), sorted(turned), "why")
    assert [(t.name, t.channel) for t in moved.thrusters] == [(t.name, t.channel) for t in BOAT.thrusters]
    for t in moved.thrusters:
        place = next(b for b in BOAT.thrusters if b.name == moves[t.name])
        assert (t.x_m, t.y_m, t.azimuth_deg, t.mirrored) == (
            place.x_m, place.y_m, place.azimuth_deg, t.name in turned,
        )  # fmt: skip
    assert exchanged(reversed_ones(moved, sorted(turned), "why"), back, "why").propulsion == washed.propulsion
    assert restored(moved, washed) == washed
    plain = exchanged(reversed_ones(exchanged(washed, moves, ""), [], ""), back, "")
    np.testing.assert_array_equal(configuration_matrix(plain), configuration_matrix(washed))


def test_a_turned_thruster_pushes_as_hard_the_other_way():
    one, fmap = BOAT.thrusters[0], BOAT.force_maps["t200"]
    turned = reversed_ones(BOAT, [one.name], "").thrusters[0]
    assert force_from_pwm(turned, fmap, 1300.0, 15.0) == force_from_pwm(one, fmap, 1700.0, 15.0) > 0


def test_thrusters_in_one_line_that_push_alike_are_no_two_ways():
    ship = boat("cse1")
    assert "swapped:port_sway+starboard_sway" not in by_name(ship)
