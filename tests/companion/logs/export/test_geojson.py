"""The track on the earth: it comes back to the metre axes it left, and says what it does not know."""

import json
import math
from itertools import pairwise

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.boat.recorder import Recorder
from companion.cli import log as log_cli
from companion.core import messages as m
from companion.core.configuration.site_file import load_site
from companion.core.configuration.tables import ConfigError
from companion.core.geometry.frames import Origin, site_from_geodetic
from companion.logs.export import command
from companion.logs.export.geojson import collection, features
from companion.logs.log_file import LogError, LogFile
from companion.logs.metadata import log_metadata
from companion.logs.schema import KINDS

SITE = """
name = "pond"
lat_deg = {lat}
lon_deg = {lon}
rotation_deg = {turn}
fence = [[-2.0, -2.0], [12.0, -2.0], [12.0, 12.0], [-2.0, 12.0]]
source = "assumed"
[[anchors]]
id = "A1"
north_m = 3.0
east_m = 4.0
down_m = -2.5
source = "assumed"
"""


def estimate(t_s: float, north_m: float, east_m: float, health: m.Health = "healthy", psi_rad: float = 0.0):
    return m.StateEstimate(
        t_ns=round(t_s * 1e9), north_m=north_m, east_m=east_m, psi_rad=psi_rad, u_m_s=0.5, v_m_s=0.0, r_rad_s=0.0,
        covariance=(0.01,) * 36, accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={},
        disturbance_n=(0.0, 0.0, 0.0), health=health, reason="",
    )  # fmt: skip


def record(path, *messages, site: str | None = SITE.format(lat=12.9915, lon=80.2337, turn=30.0)) -> LogFile:
    path.unlink(missing_ok=True)
    metadata = log_metadata("synthetic", {"site.toml": site} if site else {})
    with Recorder(path, metadata, lambda: 0, wall_offset_ns=1_790_000_000_000_000_000) as recorder:
        for message in messages:
            recorder.record(message)
    return LogFile(path)


def of(found, kind: str) -> list:
    return [f for f in found if f["properties"]["kind"] == kind]


@settings(max_examples=15, deadline=None)  # each writes a file
@given(
    lat=st.floats(-60, 60), lon=st.floats(-180, 180), turn=st.floats(-180, 180),
    places=st.lists(st.tuples(st.floats(-300, 300), st.floats(-300, 300)), min_size=2, max_size=20),
)  # fmt: skip
def test_places_come_back_to_two_millimetres(tmp_path_factory, lat, lon, turn, places):
    path = tmp_path_factory.mktemp("round") / "t.mcap"
    log = record(
        path, *(estimate(k / 10, *p) for k, p in enumerate(places)), site=SITE.format(lat=lat, lon=lon, turn=turn)
    )
    (track,) = of(features(log), "track")
    origin = Origin(lat, lon, math.radians(turn))
    back = [site_from_geodetic(origin, at[1], at[0]) for at in track["geometry"]["coordinates"]]
    assert back == [pytest.approx(p, abs=2e-3) for p in places]


def test_the_line_breaks_where_the_boat_was_lost_or_the_log_has_a_gap(tmp_path):
    log = record(
        tmp_path / "t.mcap",
        estimate(0.0, 0.0, 0.0, "initialising"),
        *(estimate(t, t, 0.0) for t in (1.0, 1.5)),
        estimate(2.0, 99.0, 99.0, "lost"),
        *(estimate(t, t, 0.0, "degraded") for t in (2.5, 3.0)),
        *(estimate(t, t, 0.0) for t in (5.0, 5.5)),
    )
    pieces = [f["geometry"]["coordinates"] for f in of(features(log), "track")]
    assert [len(piece) for piece in pieces] == [2, 2, 2]


def test_points_tell_time_heading_from_true_north_and_mode(tmp_path):
    log = record(
        tmp_path / "t.mcap",
        m.ModeStatus(t_ns=0, mode="auto", why="", driving=True),
        *(estimate(k / 10, 0.0, 0.0, psi_rad=-math.pi / 2) for k in range(25)),
        m.Alert(t_ns=1_200_000_000, level="warning", text="leak"),
    )
    states = of(features(log), "state")
    assert [s["properties"]["t_s"] for s in states] == [0.0, 1.0, 2.0]
    told = states[0]["properties"]
    assert told["heading_deg"] == pytest.approx(300.0)  # site axes are turned by 30 degrees
    assert (told["mode"], told["time"][:4]) == ("auto", "2026")
    (alert,) = of(features(log), "alert")
    assert (alert["properties"]["text"], alert["properties"]["t_s"]) == ("leak", 1.2)


def test_the_file_is_geojson_as_rfc_7946_has_it(tmp_path):
    log = record(tmp_path / "t.mcap", estimate(0.0, 0.0, 0.0), estimate(0.1, 1.0, 1.0))
    text = collection("run", features(log), msgspec.json.encode)
    whole = json.loads(text)
    assert (whole["type"], whole["name"]) == ("FeatureCollection", "run")
    assert "crs" not in whole
    (fence,) = of(whole["features"], "fence")
    (ring,) = fence["geometry"]["coordinates"]
    assert ring[0] == ring[-1]
    area = sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in pairwise(ring))
    assert area > 0  # counterclockwise
    for feature in whole["features"]:
        assert set(feature) == {"type", "geometry", "properties"}
    (anchor,) = of(whole["features"], "anchor")
    assert anchor["geometry"]["coordinates"] == [pytest.approx(80.2337, abs=1e-3), pytest.approx(12.9915, abs=1e-3)]


def test_a_run_without_a_place_on_the_earth_says_what_to_give(tmp_path):
    log = record(tmp_path / "t.mcap", estimate(0.0, 0.0, 0.0), site=None)
    with pytest.raises(LogError, match=r"t\.mcap: holds no site file.*--site FILE"):
        features(log)
    site = load_site(SITE.format(lat=1, lon=2, turn=0), name="s")
    assert of(features(log, site), "fence")


def test_a_site_that_this_version_refuses_is_not_taken_for_none(tmp_path):
    with pytest.raises(ConfigError, match=r"t\.mcap: site\.toml"):
        features(record(tmp_path / "t.mcap", estimate(0.0, 0.0, 0.0), site="schema = 99"))


def test_a_log_without_estimates_has_no_track(tmp_path):
    with pytest.raises(LogError, match="no estimate of a place"):
        features(record(tmp_path / "t.mcap", m.Tick(t_ns=0, index=0)))


def test_estimates_of_another_version_are_the_reason_that_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(KINDS, "/state_estimate", m.ModeStatus)
    log = record(tmp_path / "a.mcap", estimate(0.0, 0.0, 0.0), estimate(0.1, 0.1, 0.0))
    with pytest.raises(LogError, match=r"no track; .*/state_estimate: 2 messages do not fit their class"):
        features(log)


def test_the_command_writes_the_file_and_tells_a_bad_site(tmp_path, capsys):
    log = record(tmp_path / "t.mcap", estimate(0.0, 0.0, 0.0), estimate(0.1, 1.0, 1.0))
    out = tmp_path / "t.geojson"
    assert command.export_track(log.path, out) == log_cli.OK
    assert "features" in capsys.readouterr().out
    assert json.loads(out.read_text())["features"]
    with pytest.raises(LogError, match=r"absent\.toml: No such file"):
        command.export_track(log.path, tmp_path / "u.geojson", site=tmp_path / "absent.toml")
