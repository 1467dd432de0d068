"""The fence: distance against brute force, levels for any simple polygon, crossings found."""

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.core.configuration.site_file import load_site
from companion.core.configuration.tables import ConfigError
from companion.core.geometry.fence import Fence, clearance, crossing

SQUARE = ((0.5, 0.5), (29.5, 0.5), (29.5, 29.5), (0.5, 29.5))
HOOK = ((0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (7.0, 6.0), (7.0, 3.0), (3.0, 3.0), (3.0, 10.0), (0.0, 10.0))
"""A U with unequal arms: one pocket in its hull, whose own hull has a pocket no more."""
SPIRAL = ((0, 0), (12, 0), (12, 12), (2, 12), (2, 4), (8, 4), (8, 8), (5, 8), (5, 7), (7, 7), (7, 5), (3, 5), (3, 11),
          (11, 11), (11, 1), (0, 1))  # fmt: skip
"""A lane rolled up: pockets in pockets."""
SHAPES = {"square": SQUARE, "hook": HOOK, "spiral": SPIRAL}
QUICK = settings(max_examples=60, deadline=None, derandomize=True)


def winding(corners, north, east):
    """Inside by the winding number, which shares nothing with the even-odd rule: angles add up to a turn."""
    away = np.array(corners, dtype=float) - (north, east)
    angle = np.arctan2(away[:, 1], away[:, 0])
    turned = (np.roll(angle, -1) - angle + np.pi) % (2 * np.pi) - np.pi
    return abs(turned.sum()) > np.pi


def sampled(corners, north, east):
    """Distance to the outline by points on it, 30 mm apart at most."""
    start, end = np.array(corners, dtype=float), np.roll(np.array(corners, dtype=float), -1, axis=0)
    lines = start[:, None] + np.linspace(0, 1, 1001)[:, None] * (end - start)[:, None]
    return np.linalg.norm(lines - (north, east), axis=2).min()


@pytest.mark.parametrize("corners", SHAPES.values(), ids=SHAPES)
@QUICK
@given(st.floats(-3, 33), st.floats(-3, 33))
def test_clearance_is_the_distance_with_the_sign_of_the_winding_number(corners, north, east):
    found = clearance(np.array(corners, dtype=float), np.array([[north, east]]))[0]
    assert abs(found) == pytest.approx(sampled(corners, north, east), abs=0.02)
    if abs(found) > 1e-6:
        assert (found > 0) == winding(corners, north, east)


@pytest.mark.parametrize("turned", [1, -1])
@pytest.mark.parametrize("corners", SHAPES.values(), ids=SHAPES)
@QUICK
@given(st.floats(-3, 33), st.floats(-3, 33))
def test_levels_are_positive_exactly_inside_and_never_promise_more_room_than_there_is(corners, turned, north, east):
    fence = Fence((corners[::turned],))
    least = min(level(north, east) for level in fence.levels(min))
    truth = fence.clearance(north, east)
    assume(abs(truth) > 1e-9)
    assert (least > 0) == (truth > 0)
    if truth > 0:
        assert least <= truth + 1e-9
    else:
        assert least >= truth - 1e-9, "beyond the fence never worse than it is"


def star(angles, radii):
    return tuple((float(r * np.cos(a)), float(r * np.sin(a))) for a, r in zip(np.cumsum(angles), radii, strict=True))


@QUICK
@given(st.integers(3, 12), st.data())
def test_levels_of_any_star_shaped_fence(k, data):
    gaps = np.array(data.draw(st.lists(st.floats(0.3, 1.0), min_size=k, max_size=k)))
    corners = star(2 * np.pi * gaps / gaps.sum(), data.draw(st.lists(st.floats(1.0, 10.0), min_size=k, max_size=k)))
    assume(crossing(corners) is None and np.pi > (2 * np.pi * gaps / gaps.sum()).max())
    place = data.draw(st.tuples(st.floats(-10, 10), st.floats(-10, 10)))
    fence = Fence((corners,))
    truth = fence.clearance(*place)
    assume(abs(truth) > 1e-6)
    assert (min(level(*place) for level in fence.levels(min)) > 0) == (truth > 0)


def tip(degrees: float, length_m: float = 8.0):
    """A triangle with a tip at (15, 20), its foot at north 15, east 28."""
    half_m = length_m * np.tan(np.deg2rad(degrees / 2))
    return ((15.0 + half_m, 20.0 + length_m), (15.0, 20.0), (15.0 - half_m, 20.0 + length_m))


def jetty(degrees: float):
    """A fence whose east side is the same triangle, cut out."""
    return (*SQUARE[:2], *tip(degrees))


@pytest.mark.parametrize("degrees", [1.0, 3.0, 14.0, 28.0, 58.0])
@pytest.mark.parametrize(
    "fence_of", [lambda d: Fence((SQUARE,), (tip(d),)), lambda d: Fence((jetty(d),))], ids=["zone", "jetty"]
)
def test_beyond_a_sharp_tip_levels_say_what_room_there_is(fence_of, degrees):
    fence = fence_of(degrees)
    for off_m in (0.1, 0.6, 2.0, 5.0):
        assert min(level(15.0, 20.0 - off_m) for level in fence.levels(min)) == pytest.approx(off_m)
    for angle in np.linspace(-np.pi / 2, np.pi / 2, 41):
        place = 15.0 + 4.0 * np.sin(angle), 20.0 - 4.0 * np.cos(angle)
        least = min(level(*place) for level in fence.levels(min))
        assert 0.7 * fence.clearance(*place) <= least <= fence.clearance(*place) + 1e-9


@QUICK
@given(st.floats(0.5, 29.5), st.floats(0.5, 29.5), st.floats(1.0, 58.0))
def test_levels_at_sharp_tips_are_positive_exactly_inside(north, east, degrees):
    for fence in (Fence((SQUARE,), (tip(degrees),)), Fence((jetty(degrees),))):
        truth = fence.clearance(north, east)
        if abs(truth) > 1e-6:
            least = min(level(north, east) for level in fence.levels(min))
            assert (least > 0) == (truth > 0) and (least <= truth + 1e-9 or truth < 0)


@QUICK
@given(st.floats(0.5, 29.5), st.floats(0.5, 29.5))
def test_without_a_sharp_tip_levels_are_those_of_the_edges(north, east):
    """An L, whose pocket is a triangle of 45 degrees, and a square to stay out of."""
    ell = ((0.0, 0.0), (30.0, 0.0), (30.0, 10.0), (10.0, 10.0), (10.0, 30.0), (0.0, 30.0))
    zone = ((2.0, 2.0), (4.0, 2.0), (4.0, 4.0), (2.0, 4.0))
    levels = [level(north, east) for level in Fence((ell,), (zone,)).levels(min)]
    assert levels[-1] == max(north - 4.0, 2.0 - north, east - 4.0, 2.0 - east), "to the bit"
    pocket = max(10.0 - north, 10.0 - east, (north + east - 40.0) / np.sqrt(2.0))
    assert min(abs(level - pocket) for level in levels) < 1e-9


def test_levels_have_slope_one_for_casadi_too():
    x = ca.SX.sym("x", 2)
    levels = Fence((HOOK,), without=(((1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)),)).levels(ca.fmin)
    slopes = ca.Function("slopes", [x], [ca.jacobian(ca.vertcat(*(level(x[0], x[1]) for level in levels)), x)])
    for place in ((0.7, 0.9), (9.0, 2.0), (1.5, 8.0), (5.0, 4.0)):
        assert np.linalg.norm(np.array(slopes(place)), axis=1) == pytest.approx(np.ones(len(levels)))


def test_what_to_stay_out_of_counts_the_other_way_round():
    fence = Fence((SQUARE,), without=(((10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0)),))
    for place, room in (((5.0, 5.0), 4.5), ((9.0, 15.0), 1.0), ((15.0, 15.0), -5.0), ((31.0, 15.0), -1.5)):
        assert fence.clearance(*place) == pytest.approx(room)
        least = min(level(*place) for level in fence.levels(min))
        assert (least > 0) == (room > 0) and least == pytest.approx(room, abs=0.7)


@QUICK
@given(st.data())
def test_the_least_clearance_on_a_line_is_that_of_its_nearest_place(data):
    """Oracle: clearances 15 mm apart."""
    fence = Fence((HOOK,), without=(((8.0, 1.0), (9.0, 1.0), (8.5, 2.5)),))
    start, end = (data.draw(st.tuples(st.floats(0.1, 9.9), st.floats(0.1, 5.9))) for _ in range(2))
    assume(np.hypot(*np.subtract(end, start)) > 0.1)
    places = np.array(start) + np.linspace(0, 1, 801)[:, None] * np.subtract(end, start)
    least = fence.clearances(places).min()
    found = fence.least_clearance(start, end)
    assert found == pytest.approx(least, abs=0.02) or (found <= 0.0 and least < 0.02)


@pytest.mark.parametrize(
    ("corners", "edges"),
    [
        (SQUARE, None),
        (HOOK, None),
        (SPIRAL, None),
        (((0, 0), (4, 4), (4, 0), (0, 4)), (0, 2)),
        (((0, 0), (4, 0), (4, 4), (4, 0)), (0, 2)),
        (((0, 0), (0, 0), (4, 4)), (0, 1)),
        (((0, 0), (4, 0), (4, 4), (0, 0)), (0, 2)),
    ],
    ids=["square", "hook", "spiral", "bow tie", "spike", "twice", "closed twice"],
)
def test_a_fence_that_crosses_itself_is_found(corners, edges):
    assert crossing(corners) == edges


def test_a_site_whose_fence_crosses_itself_is_refused_with_file_and_key():
    text = 'name="x"\nlat_deg=0.0\nlon_deg=0.0\nsource="assumed"\nfence=[[0,0],[4,4],[4,0],[0,4]]\n'
    with pytest.raises(ConfigError, match=r"pond\.toml: fence: .*corner 0.*corner 2"):
        load_site(text, name="pond.toml")


@pytest.mark.parametrize("corners", SHAPES.values(), ids=SHAPES)
def test_a_line_crosses_where_a_place_on_it_is_beyond(corners):
    """Lines between places inside, seed 4; of some 2000 places on each."""
    fence, rng = Fence((corners,)), np.random.default_rng(4)
    places = rng.uniform(0, 30 if corners is SQUARE else 12, (300, 2))
    inside = places[clearance(np.array(corners), places) > 0.05]
    found = []
    for start, end in pairwise(inside[:60]):
        least_m = clearance(np.array(corners), start + np.linspace(0, 1, 2001)[:, None] * (end - start)).min()
        if abs(least_m) > 0.01:
            assert fence.is_crossed(tuple(start), tuple(end)) == (least_m < 0)
            found.append(least_m < 0)
    assert len(found) > 15 and any(found) != (corners is SQUARE)
