"""A boat with UWB and a DVL on the stepped clock: without the tag it dead-reckons by its speed over ground. Seed 4."""

from dataclasses import replace

import pytest
from msgspec.structs import replace as struct_replace

from companion.core.configuration.sensors import Dvl
from companion.core.messages import StateEstimate
from companion.core.messages.sensors import DvlVelocity
from companion.core.pilot.pilot import Pilot
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup
from tests.support.drive_fixture import START, driving, healthy, nmpc, setup

LOG = Dvl(x_m=0.2, z_m=0.15, rate_Hz=5.0, velocity_sigma_m_s=0.02, latency_s=0.05, source="test")
BLIND_S = 10.0


def blind_error_m(dvl: Dvl | None) -> float:
    """Error of the position after so long without the tag."""
    told = setup().pilot
    vessel = struct_replace(told.vessel, sensors=struct_replace(told.vessel.sensors, dvl=dvl))
    run = SteppedRun(
        World(WorldSetup(vessel, told.site, start=START), 4), Pilot(replace(told, vessel=vessel)), nmpc().solve
    )
    assert run.run(lambda r: driving(r) and r.state.guidance.s_m > 3.0 and healthy(r), 40.0)
    assert bool(run.of(DvlVelocity)) == (dvl is not None)
    run.world.silent_uwb = True
    run.run(lambda r: False, BLIND_S)
    estimate, truth = run.of(StateEstimate)[-1], run.world.truth()
    return ((estimate.north_m - truth.north_m) ** 2 + (estimate.east_m - truth.east_m) ** 2) ** 0.5


@pytest.mark.long
def test_speed_over_ground_carries_it_through_a_silent_tag():
    with_log, without = blind_error_m(LOG), blind_error_m(None)
    assert with_log < 0.3 < without
