"""Scene and place on the earth, read back by Foxglove's own protobuf classes, not by the SDK that wrote them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

pytest.importorskip("foxglove", reason="the extra `shore` is not installed")

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from companion.core.geometry.frames import Origin, site_from_geodetic
from companion.core.messages import MissionPoint
from companion.core.telemetry import structs as shore
from companion.shore.foxglove.scene import location, scene
from tests.support.console_fixture import state

UNIX_NS = 1_790_000_000_500_000_000
FENCE = ((0.0, 0.0), (10.0, 0.0), (10.0, 8.0))
ISLAND = ((4.0, 1.0), (5.0, 1.0), (5.0, 2.0))


def about(**more) -> shore.About:
    told = {
        "vessel": "v", "site": "s", "configuration": "c", "software": "x", "unix_minus_t_ns": 0, "period_s": 0.1,
        "lat_deg": 12.99, "lon_deg": 80.23, "rotation_deg": 0.0, "thrusters": (),
        "anchors": (shore.AnchorAbout(id="A7", north_m=3.0, east_m=4.0),), "within": (FENCE,), "without": (ISLAND,),
        "commands": False, "length_m": 1.4, "beam_m": 0.8,
    } | more  # fmt: skip
    return shore.About(run="run1", t_ns=0, **told)


def drawn(sample, told=None) -> dict:
    """Entities by id, as a viewer has them."""
    made = scene(sample, told, UNIX_NS)
    assert made is not None
    found = {e.id: e for e in SceneUpdate.FromString(made.encode()).entities}
    assert {(e.frame_id, e.timestamp.seconds, e.timestamp.nanos) for e in found.values()} == {
        ("ned", 1_790_000_000, 500_000_000)
    }
    return found


def places(points) -> list[tuple[float, float]]:
    return [(p.x, p.y) for p in points]


def covariance(xx: float, xy: float, yy: float) -> tuple[float, ...]:
    triangle = [0.0] * 21
    triangle[0], triangle[1], triangle[6] = xx, xy, yy
    return tuple(triangle)


def in_ned(pose, points) -> np.ndarray:
    q, p = pose.orientation, pose.position
    turned = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([[a.x, a.y, a.z] for a in points])
    return turned + [p.x, p.y, p.z]


def test_fence_island_and_anchors_stand_where_the_site_has_them():
    found = drawn(about())
    assert [places(line.points) for line in found["fence"].lines] == [list(FENCE), list(ISLAND)]
    assert {line.type for line in found["fence"].lines} == {1}  # LINE_LOOP: closed
    inside, outside = (line.color for line in found["fence"].lines)
    assert inside != outside
    assert places(s.pose.position for s in found["anchors"].spheres) == [(3.0, 4.0)]
    assert [text.text for text in found["anchors"].texts] == ["A7"]


def test_the_path_goes_through_its_waypoints():
    points = tuple(MissionPoint(north_m=n, east_m=e) for n, e in FENCE)
    path = shore.PathNow(run="r", t_ns=0, name="m", waypoints=points, end_heading_rad=None, origin="run file")
    found = drawn(path)["path"]
    assert [places(line.points) for line in found.lines] == [list(FENCE)]
    assert found.lines[0].type == 0  # LINE_STRIP: open
    assert places(s.pose.position for s in found.spheres) == list(FENCE)


@given(psi=st.floats(-math.pi, math.pi))
def test_the_hull_has_its_size_and_its_bow_ahead(psi):
    hull = drawn(state(3, psi_rad=psi), about())["hull"]
    (rim,), (deck,) = hull.lines, hull.triangles
    for part in (rim, deck):
        ned = in_ned(part.pose, part.points) - [3.0, 2.0, 0.0]
        ahead = ned[:, :2] @ [math.cos(psi), math.sin(psi)]
        aside = ned[:, :2] @ [-math.sin(psi), math.cos(psi)]
        assert (ahead.max(), ahead.min()) == pytest.approx((0.7, -0.7), abs=1e-9)
        assert (aside.max(), aside.min()) == pytest.approx((0.4, -0.4), abs=1e-9)
        assert abs(aside[ahead.argmax()]) < 1e-9, "the bow is a point on the centre line"
        assert (ned[:, 2] <= 0.0).all(), "not below the water"
    assert 0 < hull.lifetime.seconds < 10, "a boat that is silent is not drawn for ever"
    corners = np.array([(p.x, p.y) for p in deck.points])[list(deck.indices)].reshape(-1, 3, 2)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    x, y = np.array([(p.x, p.y) for p in rim.points]).T
    outline_m2 = 0.5 * abs(x @ np.roll(y, 1) - y @ np.roll(x, 1))
    assert 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() == pytest.approx(outline_m2), "the deck is covered once"


def test_without_its_size_a_boat_has_no_hull_but_an_ellipse():
    for told in (None, about(length_m=None, beam_m=None)):
        assert set(drawn(state(3), told)) == {"ellipse"}


@given(a=st.floats(1e-3, 5.0), b=st.floats(1e-3, 5.0), turn=st.floats(-math.pi, math.pi))
def test_the_ellipse_holds_95_percent(a, b, turn):
    axes = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    c = axes @ np.diag([a**2, b**2]) @ axes.T
    (line,) = drawn(state(3, covariance=covariance(c[0, 0], c[0, 1], c[1, 1])))["ellipse"].lines
    offsets = np.array(places(line.points)) - [3.0, 2.0]
    d2 = np.einsum("ij,jk,ik->i", offsets, np.linalg.inv(c), offsets)
    assert 1.0 - np.exp(-d2 / 2) == pytest.approx(0.95, abs=1e-4)  # chi-squared with two degrees of freedom
    assert abs(offsets.sum()) < 1e-9 * len(offsets) + 1e-6, "all round"


@pytest.mark.parametrize("health", ["initialising", "lost"])
def test_a_boat_that_does_not_know_its_place_is_drawn_nowhere(health):
    assert scene(state(3, health=health), about(), UNIX_NS) is None
    assert location(state(3, health=health), about(), "v", UNIX_NS) is None


@given(
    lat=st.floats(-60, 60), lon=st.floats(-180, 180), turn=st.floats(-180, 180), psi=st.floats(-math.pi, math.pi),
    north=st.floats(-300, 300), east=st.floats(-300, 300),
)  # fmt: skip
def test_the_place_on_the_earth(lat, lon, turn, psi, north, east):
    sample = state(
        0, north_m=north, east_m=east, psi_rad=psi, u_m_s=1.0, v_m_s=-0.5, covariance=covariance(0.04, 0.01, 0.09)
    )
    made = location(sample, about(lat_deg=lat, lon_deg=lon, rotation_deg=turn), "boat", UNIX_NS)
    assert made is not None
    fix = LocationFix.FromString(made.encode())
    origin = Origin(lat, lon, math.radians(turn))
    assert site_from_geodetic(origin, fix.latitude, fix.longitude) == pytest.approx((north, east), abs=1e-6)
    assert fix.frame_id == "boat"
    heading = math.radians(turn) + psi
    assert math.cos(fix.heading - heading) == pytest.approx(1.0)
    true_north = np.array([math.cos(heading) * 1.0 + math.sin(heading) * 0.5,
                           math.sin(heading) * 1.0 - math.cos(heading) * 0.5])  # fmt: skip
    assert (fix.velocity.y, fix.velocity.x) == pytest.approx(tuple(true_north), abs=1e-9)
    c = np.array(fix.position_covariance).reshape(3, 3)
    assert c == pytest.approx(c.T)
    r = math.radians(turn)
    ahead = np.array([math.sin(r), math.cos(r), 0.0])  # the site's first axis in east, north, up
    aside = np.array([math.cos(r), -math.sin(r), 0.0])
    assert (ahead @ c @ ahead, ahead @ c @ aside, aside @ c @ aside) == pytest.approx((0.04, 0.01, 0.09))
    assert fix.position_covariance_type == 1  # APPROXIMATED: the height is not known
