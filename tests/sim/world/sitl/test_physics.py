"""What the firmware is told of the boat: the plant of the loopback, as a strapdown computer would put it together."""

import math
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from companion.core.geometry.frames import R2
from companion.core.messages import UwbRanges
from drivers.uwb import uwb_codec
from sim.world.environment import Weather
from sim.world.sitl.backend import frame_ns
from sim.world.sitl.physics import SitlPhysics
from sim.world.world import STEP_NS, Afloat, WorldSetup
from tests.sim.world.sitl.sitl_fixture import MS, S
from tests.support.drive_fixture import setup
from tests.support.vessel_fixtures import boat

SITE = setup().pilot.site
START = (8.0, 9.0, 0.4)


CLEAN = dict.fromkeys(("accel_sigma_m_s2", "gyro_sigma_rad_s"), 1e-15) | dict.fromkeys(
    ("accel_bias_sigma_m_s2", "accel_bias_walk_m_s2_sqrt_s", "gyro_bias_sigma_rad_s", "gyro_bias_walk_rad_s_sqrt_s"),
    0.0,
)


def physics(seed=1, name="aritra", site=SITE, imu=CLEAN, **changes):
    vessel = boat(name)
    sensors = msgspec.structs.replace(vessel.sensors, imu=msgspec.structs.replace(vessel.sensors.imu, **imu))
    vessel = msgspec.structs.replace(vessel, sensors=sensors)
    return SitlPhysics(WorldSetup(vessel, site, **{"start": START, **changes}), seed)


def drive(made, seconds, pulses=(1500,) * 4, rate=200):
    return [made.advance(pulses, frame_ns(rate))[0] for _ in range(round(seconds * rate))]


TURN = (1650, 1500, 1600, 1500)


def test_at_rest_the_accelerometer_says_minus_9_80665_down_and_nothing_else():
    state = drive(physics(), 1.0)[-1]
    assert state.accel_m_s2 == pytest.approx((0, 0, -9.80665), abs=1e-9)
    assert state.gyro_rad_s == pytest.approx((0, 0, 0), abs=1e-9)
    assert state.position_m == pytest.approx((START[0], START[1], 0)) and state.velocity_m_s == (0, 0, 0)
    assert state.attitude_rad == pytest.approx((0, 0, START[2]))


def test_it_is_the_plant_of_the_loopback_and_no_other():
    """Frames of 10 ms are the loopback's own steps: the same motion to the last bit."""
    setup_ = WorldSetup(boat("aritra"), SITE, start=START, weather=Weather(0.1, 70.0, 0.0, 4.0, 200.0, 0.3, 0.1))
    made, plain = SitlPhysics(setup_, 3), Afloat(setup_, 3)
    for _ in range(500):
        state, uwb = made.advance(TURN, STEP_NS)
        plain.advance(TURN)
        assert uwb == plain.tag_bytes()
    assert np.array_equal(made.world.plant.motion.x, plain.plant.motion.x) and abs(made.world.plant.motion.x[5]) > 0.1
    assert state.position_m[:2] == tuple(plain.plant.motion.x[:2])


def test_states_hold_together_as_a_strapdown_computer_would_put_them():
    """Specific force, turned to NED, gravity added, integrated: velocity; that integrated: position; gyro: yaw."""
    told = drive(physics(imu={**CLEAN, "x_m": 0.0, "y_m": 0.0}), 8.0, TURN)
    velocity, position, yaw = np.zeros(2), np.array(START[:2]), START[2]
    for a, b in pairwise(told):
        dt = b.timestamp_s - a.timestamp_s
        middle = yaw + dt * (a.gyro_rad_s[2] + b.gyro_rad_s[2]) / 4
        yaw += dt * (a.gyro_rad_s[2] + b.gyro_rad_s[2]) / 2
        before = velocity
        velocity = velocity + dt * R2(middle) @ (np.array(a.accel_m_s2[:2]) + b.accel_m_s2[:2]) / 2
        position = position + dt * (before + velocity) / 2
    last = told[-1]
    assert np.hypot(*last.velocity_m_s[:2]) > 0.2 and abs(yaw - START[2]) > 0.5
    assert velocity == pytest.approx(last.velocity_m_s[:2], abs=2e-3)
    assert position == pytest.approx(last.position_m[:2], abs=5e-3)
    assert math.remainder(yaw - last.attitude_rad[2], math.tau) == pytest.approx(0, abs=1e-4)


def test_in_waves_the_gyro_integrates_to_the_attitude():
    """Turning in a seaway: dR/dt = R S(omega), and Z-Y-X angles of R are those told."""
    told = drive(physics(weather=Weather(H_s_m=0.3)), 6.0, TURN)
    rolls = [s.attitude_rad[0] for s in told]
    assert max(rolls) - min(rolls) > 0.05
    phi, theta, psi = told[0].attitude_rad
    c, s = np.cos, np.sin
    R = (
        np.array([[c(psi), -s(psi), 0], [s(psi), c(psi), 0], [0, 0, 1]])
        @ np.array([[c(theta), 0, s(theta)], [0, 1, 0], [-s(theta), 0, c(theta)]])
        @ np.array([[1, 0, 0], [0, c(phi), -s(phi)], [0, s(phi), c(phi)]])
    )
    for a, b in pairwise(told):
        p, q, r = np.array(b.gyro_rad_s) * (b.timestamp_s - a.timestamp_s)
        angle = math.sqrt(p * p + q * q + r * r)
        K = np.array([[0, -r, q], [r, 0, -p], [-q, p, 0]]) / (angle or 1.0)
        R = R @ (np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K)
    last = told[-1].attitude_rad
    assert math.atan2(R[2, 1], R[2, 2]) == pytest.approx(last[0], abs=0.01)
    assert -math.asin(R[2, 0]) == pytest.approx(last[1], abs=0.01)
    assert math.remainder(math.atan2(R[1, 0], R[0, 0]) - last[2], math.tau) == pytest.approx(0, abs=0.01)
    assert np.linalg.norm(told[-1].accel_m_s2) == pytest.approx(9.8, abs=1.0)


@pytest.mark.parametrize("rate", [1200, 400, 100, 50, 10])
def test_the_length_of_a_frame_changes_the_motion_by_less_than_a_millimetre(rate):
    """Slower frames are steps of 10 ms inside; pulses act from the frame's beginning, as at 200 Hz."""
    fast, other = physics(), physics()
    drive(fast, 3.0, TURN)
    while other.world.t_ns < 3 * S - MS:
        other.advance(TURN, frame_ns(rate))
    a, b = fast.world.plant.motion, other.world.plant.motion
    assert b.t_ns == pytest.approx(a.t_ns, abs=10 * MS)
    assert b.x[:2] + (a.t_ns - b.t_ns) * 1e-9 * R2(b.x[2]) @ b.x[3:5] == pytest.approx(a.x[:2], abs=1e-3)


def test_in_a_basin_that_is_turned_the_firmware_is_told_true_north():
    turned = msgspec.structs.replace(SITE, rotation_deg=30.0)
    straight, told = drive(physics(), 4.0, TURN)[-1], drive(physics(site=turned), 4.0, TURN)[-1]
    R = R2(math.radians(30.0))
    assert told.position_m[:2] == pytest.approx(R @ straight.position_m[:2])
    assert told.velocity_m_s[:2] == pytest.approx(R @ straight.velocity_m_s[:2])
    assert told.attitude_rad[2] == pytest.approx(straight.attitude_rad[2] + math.radians(30.0))
    assert told.accel_m_s2 == pytest.approx(straight.accel_m_s2)


def test_errors_and_noise_that_the_vessel_file_knows_of_are_in():
    wrong = {"heading_offset_rad": 0.1, "accel_bias_x_m_s2": 0.2, "gyro_bias_rad_s": 0.03}
    clean, told = drive(physics(), 0.1)[-1], drive(physics(imu=CLEAN | wrong), 0.1)[-1]
    assert told.attitude_rad[2] - clean.attitude_rad[2] == pytest.approx(0.1)
    assert told.accel_m_s2[0] - clean.accel_m_s2[0] == pytest.approx(0.2)
    assert told.gyro_rad_s[2] == pytest.approx(0.03)
    noisy = np.array([s.gyro_rad_s for s in drive(physics(imu={}), 5.0)])
    density = boat("aritra").sensors.imu.gyro_sigma_rad_s * math.sqrt(200 / boat("aritra").sensors.imu.rate_Hz)
    assert noisy.std(axis=0) == pytest.approx(density, rel=0.15)


def test_the_battery_sags_under_load():
    made = physics()
    rest, loaded = drive(made, 0.5)[-1], drive(made, 2.0, (1800,) * 4)[-1]
    assert rest.voltage_v > loaded.voltage_v > 10 and loaded.current_a > rest.current_a + 5


def test_a_restart_puts_the_boat_back_and_leaves_the_tag_on():
    made = physics()
    uwb = made.world.vessel.sensors.uwb
    codec = uwb_codec(uwb.wire_format, "tag", uwb.rate_Hz)
    for data in codec.start_bytes():
        codec.feed(made.world.uwb(data), made.world.t_ns)

    def ranges(seconds):
        heard = []
        for k in range(round(seconds * 200)):
            if k % 20 == 0:
                for data in codec.step(made.world.t_ns):
                    heard += codec.feed(made.world.uwb(data), made.world.t_ns)
            heard += codec.feed(made.advance(TURN, frame_ns(200))[1], made.world.t_ns)
        return [m for m in heard if isinstance(m, UwbRanges)]

    assert len(ranges(8.0)) >= 3
    first, before_ns = physics().advance(TURN, frame_ns(200))[0], made.world.t_ns
    made.restart()
    assert made.world.t_ns == before_ns, "the tag's time goes on"
    assert made.advance(TURN, frame_ns(200))[0] == first
    assert len(ranges(4.0)) >= 3, "without being spoken to again"
