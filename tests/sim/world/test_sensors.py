"""Sensors: noise as large as the vessel file says, biases that stay, faults as often as asked for."""

import msgspec
import numpy as np
import pytest
from scipy.stats import binom, chi2

from companion.core.constants import GRAVITY_M_S2
from sim.world.environment import Moment
from sim.world.plant import Motion
from sim.world.sensors import ImuSensor, UwbFaults, UwbSensor
from tests.support.drive_fixture import setup
from tests.support.vessel_fixtures import boat

VESSEL, SITE = boat("aritra"), setup().pilot.site
LEVEL = Moment(0.0, 0.0, 0.0, 0.0, np.zeros(3), 0.0, 0.0)
REST = Motion(0, np.array([10.0, 12.0, 0.7, 0, 0, 0, 0, 0, 0, 0]), np.zeros(3))


def imu(seed, **changes):
    return ImuSensor(msgspec.structs.replace(VESSEL.sensors.imu, **changes), np.random.default_rng(seed))


EXACT = {
    "accel_sigma_m_s2": 1e-12, "accel_bias_sigma_m_s2": 0.0, "accel_bias_walk_m_s2_sqrt_s": 0.0,
    "gyro_sigma_rad_s": 1e-12, "gyro_bias_sigma_rad_s": 0.0, "gyro_bias_walk_rad_s_sqrt_s": 0.0,
    "heading_sigma_rad": 1e-12, "heading_wander_sigma_rad": 0.0,
}  # fmt: skip


def uwb(seed, faults=UwbFaults(), **changes):  # noqa: B008
    sensor = msgspec.structs.replace(VESSEL.sensors.uwb, **changes)
    return UwbSensor(sensor, SITE.anchors, faults, np.random.default_rng(seed))


def distances(sensor, motion=REST):
    tag = sensor.tag_position(motion.x)
    return {a.id: float(np.linalg.norm(tag - (a.north_m, a.east_m, a.down_m))) for a in SITE.anchors}


# --- IMU -------------------------------------------------------------------------------------------


def test_at_rest_the_imu_feels_gravity_and_nothing_else():
    reading = imu(1, **EXACT).measure(REST, LEVEL)
    assert reading.accel_m_s2 == pytest.approx((0, 0, -GRAVITY_M_S2), abs=1e-9)
    assert reading.gyro_rad_s == pytest.approx((0, 0, 0), abs=1e-9)
    assert reading.psi_rad == pytest.approx(0.7, abs=1e-9)


def test_tilted_at_rest_gravity_is_what_the_attitude_says():
    phi, theta = 0.2, -0.1
    tilted = Moment(0, 0, 0, 0, np.zeros(3), phi, theta)
    reading = imu(1, **EXACT).measure(REST, tilted)
    told = GRAVITY_M_S2 * np.array([np.sin(theta), -np.cos(theta) * np.sin(phi), -np.cos(theta) * np.cos(phi)])
    assert reading.accel_m_s2 == pytest.approx(told, abs=1e-9)
    assert np.linalg.norm(reading.accel_m_s2) == pytest.approx(GRAVITY_M_S2)


def test_off_the_centre_of_a_turn_the_imu_feels_the_lever_arm():
    """Steady turn of radius u/r with the IMU at (x, y): a = omega x (omega x r) + omega x nu."""
    place = np.array([0.3, -0.2, 0.0])
    u, v, r, r_dot = 0.8, 0.1, 0.6, 0.25
    motion = Motion(0, np.array([0, 0, 0, u, v, r, 0, 0, 0, 0]), np.array([0.05, -0.02, r_dot]))
    omega = np.array([0, 0, r])
    told = (np.array([0.05, -0.02, 0]) + np.cross(omega, [u, v, 0]) + np.cross(omega, np.cross(omega, place))
            + np.cross([0, 0, r_dot], place) - [0, 0, GRAVITY_M_S2])  # fmt: skip
    reading = imu(1, x_m=0.3, y_m=-0.2, **EXACT).measure(motion, LEVEL)
    assert reading.accel_m_s2 == pytest.approx(told, abs=1e-9)
    assert reading.gyro_rad_s[2] == pytest.approx(r, abs=1e-9)


def test_imu_noise_is_as_the_file_says():
    """Seed 3, 4000 samples: variances within the 99.9 % band of chi2."""
    quiet = {"accel_bias_walk_m_s2_sqrt_s": 0.0, "gyro_bias_walk_rad_s_sqrt_s": 0.0, "heading_wander_sigma_rad": 0.0}
    sensor, n = imu(3, **quiet), 4000
    readings = [sensor.measure(REST, LEVEL) for _ in range(n)]
    low, high = chi2.ppf([0.0005, 0.9995], n - 1) / (n - 1)
    told = VESSEL.sensors.imu
    for values, sigma in (
        (np.array([r.accel_m_s2 for r in readings])[:, 0], told.accel_sigma_m_s2),
        (np.array([r.gyro_rad_s for r in readings])[:, 2], told.gyro_sigma_rad_s),
        (np.array([r.psi_rad for r in readings]), told.heading_sigma_rad),
    ):
        assert low < values.var(ddof=1) / sigma**2 < high


def test_imu_biases_are_drawn_once_a_seed_with_their_spread():
    sigma = VESSEL.sensors.imu.accel_bias_sigma_m_s2
    still = {**EXACT, "accel_bias_sigma_m_s2": sigma}
    biases = []
    for seed in range(400):
        sensor = imu(seed, **still)
        first, later = (sensor.measure(REST, LEVEL).accel_m_s2[0] for _ in range(2))
        assert first == pytest.approx(later, abs=1e-9)
        biases.append(first)
    assert np.std(biases) == pytest.approx(sigma, rel=0.12)


# --- UWB -------------------------------------------------------------------------------------------


def test_range_noise_is_as_the_file_says_and_the_bias_stays():
    sensor, n = uwb(5), 4000
    true = distances(sensor)
    errors = np.array([[r - true[a] for a, r in sensor.measure(REST).items()] for _ in range(n)])
    low, high = chi2.ppf([0.0005, 0.9995], n - 1) / (n - 1)
    for column in errors.T:
        assert low < column.var(ddof=1) / 0.10**2 < high
    halves = errors[: n // 2].mean(axis=0) - errors[n // 2 :].mean(axis=0)
    assert np.abs(halves).max() < 5 * 0.10 * np.sqrt(2 / (n / 2))


def test_range_bias_is_one_number_per_anchor_and_seed():
    sigma, biases = VESSEL.sensors.uwb.range_bias_sigma_m, []
    for seed in range(150):
        sensor = uwb(seed, range_sigma_m=1e-9)
        true = distances(sensor)
        one, two = (sensor.measure(REST) for _ in range(2))
        assert one == pytest.approx(two, abs=1e-7)
        biases += [one[a] - true[a] for a in true]
    assert np.std(biases) == pytest.approx(sigma, rel=0.12)
    assert len({round(b, 9) for b in biases[:4]}) == 4


@pytest.mark.parametrize(("dropout", "nlos"), [(0.2, 0.05), (0.0, 0.3), (0.5, 0.0), (1.0, 0.0)])
def test_faults_come_as_often_as_asked_for(dropout, nlos):
    """Seed 8: counts within the 99.9 % band of the binomial."""
    sensor, n = uwb(8, UwbFaults(dropout, nlos), range_sigma_m=1e-6, range_bias_sigma_m=0.0), 1500
    true = distances(sensor)
    errors = [(r - true[a]) if r is not None else None for _ in range(n) for a, r in sensor.measure(REST).items()]
    silent = sum(e is None for e in errors)
    heard = [e for e in errors if e is not None]
    far = [e for e in heard if e > 0.1]
    low, high = binom.ppf([0.0005, 0.9995], len(errors), dropout)
    assert low <= silent <= high
    low, high = binom.ppf([0.0005, 0.9995], len(heard), nlos)
    assert low <= len(far) <= high
    assert all(0.3 * 3.0 - 0.01 <= e <= 3.0 + 0.01 for e in far), "an echo is longer, never shorter"


def test_the_tag_sits_where_the_file_says():
    told = VESSEL.sensors.uwb
    sensor = uwb(1)
    for psi in (0.0, np.pi / 2, -2.0):
        north, east, down = sensor.tag_position(np.array([5.0, 6.0, psi]))
        assert (north, east) == pytest.approx((5 + told.x_m * np.cos(psi), 6 + told.x_m * np.sin(psi)))
        assert down == told.z_m


def test_the_tags_own_fix_is_the_place_in_its_anchors_frame():
    sensor = uwb(1, range_sigma_m=1e-9, range_bias_sigma_m=0.0)
    tag = sensor.tag_position(REST.x)
    assert sensor.fix(sensor.measure(REST)) == pytest.approx((tag[1], tag[0], -tag[2]), abs=1e-6)
    two = dict(list(sensor.measure(REST).items())[:2]) | dict.fromkeys(("111C", "1150"))
    assert sensor.fix(two) is None
