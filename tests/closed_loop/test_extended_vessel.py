"""A short mission on the stepped clock with a broken or weakened boat whose vessel file says so; seed 1.

With everything at once the track of one seed says little (0.06 to 0.20 m): there the mean of three counts.
"""

from dataclasses import replace as replace_settings

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Wash
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.messages import OverrideLease
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import Pilot
from companion.jit import compile_loops
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup
from tests.support.drive_fixture import CORNER, START, figures, settled, setup

BASE = setup(CORNER).pilot.vessel


def geared(**gains):
    return replace(BASE, thrusters=tuple(replace(t, gain=gains.get(t.name, t.gain)) for t in BASE.thrusters))


def weakened():
    wash = Wash(behind="rear_port", ahead="front_port", share=0.4)
    more = {"advance_loss_sqrt_N_s_m": 0.8, "slew_N_s": 25.0, "wash": (wash,)}
    imu = replace(BASE.sensors.imu, heading_offset_rad=0.3, hard_iron_sin_rad=0.1, gyro_bias_rad_s=0.05,
                  misalignment_rad=-0.2, accel_bias_x_m_s2=0.3)  # fmt: skip
    uwb = replace(BASE.sensors.uwb, scale=0.03, clock_drift_s_s=0.002)
    terms = {
        "munk_moment": {"k_kg": 20.0, "source": "test"},
        "tether": {"north_m": 8.0, "east_m": 8.0, "slack_m": 2.0, "stiffness_N_m": 1.0, "source": "test"},
        "shallow_zone": {"north_m": 14.0, "east_m": 9.0, "radius_m": 2.5, "share": 1.0, "source": "test"},
        "current": {"V_c_m_s": 0.05, "beta_c_deg": 40.0, "source": "test"},
    }
    propulsion, sensors = replace(BASE.propulsion, **more), replace(BASE.sensors, imu=imu, uwb=uwb)
    return replace(BASE, propulsion=propulsion, sensors=sensors, terms=terms)


def driven(true, believed, seed=1, limit_s=90.0):
    told = replace_settings(setup(CORNER).pilot, vessel=believed)
    patient = replace(told.nmpc, rescue_time_s=60.0)
    nmpc = Nmpc(StructuredModel.of(believed), Actuation.of(believed), patient, lambda: 0.0, compiler=compile_loops)
    run = SteppedRun(World(WorldSetup(true, told.site, start=START), seed), Pilot(told), nmpc.solve)
    return run, run.run(settled(2.0), limit_s)


@pytest.mark.long
@pytest.mark.parametrize(
    ("vessel", "seeds"),
    [
        pytest.param(geared(front_port=0.0), (1,), id="dead"),
        pytest.param(geared(rear_starboard=-1.0), (1,), id="reversed"),
        pytest.param(geared(front_port=0.0, rear_starboard=-1.0), (1,), id="one dead, one reversed"),
        pytest.param(weakened(), (1, 2, 3), id="everything at once"),
    ],
)
def test_the_mission_is_done_within_the_limits(vessel, seeds):
    tracks = []
    for seed in seeds:
        run, done = driven(vessel, vessel, seed)
        assert done, f"not done: {run.state.guidance.phase}, {run.state.helm}"
        got = figures(run)
        print(got)
        tracks.append(got["cross_track_rms_m"])
        assert got["position_rmse_m"] <= 0.2 and got["heading_rmse_deg"] <= 2.0
        leases = [lease for lease in run.of(OverrideLease) if lease.source != "neutral"]
        assert sum(lease.source == "plan" for lease in leases) >= 0.99 * len(leases) > 300
        for i, thruster in enumerate(vessel.thrusters):
            if thruster.gain == 0.0:
                assert {lease.pwm_us[i] for lease in leases} == {1500}
    assert np.mean(tracks) <= 0.15


@pytest.mark.long
def test_a_dead_thruster_that_the_file_does_not_know_takes_the_estimate_beyond_its_limits():
    """Seed 1: 0.059 m/s where 0.05 is the limit and the boat whose file knows has 0.042; the track hardly shows it."""
    run, done = driven(geared(front_port=0.0), BASE)
    assert not done or figures(run)["velocity_rmse_m_s"] > 0.05
