"""Missions on a real ArduPilot in software: what matters of them, where ARDUROVER names one."""

import math
from contextlib import closing
from pathlib import Path

import pytest

from sim.world.sitl.firmware_world import FirmwareSetup, FirmwareStopped, FirmwareWorld
from sim.world.world import WorldSetup
from tests.evidence.main_job.parts import drive_mission, reference_boat
from tests.support.autopilots.firmware_rig import binaries, firmware_world


def basin():
    setup, _, _ = reference_boat()
    return WorldSetup(setup.vessel, setup.site, start=(8.0, 8.0, math.radians(20)))


@pytest.mark.long
@pytest.mark.firmware
@pytest.mark.skipif(not binaries(), reason="ARDUROVER names no firmware (a desktop build of ArduPilot Rover)")
@pytest.mark.parametrize("gps", [False, True])
@pytest.mark.parametrize("binary", binaries(), ids=lambda path: path.parent.name)
def test_the_mission_without_and_with_gps(binary, gps, tmp_path):
    with closing(firmware_world(binary, tmp_path, basin(), 1, gps=gps)) as world:
        got = drive_mission(world)
        assert len({pulses[0] for _, pulses in world.pulses}) > 20, "the thrusters were driven"
    assert got["missed"] == 0
    assert got["cross_track_rms_m"] <= 0.11 and got["u_rmse_m_s"] <= 0.05 and got["position_rmse_m"] <= 0.12


def test_a_program_that_is_no_firmware_is_said_to_be_so(tmp_path):
    with pytest.raises(FirmwareStopped, match="does not listen"):
        FirmwareWorld(basin(), 1, FirmwareSetup(Path("/bin/true"), tmp_path))
