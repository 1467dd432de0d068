"""A site whose axes are turned from true north: an autopilot knows true headings only, all else is in site axes."""

import math

import msgspec
import numpy as np
import pytest

from companion.boat.load_run import EXAMPLES, load_setup, setup_of
from companion.core.geometry.frames import ssa
from companion.core.messages import Attitude, GroundTruth
from companion.core.pilot.pilot import Pilot
from companion.logs.readers.aritra import attitude_row, attitude_stream
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup
from tests.support.drive_fixture import CORNER, START, figures, mission_text, nmpc, settled

pytestmark = pytest.mark.long

TURNED_DEG = 30.0


@pytest.fixture(scope="module")
def turned():
    """The corner driven in a basin whose first axis points so; seed 1."""
    texts = {**load_setup(EXAMPLES / "aritra.toml").files, "mission.toml": mission_text(CORNER)}
    texts["site.toml"] = texts["site.toml"].replace("rotation_deg = 0.0", f"rotation_deg = {TURNED_DEG}")
    setup = setup_of(texts, {name: name for name in texts}).pilot
    assert setup.site.rotation_deg == TURNED_DEG
    run = SteppedRun(World(WorldSetup(setup.vessel, setup.site, start=START), 1), Pilot(setup), nmpc().solve)
    assert run.run(settled(4.0), 90.0), f"not done: {run.state.guidance.phase}, {run.state.helm}"
    return run


def test_the_boat_drives_as_well_as_where_the_axes_point_north(turned):
    got = figures(turned, CORNER)
    assert got["cross_track_rms_m"] <= 0.15 and got["position_rmse_m"] <= 0.2 and got["heading_rmse_deg"] <= 2.0


def test_the_autopilot_tells_true_headings_and_a_fit_reads_those_of_the_site(turned):
    told, truth = turned.of(Attitude), turned.of(GroundTruth)
    at_s = [m.t_ns * 1e-9 for m in told]
    true = np.interp(at_s, [m.t_ns * 1e-9 for m in truth], np.unwrap([m.psi_rad for m in truth]))
    assert off_deg([m.psi_rad for m in told], true) == pytest.approx(TURNED_DEG, abs=3.0)
    site = msgspec.structs.replace(load_setup(EXAMPLES / "aritra.toml").pilot.site, rotation_deg=TURNED_DEG)
    read = attitude_stream([attitude_row(m) for m in told], site).columns["psi_rad"]
    assert off_deg(read, true) == pytest.approx(0.0, abs=3.0)


def off_deg(psi, true):
    """Median difference of headings [deg]."""
    return math.degrees(np.median([ssa(a - b) for a, b in zip(psi, true, strict=True)]))
