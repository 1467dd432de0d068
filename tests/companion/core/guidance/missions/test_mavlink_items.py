"""Missions of MAVLink items (.plan, .waypoints): what items mean, and every error with its place."""

import json
import math

import pytest

from companion.core.geometry.frames import Origin, geodetic_from_site
from companion.core.guidance.missions.mission import parse
from tests.companion.core.guidance.missions.mission_texts import ORIGIN, TURNED, errors


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


def test_a_heading_at_the_end_stays_within_one_turn_however_the_site_is_turned():
    site = Origin(ORIGIN.latitude_deg, ORIGIN.longitude_deg, math.radians(-30.0))
    mission = parse(plan(item(p4=350)), "plan", origin=site)  # 380 deg would be refused where it is written to TOML
    assert mission.end_heading_rad == pytest.approx(math.radians(20.0))


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
        (
            plan(item(), item(20)),
            [
                "mission.items[1]: command 20 NAV_RETURN_TO_LAUNCH is not supported: delete the item; "
                "the boat keeps station at the last waypoint"
            ],
        ),
        (plan(item(4711), item()), ["mission.items[0]: command 4711 is not supported: delete the item"]),
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
        (plan(item(p2=-2)), ["mission.items[0]: acceptance radius: expected above 0, at most 100, found -2"]),
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
        (plan({"type": "SimpleItem", "command": "x"}), ["mission.items[0].command: expected a whole number"]),
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
        (
            wpl(GOOD).replace("0\t1\t0\t16", "0\t1\t3\t16"),
            "line 2 (item 0): is command 16 NAV_WAYPOINT in frame 3, not home",
        ),
        (
            wpl(GOOD).replace("0\t1\t0\t16", "0\t1\t0\t178"),
            "line 2 (item 0): is command 178 DO_CHANGE_SPEED in frame 0",
        ),
    ],
)
def test_a_waypoint_file_that_is_not_understood_says_which_line(text, expected):
    (found,) = errors(text, "waypoints")
    assert found.startswith(expected)


def test_a_fence_that_repeats_its_first_corner_says_what_to_do():
    corners = [geodetic_from_site(ORIGIN, *c) for c in ((0, 0), (30, 0), (30, 30), (0, 0))]
    (found,) = errors(plan(item(), geoFence={"polygons": [{"inclusion": True, "polygon": corners}]}), "plan")
    assert found.endswith("corner 0 and corner 2 touch: give each corner once, in order along the fence")
