"""Known errors of the sensors: undone exactly, refused where they cannot be, and of no account to the filter."""

from dataclasses import replace as replace_run

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.configuration.tables import ConfigError
from companion.core.estimation.estimator import Estimator
from companion.core.messages import AnchorRange, Attitude, ImuSample, UwbPosition, UwbRanges
from companion.core.model import sensor_errors as cal
from companion.core.model.load_vessel import load_vessel
from companion.core.sensors.inertial import AttitudeSensor
from companion.core.sensors.uwb import RangingSensor
from tests.companion.core.estimation.estimator_world import basin, estimate, simulate
from tests.support.vessel_fixtures import BOATS, boat

BASE = boat("aritra")
number = st.floats(-1e3, 1e3)
imus = st.builds(
    lambda **keys: replace(BASE.sensors.imu, **keys),
    accel_bias_x_m_s2=st.floats(-5, 5),
    accel_bias_y_m_s2=st.floats(-5, 5),
    gyro_bias_rad_s=st.floats(-1, 1),
    gyro_scale=st.floats(-0.5, 0.5),
    misalignment_rad=st.floats(-3.15, 3.15),
    heading_offset_rad=st.floats(-3.15, 3.15),
    hard_iron_cos_rad=st.floats(-0.5, 0.5),
    hard_iron_sin_rad=st.floats(-0.5, 0.5),
)
uwbs = st.builds(
    lambda **keys: replace(BASE.sensors.uwb, **keys),
    scale=st.floats(-0.5, 0.5),
    clock_drift_s_s=st.floats(-0.05, 0.05),
    latency_s=st.floats(0, 1),
)


@given(imus, number, number, number)
def test_imu_corrected_undoes_applied(imu, a_x, a_y, r):
    assert cal.correct_imu(imu, *cal.apply_imu_errors(imu, a_x, a_y, r)) == pytest.approx((a_x, a_y, r), abs=1e-9)


@settings(max_examples=300)
@given(imus, st.floats(-7, 7))
def test_heading_corrected_undoes_applied(imu, psi):
    assert cal.correct_heading(imu, cal.apply_heading_errors(imu, psi)) == pytest.approx(psi, abs=1e-9)


@given(uwbs, number, number)
def test_place_corrected_undoes_applied(uwb, north, east):
    assert cal.correct_uwb_scale(uwb, *cal.apply_uwb_scale(uwb, north, east)) == pytest.approx((north, east))


@given(uwbs, st.integers(0, 3600 * 10**9), st.integers(0, 10**18))
def test_stamp_corrected_undoes_applied(uwb, since, zero):
    late = cal.arrival_time_ns(uwb, zero + since, zero)
    assert late >= zero + since
    assert cal.measurement_time_ns(uwb, late, zero) <= late
    if uwb.latency_s + uwb.clock_drift_s_s * since * 1e-9 > 0:  # nothing arrives before it was measured
        assert cal.measurement_time_ns(uwb, late, zero) == pytest.approx(zero + since, abs=200)


@given(number, number, number, st.integers(0, 10**18), st.integers(0, 10**13))
def test_without_known_errors_not_a_bit_changes(a, b, c, t_ns, since):
    imu, uwb = BASE.sensors.imu, BASE.sensors.uwb
    assert cal.is_exact(BASE.sensors)
    assert cal.apply_imu_errors(imu, a, b, c) == (a, b, c) == cal.correct_imu(imu, a, b, c)
    assert cal.apply_heading_errors(imu, a) == a == cal.correct_heading(imu, a)
    assert cal.apply_uwb_scale(uwb, a, b) == (a, b) == cal.correct_uwb_scale(uwb, a, b)
    assert cal.measurement_time_ns(uwb, t_ns + since, t_ns) == t_ns + since - 80_000_000


def test_by_hand():
    """IMU turned a quarter to starboard: its x is the body's y, its y the body's minus x."""
    imu = replace(BASE.sensors.imu, misalignment_rad=np.pi / 2, accel_bias_x_m_s2=0.1, gyro_scale=0.02)
    assert cal.apply_imu_errors(imu, 1.0, 2.0, 0.5) == pytest.approx((2.1, -1.0, 0.51))
    iron = replace(BASE.sensors.imu, heading_offset_rad=0.1, hard_iron_cos_rad=0.03, hard_iron_sin_rad=-0.02)
    assert cal.apply_heading_errors(iron, 0.0) == pytest.approx(0.13)
    assert cal.apply_heading_errors(iron, np.pi / 2) == pytest.approx(np.pi / 2 + 0.08)
    uwb = replace(BASE.sensors.uwb, scale=0.01, clock_drift_s_s=1e-3)
    assert cal.apply_uwb_scale(uwb, 20.0, -10.0) == pytest.approx((20.2, -10.1))
    assert cal.arrival_time_ns(uwb, 105 * 10**9, 5 * 10**9) == 105 * 10**9 + 80_000_000 + 100_000_000


# --- the filter ----------------------------------------------------------------------------------------------

ERRORS = {
    "imu": {"accel_bias_x_m_s2": 0.3, "accel_bias_y_m_s2": -0.2, "gyro_bias_rad_s": 0.03, "gyro_scale": 0.08,
            "misalignment_rad": 0.15, "heading_offset_rad": 0.2, "hard_iron_cos_rad": 0.1,
            "hard_iron_sin_rad": -0.15},
    "uwb": {"scale": 0.03, "clock_drift_s_s": 0.002},
}  # fmt: skip
KNOWN = replace(
    BASE,
    sensors=replace(
        BASE.sensors,
        imu=replace(BASE.sensors.imu, **ERRORS["imu"]),
        uwb=replace(BASE.sensors.uwb, **ERRORS["uwb"]),
    ),
)


def spoiled(run, message):
    """The message as sensors with ERRORS would have sent it; formulas written out."""
    e, c, s = ERRORS["imu"], np.cos(0.15), np.sin(0.15)
    if isinstance(message, ImuSample):
        a_x, a_y = message.ax_m_s2, message.ay_m_s2
        return replace(message, ax_m_s2=c * a_x + s * a_y + 0.3, ay_m_s2=-s * a_x + c * a_y - 0.2,
                       r_rad_s=1.08 * message.r_rad_s + 0.03)  # fmt: skip
    if isinstance(message, Attitude):
        psi = message.psi_rad
        said = psi + e["heading_offset_rad"] + 0.1 * np.cos(psi) - 0.15 * np.sin(psi)
        return replace(message, psi_rad=said, r_rad_s=1.08 * message.r_rad_s + 0.03)
    tag = BASE.sensors.uwb
    late_ns = 80_000_000
    measured_ns = message.t_rx_ns - late_ns
    north, east, psi = run.truth(measured_ns * 1e-9)[:3]
    place = np.array([north + np.cos(psi) * tag.x_m, east + np.sin(psi) * tag.x_m, tag.z_m])
    seen = place * [1.03, 1.03, 1.0]
    ranges = []
    for anchor, r in zip(basin().anchors, message.ranges, strict=True):
        at = np.array([anchor.north_m, anchor.east_m, anchor.down_m])
        more = np.linalg.norm(seen - at) - np.linalg.norm(place - at)
        ranges.append(AnchorRange(anchor=r.anchor, range_m=float(r.range_m + more)))
    rx_ns = message.t_rx_ns + round(0.002 * measured_ns)
    return replace(message, t_ns=rx_ns, t_rx_ns=rx_ns, ranges=tuple(ranges))


@pytest.fixture(scope="module")
def plain():
    return simulate(2, disturbed=False, seconds=40.0)


@pytest.fixture(scope="module")
def wrong(plain):
    bad = [spoiled(plain, m) for m in plain.messages]
    return replace_run(plain, messages=sorted(bad, key=lambda m: m.t_rx_ns))


@pytest.mark.long
def test_the_filter_does_not_notice_errors_that_its_file_knows(plain, wrong):
    """Seed 2. Not the same to the last digit: later bytes are fused later, a larger scale makes ranges count more."""
    good = estimate(plain, Estimator(BASE, basin()))
    known = estimate(wrong, Estimator(KNOWN, basin()))
    assert known.nees.mean() == pytest.approx(good.nees.mean(), rel=0.15)
    for name, value in good.rms().items():
        assert known.rms()[name] == pytest.approx(value, rel=0.25), name
    assert known.state.restarts == 0 and not known.state.refused


def test_the_filter_that_does_not_know_them_is_led_astray(wrong):
    assert estimate(wrong, Estimator(BASE, basin())).nees.mean() > 100


def test_positions_from_the_tag_and_attitudes_are_corrected_too():
    at = UwbPosition(t_ns=0, t_rx_ns=0, tag="t", x_m=-10.3, y_m=20.6, z_m=1.0)
    tag = RangingSensor(KNOWN.sensors.tag, 4)
    assert tag.correct(at) == replace(at, x_m=-10.3 / 1.03, y_m=20.6 / 1.03)
    none = UwbRanges(t_ns=0, t_rx_ns=0, tag="t", ranges=())
    assert tag.correct(none) is none
    turned = Attitude(t_ns=0, t_rx_ns=0, phi_rad=0.1, theta_rad=0.2, psi_rad=-3.1, p_rad_s=0, q_rad_s=0, r_rad_s=0.57)
    got = AttitudeSensor(KNOWN.sensors.imu).correct(turned)
    assert -np.pi <= got.psi_rad < np.pi
    assert got.r_rad_s == pytest.approx(0.5) and (got.phi_rad, got.theta_rad) == (0.1, 0.2)


@pytest.mark.parametrize(
    ("after", "line", "says"),
    [
        ("rate_Hz = 50.0", "gyro_scale = -0.6", "sensors.imu.gyro_scale: expected -0.5 to 0.5, found -0.6"),
        ("rate_Hz = 50.0", "hard_iron_cos_rad = 0.6", "sensors.imu.hard_iron_cos_rad: expected -0.5 to 0.5, found 0.6"),
        ("rate_Hz = 50.0", "accel_bias_z_m_s2 = 0.1", "sensors.imu.accel_bias_z_m_s2: unknown key"),
        ("rate_Hz = 1.0", "clock_drift_s_s = 0.1", "sensors.uwb.clock_drift_s_s: expected -0.05 to 0.05, found 0.1"),
        ("rate_Hz = 1.0", "scale = -1.0", "sensors.uwb.scale: expected -0.5 to 0.5, found -1"),
    ],
)
def test_what_cannot_be_is_refused_by_its_key(after, line, says):
    text = (BOATS / "aritra.toml").read_text().replace(after, f"{after}\n{line}")
    with pytest.raises(ConfigError, match=f"^boat.toml: {says}"):
        load_vessel(text, name="boat.toml")
