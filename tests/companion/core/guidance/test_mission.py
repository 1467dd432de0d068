"""Mission files: four spellings of one path, pymavlink's loader as oracle, and every error with its place."""

import json
import math
from pathlib import Path as File

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.geometry.frames import Origin, geodetic_from_site
from companion.core.guidance.missions.mission import MissionErrors, MissionFence, kind_of, parse

FOLDER = File(__file__).resolve().parents[4] / "deploy"
ORIGIN = Origin(12.9915, 80.2337)
TURNED = Origin(12.9915, 80.2337, math.radians(30.0))
FILES = ["square.toml", "square.plan", "square.waypoints", "square.geojson"]


def errors(text, kind, origin=ORIGIN):
    with pytest.raises(MissionErrors) as caught:
        parse(text, kind, origin=origin)
    return [str(e) for e in caught.value.errors]


def item(command=16, latitude=12.9916, longitude=80.2338, frame=3, **params):
    values = [params.get(f"p{k}", 0) for k in range(1, 5)]
    return {
        "type": "SimpleItem",
        "command": command,
        "frame": frame,
        "params": [*values, latitude, longitude, 0],
        "autoContinue": params.get("auto", True),
    }


def plan(*items, **sections):
    return json.dumps({"fileType": "Plan", "version": 1, "mission": {"items": list(items)}, **sections})


def wpl(*rows):
    home = (1, 0, 16, 0, 0, 0, 0, 12.9915, 80.2337, 0, 1)
    lines = ["\t".join(map(str, (i, *row))) for i, row in enumerate([home, *rows])]
    return "\n".join(["QGC WPL 110", *lines, ""])


def point(north, east, origin=ORIGIN):
    return dict(zip(("latitude", "longitude"), geodetic_from_site(origin, north, east), strict=True))


# --- the square, four times ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", FILES)
def test_the_same_square_from_every_format(name):
    mission = parse((FOLDER / "missions" / name).read_text(), kind_of(name), origin=ORIGIN)
    expected = [(9, 9), (21, 9), (21, 21), (9, 21), (9, 12)]
    assert len(mission.path.points) == len(expected)
    for found, wanted in zip(mission.path.points, expected, strict=True):
        assert math.dist(found, wanted) < 0.01
    assert {w.speed_m_s for w in mission.path.waypoints} == {0.5}
    assert {w.acceptance_m for w in mission.path.waypoints} == {0.5}
    assert 45 - 0.01 < mission.path.length_m < 48
    assert (mission.end_heading_rad, mission.fences) == (None, ())


def test_the_squares_are_set_in_the_basin_of_the_site_file():
    from companion.core.configuration.site_file import load_site

    site = load_site((FOLDER / "sites" / "basin.toml").read_text(), name="basin.toml")
    assert (site.lat_deg, site.lon_deg, site.rotation_deg) == (ORIGIN.latitude_deg, ORIGIN.longitude_deg, 0.0)


# --- oracle: pymavlink --------------------------------------------------------------------------------


def loader_of(text, tmp_path):
    from pymavlink import mavwp

    file = tmp_path / "mission.waypoints"
    file.write_text(text)
    loader = mavwp.MAVWPLoader()
    loader.load(str(file))
    return loader


def test_pymavlink_reads_the_same_waypoints_and_what_it_writes_is_read_again(tmp_path):
    text = (FOLDER / "missions" / "square.waypoints").read_text()
    ours = parse(text, "waypoints", origin=ORIGIN).path.points
    loader = loader_of(text, tmp_path)
    theirs = [loader.wp(i) for i in range(1, loader.count()) if loader.wp(i).command == 16]
    assert len(theirs) == len(ours)
    for mine, w in zip(ours, theirs, strict=True):
        assert geodetic_from_site(ORIGIN, *mine) == pytest.approx((w.x, w.y), abs=1e-12)
    loader.save(str(tmp_path / "saved.waypoints"))  # with six decimals: 0.06 m
    again = parse((tmp_path / "saved.waypoints").read_text(), "waypoints", origin=ORIGIN).path
    assert again.waypoints[2].acceptance_m == 0.5
    for mine, back in zip(ours, again.points, strict=True):
        assert math.dist(mine, back) < 0.08


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.floats(-100, 100), st.floats(-100, 100)), min_size=1, max_size=5, unique=True))
def test_pymavlinks_own_files_survive_with_comments(tmp_path_factory, points):
    from pymavlink import mavutil, mavwp

    points = [(20.0 * i + n / 100, e) for i, (n, e) in enumerate(points)]
    loader = mavwp.MAVWPLoader()
    for k, p in enumerate([(0.0, 0.0), *points]):
        latitude, longitude = geodetic_from_site(TURNED, *p)
        arguments = (0, 0, k, 3, 16, 0, 1, 0, 1.5, 0, 0, latitude, longitude, 0)
        loader.add(mavutil.mavlink.MAVLink_mission_item_message(*arguments), comment=f"point {k}")
    file = tmp_path_factory.mktemp("wp") / "x.waypoints"
    loader.save(str(file))
    mission = parse(file.read_text(), "waypoints", origin=TURNED)
    for found, wanted in zip(mission.path.points, points, strict=True):
        assert math.dist(found, wanted) < 0.08
    assert {w.acceptance_m for w in mission.path.waypoints} == {1.5}


# --- what items mean ----------------------------------------------------------------------------------


def test_a_change_of_speed_holds_for_the_legs_after_it():
    text = plan(
        item(**point(1, 0)), item(178, p2=0.4), item(**point(5, 0)), item(178, p1=1, p2=0.7, p3=-1),
        item(178, p2=-1, p3=-1), item(**point(9, 0)),
    )  # fmt: skip
    assert [w.speed_m_s for w in parse(text, "plan", origin=ORIGIN).path.waypoints] == [None, 0.4, 0.7]


@pytest.mark.parametrize("command", [16, 17, 19])
def test_yaw_of_the_last_position_is_the_end_heading_from_the_sites_axis(command):
    text = plan(item(**point(1, 0)), item(command, p1=0 if command == 17 else 30, p4=90, **point(5, 0)))
    mission = parse(text, "plan", origin=TURNED)
    assert mission.end_heading_rad == pytest.approx(math.radians(60.0))


def test_nulls_are_parameters_not_given():
    one = item(**point(2, 3)) | {"params": [None, None, None, None, *point(2, 3).values(), None]}
    waypoint = parse(plan(one), "plan", origin=ORIGIN).path.waypoints[0]
    assert (waypoint.north_m, waypoint.east_m) == pytest.approx((2, 3), abs=1e-6)
    assert (waypoint.speed_m_s, waypoint.acceptance_m) == (None, None)


def test_fence_polygons_are_kept():
    corners = [(0, 0), (30, 0), (30, 30)]
    polygon = {"inclusion": True, "polygon": [geodetic_from_site(ORIGIN, *c) for c in corners], "version": 1}
    text = plan(item(), geoFence={"circles": [], "polygons": [polygon], "version": 2})
    (fence,) = parse(text, "plan", origin=ORIGIN).fences
    assert fence.inclusion
    for found, wanted in zip(fence.polygon, corners, strict=True):
        assert found == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (plan(item(), item(20)), ["mission.items[1]: command 20 NAV_RETURN_TO_LAUNCH is not supported"]),
        (plan(item(4711), item()), ["mission.items[0]: command 4711 is not supported"]),
        (
            plan(item(), {"type": "ComplexItem", "complexItemType": "survey", "anything": {}}),
            ["mission.items[1]: ComplexItem survey is not supported"],
        ),
        (plan(item(frame=1)), ["mission.items[0]: frame 1 is not supported"]),
        (plan(item(auto=False)), ["mission.items[0]: autocontinue off"]),
        (
            plan(item(p1=5), item(longitude=80.2339)),
            ["mission.items[0]: command 16 NAV_WAYPOINT: a hold time"],
        ),
        (plan(item(p3=2)), ["mission.items[0]: command 16 NAV_WAYPOINT: a pass-by radius"]),
        (plan(item(p4=9), item(longitude=80.2339)), ["mission.items[0]: command 16 NAV_WAYPOINT: a yaw"]),
        (plan(item(p2=-2)), ["mission.items[0]: acceptance radius must be a positive number, not -2"]),
        (
            plan(item(17), item(longitude=80.2339)),
            ["mission.items[0]: command 17 NAV_LOITER_UNLIM is supported"],
        ),
        (plan(item(17, p3=30)), ["mission.items[0]: command 17 NAV_LOITER_UNLIM: circling is not"]),
        (plan(item(178, p2=0), item()), ["mission.items[0]: command 178 DO_CHANGE_SPEED: speed must be"]),
        (
            plan(item(178, p1=2, p2=1), item()),
            ["mission.items[0]: command 178 DO_CHANGE_SPEED: speed type 2"],
        ),
        (plan(item(178, p2=1, p3=50), item()), ["mission.items[0]: command 178 DO_CHANGE_SPEED: a throttle"]),
        (
            plan(item(), item(178, p2=1)),
            ["mission.items[1]: command 178 DO_CHANGE_SPEED: no waypoint follows"],
        ),
        (plan(item(), item()), ["mission.items[1]: lies within 0.05 m of the waypoint before it"]),
        (plan(item(latitude=80.2, longitude=12.9)), ["mission.items[0]: is"]),
        (plan(item(latitude=None)), ["mission.items[0]: latitude None"]),
        (plan(item(latitude=91)), ["mission.items[0]: latitude 91"]),
        (plan(), ["(file): a path needs at least one waypoint"]),
        (
            plan({"type": "SimpleItem", "command": 16}),
            ["mission.items[0]: needs command, frame and 7 params"],
        ),
        (plan({"type": "SimpleItem", "command": "x"}), ["mission.items[0].command: Expected `int"]),
        (plan(item(), surprise=1), ["surprise: unknown key"]),
        (
            plan(item(), geoFence={"circles": [{}]}),
            ["geoFence.circles[0]: a circular fence is not supported"],
        ),
        (plan(item(), geoFence={"polygon": []}), ["geoFence.polygon: unknown key"]),
        (plan(item(), geoFence={"breachReturn": [1, 2, 3]}), ["geoFence.breachReturn: a return point"]),
        (
            plan(item(), geoFence={"polygons": [{"inclusion": True, "polygon": [[12.99, 80.23]]}]}),
            ["geoFence.polygons[0]: a fence needs at least 3 corners, not 1"],
        ),
        (plan(item(), rallyPoints={"points": [[1, 2, 3]]}), ["rallyPoints.points[0]: rally points are not"]),
        ('{"fileType": "Mission", "version": 1, "mission": {"items": []}}', ["(file): is a 'Mission'"]),
        ('{"version": 1}', ["fileType: missing key"]),
        ("{", ["(file): not valid JSON"]),
        (
            plan(item(20), item(21), item(frame=2)),
            ["mission.items[0]: command 20", "mission.items[1]: command 21", "mission.items[2]: frame 2"],
        ),
    ],
)
def test_a_plan_that_is_not_understood_says_where(text, expected):
    found = errors(text, "plan")
    assert len(found) == len(expected)
    for line, start in zip(found, expected, strict=True):
        assert line.startswith(start)


GOOD = (0, 3, 16, 0, 0, 0, 0, 12.9916, 80.2338, 0, 1)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "line 1: expected 'QGC WPL 110', found 'nothing'"),
        ("QGC WPL 100\n", "line 1: expected 'QGC WPL 110', found 'QGC WPL 100'"),
        (wpl(), "(file): a path needs at least one waypoint"),
        (wpl(GOOD[:-1]), "line 3 (item 1): expected 12 fields, found 11"),
        (
            wpl(GOOD, (0, 3, 20, *GOOD[3:])),
            "line 4 (item 2): command 20 NAV_RETURN_TO_LAUNCH is not supported",
        ),
        (wpl((0, 2, *GOOD[2:])), "line 3 (item 1): frame 2 is not supported"),
        (wpl((*GOOD[:-1], 0)), "line 3 (item 1): autocontinue off"),
        (
            wpl(GOOD).replace("12.9916", "north"),
            "line 3 (item 1): could not convert string to float: 'north'",
        ),
        (wpl(GOOD).replace("12.9916", "nan"), "line 3 (item 1): latitude None"),
        (wpl(GOOD).replace("\n1\t", "\n7\t"), "line 3 (item 1): has index 7"),
    ],
)
def test_a_waypoint_file_that_is_not_understood_says_which_line(text, expected):
    (found,) = errors(text, "waypoints")
    assert found.startswith(expected)


def feature(kind="Point", coordinates=(80.2338, 12.9916), **properties):
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": properties,
    }


def collection(*features, **more):
    return json.dumps({"type": "FeatureCollection", "features": list(features), **more})


def test_geojson_points_and_lines_follow_each_other():
    line = feature("LineString", [(80.2338, 12.9916, 3.0), (80.2338, 12.9917)], speed_m_s=0.3, stroke="#f00")
    end = feature(coordinates=(80.2339, 12.9917), acceptance_m=0.4, end_heading_deg=90, name="end")
    mission = parse(collection(line, end), "geojson", origin=TURNED)
    assert [w.speed_m_s for w in mission.path.waypoints] == [0.3, 0.3, None]
    assert [w.acceptance_m for w in mission.path.waypoints] == [None, None, 0.4]
    assert mission.end_heading_rad == pytest.approx(math.radians(60))
    alone = parse(json.dumps(feature()), "geojson", origin=ORIGIN)
    assert len(alone.path.points) == 1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (collection(feature("Polygon", [[]])), "features[0].geometry: Polygon is not supported"),
        (collection({"type": "Feature", "geometry": None}), "features[0].geometry: nothing is not supported"),
        (collection(feature(speed_ms=1)), "features[0].properties.speed_ms: unknown key"),
        (collection(feature(speed_m_s="1")), "features[0].properties.speed_m_s: Expected `float"),
        (collection(feature(speed_m_s=0)), "features[0].geometry.coordinates: speed must be"),
        (
            collection(feature("LineString", [[80.2338, 12.9916], [80.2338]])),
            "features[0].geometry.coordinates[1]: expected [longitude, latitude]",
        ),
        (collection(feature(coordinates=(12.9916, 80.2338))), "features[0].geometry.coordinates: is"),
        (collection(feature(coordinates=("a", "b"))), "features[0].geometry.coordinates: latitude b"),
        (
            collection(feature(end_heading_deg=1), feature(coordinates=(80.2339, 12.9916))),
            "features[0].properties.end_heading_deg: is supported only at the last",
        ),
        (collection(feature(), crs={"properties": {"name": "EPSG:3857"}}), "crs: only WGS84"),
        (collection(), "(file): a path needs at least one waypoint"),
        ('{"type": "Point"}', "type: expected FeatureCollection or Feature, found 'Point'"),
        ('{"features": 3}', "features: Expected `array`"),
        ("nonsense", "(file): not valid JSON"),
    ],
)
def test_geojson_that_is_not_understood_says_where(text, expected):
    (found,) = errors(text, "geojson")
    assert found.startswith(expected)


# --- our own format -----------------------------------------------------------------------------------


def test_toml_needs_no_origin_and_keeps_headings_and_fences_in_site_axes():
    text = """
    name = "there"
    end_heading_deg = 90
    waypoints = [{ north_m = 1, east_m = 2, acceptance_m = 0.3 }]
    [[fences]]
    inclusion = false
    polygon = [[0, 0], [1, 0], [1, 1]]
    """
    mission = parse(text, "toml")
    assert (mission.name, mission.path.points) == ("there", ((1.0, 2.0),))
    assert mission.end_heading_rad == pytest.approx(math.pi / 2)
    assert mission.fences == (MissionFence(False, ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))),)


def test_all_that_is_wrong_with_a_toml_file_is_told_at_once():
    text = """
    end_heading_deg = nan
    waypoints = [
        { north_m = 1, east_m = 2, speed = 0.3 },
        { north_m = 1 },
        { north_m = 1, east_m = "2" },
        { north_m = 4, east_m = inf },
        { north_m = 4, east_m = 5, speed_m_s = -1 },
    ]
    fences = [{ inclusion = true, polygon = [[0, 0], [1, 1]] }, { polygon = [] }]
    """
    found = errors(text, "toml")
    expected = [
        "end_heading_deg: heading is not a number: nan",
        "waypoints[0].speed: unknown key",
        "waypoints[1].east_m: missing key",
        "waypoints[2].east_m: Expected `float`, got `str`",
        "fences[0]: a fence needs at least 3 corners, not 2",
        "fences[1].inclusion: missing key",
        "waypoints[3]: position is not finite",
        "waypoints[4]: speed must be a positive number, not -1.0",
    ]
    assert found == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("waypoint = []", "waypoint: unknown key"),
        ("name = 'x'", "waypoints: missing key"),
        ("a = ", "(file): not valid TOML: Invalid value (at "),
        ("waypoints = []", "(file): a path needs at least one waypoint"),
        (
            "waypoints = [{north_m=1, east_m=1}]\nfences = [{inclusion=true, polygon=[[0,0],[1,nan],[1,1]]}]",
            "fences[0]: has a corner that is not finite",
        ),
    ],
)
def test_toml_that_is_not_understood_says_where(text, expected):
    (found,) = errors(text, "toml")
    assert found.startswith(expected)


# --- all formats --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FILES[1:])
def test_latitudes_without_a_site_are_an_error_at_each_waypoint(name):
    found = errors((FOLDER / "missions" / name).read_text(), kind_of(name), origin=None)
    assert len(found) == 5
    assert all("need the site's origin" in line for line in found)


def test_the_format_is_known_by_the_end_of_the_name():
    names = ["a.toml", "b.PLAN", "c.waypoints", "d.geojson", "e.json"]
    assert [kind_of(name) for name in names] == ["toml", "plan", "waypoints", "geojson", "geojson"]
    with pytest.raises(MissionErrors, match=r"a\.kml: is not a mission file: expected one of \.toml, \.plan"):
        kind_of("a.kml")


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(FILES), st.data())
def test_a_damaged_file_is_a_mission_or_errors_and_nothing_else(name, data):
    text = (FOLDER / "missions" / name).read_text()
    at = data.draw(st.integers(0, len(text)))
    cut = data.draw(st.integers(0, 12))
    damaged = text[:at] + data.draw(st.text(max_size=4)) + text[at + cut :]
    try:
        parse(damaged, kind_of(name), origin=ORIGIN)
    except MissionErrors as found:
        assert found.errors
