"""`aritra log export --foxglove`: an MCAP that the mcap library reads, with what Foxglove's panels show."""

import math

import pytest

pytest.importorskip("foxglove", reason="the extra `shore` is not installed")

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader

from companion.core.geometry.frames import Origin, site_from_geodetic
from companion.core.messages import StateEstimate
from companion.logs.configuration import setup_in
from companion.logs.log_file import LogFile
from tests.companion.command_line import exit_code
from tests.companion.logs.page.page_logs import page_log


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return page_log(tmp_path_factory.mktemp("foxglove"))


def run(*argv: object) -> int:
    return exit_code("log", "export", *argv)


def read(path, topic: str, kind) -> list:
    with path.open("rb") as file:
        return [(m.log_time, kind.FromString(m.data)) for _, _, m in make_reader(file).iter_messages(topics=[topic])]


def test_the_scene_and_the_track_on_the_earth_are_those_of_the_log(log, tmp_path, capsys):
    out = tmp_path / "out.mcap"
    assert run(log, "--foxglove", "--out", out) == 0
    assert f"wrote {out}" in capsys.readouterr().out
    logged = LogFile(log)
    estimates = {x.t_ns + logged.wall_offset_ns: x for x in logged.messages(StateEstimate)}
    site = setup_in(logged).pilot.site
    origin = Origin(site.lat_deg, site.lon_deg, math.radians(site.rotation_deg))
    fixes = read(out, "/aritra/location", LocationFix)
    assert len(fixes) > 100
    for t_ns, fix in fixes:
        estimate = estimates[t_ns]
        assert isinstance(estimate, StateEstimate)
        place = site_from_geodetic(origin, fix.latitude, fix.longitude)
        assert place == pytest.approx((estimate.north_m, estimate.east_m), abs=1e-3)
    entities = {e.id: e for _, update in read(out, "/aritra/scene", SceneUpdate) for e in update.entities}
    assert set(entities) == {"fence", "anchors", "path", "hull", "ellipse"}
    assert [(p.x, p.y) for p in entities["fence"].lines[0].points] == [tuple(c) for c in site.fence]
    assert [t.text for t in entities["anchors"].texts] == [a.id for a in site.anchors]
    path = setup_in(logged).pilot.mission.path
    assert [(p.x, p.y) for p in entities["path"].lines[0].points] == [(w.north_m, w.east_m) for w in path.waypoints]


def test_a_file_that_is_there_stays_as_it_is(log, tmp_path, capsys):
    out = tmp_path / "mine.mcap"
    out.write_text("mine")
    assert run(log, "--foxglove", "--out", out) == 2
    assert "mine.mcap: exists already: choose another name, or move it away" in capsys.readouterr().err
    assert out.read_text() == "mine"


def test_a_place_that_cannot_be_written_is_named(log, tmp_path, capsys):
    out = tmp_path / "absent" / "x.mcap"
    assert run(log, "--foxglove", "--out", out) == 2
    assert f"{out}: " in capsys.readouterr().err.replace("\n", "")


def test_options_that_say_nothing_are_refused(log, tmp_path, capsys):
    assert run(log, "--foxglove", "--out", tmp_path / "x.mcap", "--truth", log) == 2
    assert "--truth says nothing to --foxglove" in capsys.readouterr().err
