"""Missions on a real ArduPilot in software: what matters of them, where ARDUROVER names one."""

import math
import subprocess
from contextlib import closing
from pathlib import Path

import psutil
import pytest

from companion.python_child import python
from sim.world.world import WorldSetup
from tests.evidence.main_job.parts import drive_mission, reference_boat
from tests.support.autopilots.firmware_rig import binaries, firmware_world
from tests.support.autopilots.firmware_world import FirmwareSetup, FirmwareStopped, FirmwareWorld
from tests.support.boat_processes import wait_for


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


@pytest.mark.long
def test_a_program_that_is_no_firmware_is_said_to_be_so(tmp_path):
    with pytest.raises(FirmwareStopped, match="does not listen"):
        FirmwareWorld(basin(), 1, FirmwareSetup(Path("/bin/true"), tmp_path))


BEGINS = """
import sys
from pathlib import Path
from tests.support.autopilots.firmware_world import FirmwareSetup, FirmwareWorld
from tests.sim.world.sitl.test_firmware_world import basin
FirmwareWorld(basin(), 1, FirmwareSetup(Path(sys.argv[1]), Path(sys.argv[2])))
"""


@pytest.mark.long
def test_a_firmware_ends_with_a_run_that_is_killed(tmp_path):
    """Else it keeps its ports, and the next run speaks to it."""
    program, number = tmp_path / "firmware", tmp_path / "number"
    program.write_text(f"#!/bin/sh\ntrap '' TERM\necho $$ > {number}.part; mv {number}.part {number}\nexec sleep 60\n")
    program.chmod(0o755)
    with subprocess.Popen(python("-c", BEGINS, program, tmp_path)) as run:
        wait_for(number.exists, 60.0, lambda: "no firmware began")
        firmware = psutil.Process(int(number.read_text()))
        run.kill()
    assert not psutil.wait_procs([firmware], timeout=20)[1]
