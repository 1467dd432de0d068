"""Missions: four spellings of one path, pymavlink's loader as oracle, and damaged files of every format."""

import math
from pathlib import Path as File

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.geometry.frames import geodetic_from_site
from companion.core.guidance.missions.mission import MissionErrors, kind_of, parse
from tests.companion.core.guidance.missions.mission_texts import ORIGIN, TURNED, errors

FOLDER = File(__file__).resolve().parents[5] / "deploy"
FILES = ["square.toml", "square.plan", "square.waypoints", "square.geojson"]


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
        arguments = (0, 0, k, 3 if k else 0, 16, 0, 1, 0, 1.5, 0, 0, latitude, longitude, 0)
        loader.add(mavutil.mavlink.MAVLink_mission_item_message(*arguments), comment=f"point {k}")
    file = tmp_path_factory.mktemp("wp") / "x.waypoints"
    loader.save(str(file))
    mission = parse(file.read_text(), "waypoints", origin=TURNED)
    for found, wanted in zip(mission.path.points, points, strict=True):
        assert math.dist(found, wanted) < 0.08
    assert {w.acceptance_m for w in mission.path.waypoints} == {1.5}


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
