"""Stops on a real ArduPilot in software, where ARDUROVER names one; all: scripts/evidence firmware --only stops."""

from contextlib import closing

import pytest

from sim.world.world import WorldSetup
from tests.evidence.main_job.parts import reference_boat
from tests.support.autopilots.firmware_rig import binaries, firmware_world
from tests.support.autopilots.stop_trial import Trial, try_stop
from tests.support.autopilots.stops import CUT, KILLED, REBOOT, SAFETY, SCRIPT

AFTER_S = 10.0


@pytest.mark.long
@pytest.mark.firmware
@pytest.mark.skipif(not binaries(), reason="ARDUROVER names no firmware (a desktop build of ArduPilot Rover)")
@pytest.mark.parametrize("stop", [KILLED, CUT, SAFETY, SCRIPT, REBOOT], ids=lambda stop: stop.name)
@pytest.mark.parametrize("binary", binaries(), ids=lambda path: path.parent.name)
def test_neutral_in_time_and_nothing_turns_when_the_outputs_are_back(binary, stop, tmp_path):
    boat = reference_boat()[0]
    setup = WorldSetup(boat.vessel, boat.site, start=(8.0, 8.0, 0.35))
    with closing(firmware_world(binary, tmp_path, setup, 1, gps=False)) as world:
        stopped = try_stop(Trial(world), stop, AFTER_S)
    assert stopped.neutral_s <= stop.neutral_s and stopped.away_us == 0 and stopped.mode == stop.mode
