"""Missions in GeoJSON: points and lines, and every error with its place."""

import json
import math

import pytest

from companion.core.geometry.frames import Origin
from companion.core.guidance.missions.mission import parse
from tests.companion.core.guidance.missions.mission_texts import ORIGIN, TURNED, errors


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
        (collection(feature(speed_m_s="1")), "features[0].properties.speed_m_s: expected a number"),
        (collection(feature(speed_m_s=0)), "features[0].geometry.coordinates: speed: expected above 0"),
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
        ('{"features": 3}', "features: expected a list"),
        ("nonsense", "(file): not valid JSON"),
    ],
)
def test_geojson_that_is_not_understood_says_where(text, expected):
    (found,) = errors(text, "geojson")
    assert found.startswith(expected)


def test_a_place_far_from_the_site_says_what_to_do():
    (found,) = errors(collection(feature(coordinates=(80.2338, 32.9916))), "geojson")
    assert "km from the site's origin" in found
    assert found.endswith("plan it there, or set lat_deg, lon_deg of the site file")


def test_latitude_and_longitude_exchanged_are_told_of():
    (found,) = errors(collection(feature(coordinates=(12.9916, 80.2338))), "geojson")
    assert found.endswith("lon_deg of the site file; it would be there with latitude and longitude exchanged")
    east = Origin(37.8, -122.4)
    (found,) = errors(collection(feature(coordinates=(37.8001, -122.4001))), "geojson", east)
    assert found.endswith("is not a position; it would be there with latitude and longitude exchanged")
