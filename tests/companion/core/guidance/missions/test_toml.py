"""Missions in TOML: headings and fences in site axes, and every error with its place."""

import math

import pytest

from companion.core.guidance.missions.mission import MissionFence, parse
from tests.companion.core.guidance.missions.mission_texts import errors


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


@pytest.mark.parametrize(("far", "fine"), [("10000", True), ("10001", False), ("-2e4", False), ("1e200", False)])
def test_a_fence_ends_where_a_plane_is_no_map_any_more(far, fine):
    """At 1e200 m the distance to it was nan: no place lay beyond it, and no boat."""
    text = f"""
    waypoints = [{{ north_m = 1, east_m = 2 }}]
    fences = [{{ inclusion = true, polygon = [[-5, -5], [-5, 5], [{far}, 5]] }}]
    """
    if fine:
        assert parse(text, "toml").fences
    else:
        assert errors(text, "toml") == ["fences[0]: has a corner more than 10000 m north or east of the site's origin"]


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
        "end_heading_deg: heading: expected -360 to 360 deg, found nan",
        "waypoints[0].speed: unknown key; did you mean speed_m_s?",
        "waypoints[1].east_m: missing key",
        "waypoints[2].east_m: expected a number, found text",
        "fences[0]: a fence needs at least 3 corners, not 2",
        "fences[1].inclusion: missing key",
        "waypoints[3]: position is not finite",
        "waypoints[4]: speed: expected above 0, at most 20, found -1",
    ]
    assert found == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("waypoint = []", "waypoint: unknown key; did you mean waypoints?"),
        ("name = 'x'", "waypoints: missing key"),
        ("a = ", "(file): not valid TOML: Invalid value (at "),
        ("waypoints = []", "(file): a path needs at least one waypoint"),
        (
            "end_heading_deg = 900\nwaypoints = [{north_m=1, east_m=1}]",
            "end_heading_deg: heading: expected -360 to 360 deg, found 900",
        ),
        (
            "waypoints = [{north_m=1, east_m=1}]\nfences = [{inclusion=true, polygon=[[0,0],[1,nan],[1,1]]}]",
            "fences[0]: has a corner that is not finite",
        ),
    ],
)
def test_toml_that_is_not_understood_says_where(text, expected):
    (found,) = errors(text, "toml")
    assert found.startswith(expected)
