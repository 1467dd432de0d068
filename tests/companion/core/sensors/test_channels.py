"""Sensors with channels: message and readings are inverse, h agrees with an independent form, H with differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.configuration.sensors import Dvl
from companion.core.estimation.channel_fusion import channel_function
from companion.core.messages.sensors import GnssFix
from companion.core.sensors.dvl import DopplerLog
from companion.core.sensors.gnss import GnssReceiver
from companion.core.sensors.sensor import BodyMotion
from companion.core.sensors.table import origin_of

LAKE = load_setup(EXAMPLES / "lake.toml").pilot
SITE = replace(LAKE.site, rotation_deg=25.0)
SPEC = LAKE.vessel.sensors.gnss
assert SPEC
GNSS = GnssReceiver(SPEC, origin_of(SITE))
LOG = Dvl(x_m=0.3, y_m=-0.1, z_m=0.2, azimuth_deg=30.0, rate_Hz=5.0, velocity_sigma_m_s=0.02, source="test")
DVL = DopplerLog(LOG)
ARMS = {GNSS: (SPEC.x_m, SPEC.y_m, SPEC.z_m), DVL: (LOG.x_m, LOG.y_m, LOG.z_m)}
FUNCTIONS = {s: {c.name: channel_function(c, len(s.error_states)) for c in s.channels} for s in ARMS}
S = st.floats(-1.0, 1.0)
STATE = st.tuples(S, S, st.floats(-3.1, 3.1), S, S, S, st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))


def oracle(sensor, x, rates, errors):
    """By rotation matrices and a cross product in three dimensions."""
    psi, (phi, theta) = x[2], x[6:8]
    arm = np.array(ARMS[sensor])
    Rx = np.array([[1, 0, 0], [0, np.cos(phi), -np.sin(phi)], [0, np.sin(phi), np.cos(phi)]])
    Ry = np.array([[np.cos(theta), 0, np.sin(theta)], [0, 1, 0], [-np.sin(theta), 0, np.cos(theta)]])
    level = Ry @ Rx @ arm
    R = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])
    v = (np.array([x[3], x[4], 0.0]) + np.cross([rates[0], rates[1], x[5]], level))[:2]
    if sensor is GNSS:
        return {"position": x[:2] + R @ level[:2] + errors, "velocity": R @ v}
    a = np.deg2rad(LOG.azimuth_deg)
    return {"speed": np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) @ v}


@pytest.mark.parametrize("sensor", [GNSS, DVL], ids=["gnss", "dvl"])
@given(x=STATE, rates=st.tuples(S, S), errors=st.tuples(S, S))
def test_h_and_its_jacobian(sensor, x, rates, errors):
    errors = errors[: len(sensor.error_states)]
    expected = oracle(sensor, np.array(x), rates, np.array(errors))
    s = np.array([*x, *errors])
    for channel in sensor.channels:
        h = channel.expected(BodyMotion(x[:3], x[3:6], x[6:8], rates), errors)
        assert np.allclose(h, expected[channel.name], atol=1e-9)
        function = FUNCTIONS[sensor][channel.name]
        packed = np.array(function(s, rates)).ravel()
        assert np.allclose(packed[:2], h, atol=1e-12)
        step = 1e-6
        numeric = [
            (np.array(function(s + d, rates)).ravel()[:2] - np.array(function(s - d, rates)).ravel()[:2]) / (2 * step)
            for d in step * np.eye(len(s))
        ]
        assert np.allclose(packed[2:].reshape((2, -1), order="F"), np.array(numeric).T, atol=1e-6)


@given(st.floats(-500, 500), st.floats(-500, 500), st.floats(-3, 3), st.floats(-3, 3))
def test_message_and_readings_are_inverse(n, e, v_n, v_e):
    for sensor, values in ((GNSS, {"position": (n, e), "velocity": (v_n, v_e)}), (DVL, {"speed": (v_n, v_e)})):
        m = sensor.message(values, 7)
        assert sensor.screen(m) == (m, "")
        got = {reading.channel: reading.z for reading in sensor.readings(m)}
        assert all(np.allclose(got[name], value, atol=1e-6) for name, value in values.items())


def fix(**changes) -> GnssFix:
    good = GNSS.message({"position": (1.0, 2.0), "velocity": (0.1, 0.2)}, 10**9)
    return replace(good, **changes)


def channels(m) -> list[str]:
    return [reading.channel for reading in GNSS.readings(m)]


def test_a_lesser_fix_gives_its_velocity_alone_and_none_gives_nothing():
    assert channels(fix()) == ["position", "velocity"]
    assert channels(fix(fix_type=5)) == ["velocity"], "the file promises a fixed solution"
    assert channels(fix(h_acc_m=0.5)) == ["velocity"], "the receiver itself says that it is worse"
    assert channels(fix(v_north_m_s=None)) == ["position"]
    assert GNSS.screen(fix(fix_type=1)) == (None, "gnss: no fix")
    assert GNSS.screen(fix(lat_deg=91.0))[0] is None


def test_it_is_measured_before_it_is_stamped_and_frozen_only_with_a_fix():
    assert GNSS.measured_ns(fix(), None) == 10**9 - 120_000_000
    assert GNSS.repeatable(fix(fix_type=1)) is None and GNSS.repeatable(fix()) == GNSS.repeatable(fix(t_ns=2 * 10**9))


def test_the_pre_flight_rows():
    def levels(heard, hz):
        return {check.name: check.level for check in GNSS.checks(heard, hz)}

    assert levels([fix()] * 5, 5.0) == {"fix": "ok", "place": "ok", "rate": "ok"}
    assert levels([], 0.0) == {"fix": "refuse"}
    assert levels([fix(fix_type=3)] * 5, 2.0) == {"fix": "refuse", "rate": "warning"}
    assert levels([fix(lat_deg=10.0)] * 5, 5.0)["place"] == "refuse"
    assert levels([*[fix()] * 20, fix(fix_type=1)], 5.0) == {"fix": "refuse", "rate": "ok"}, "the newest one counts"
    assert levels([*[fix(fix_type=1)] * 2, *[fix()] * 18], 5.0)["fix"] == "ok"
    flickers = next(iter(GNSS.checks([*[fix(fix_type=1)] * 3, *[fix()] * 17], 5.0)))
    assert flickers.level == "warning" and "17 of 20 messages" in flickers.found and "open sky" in flickers.fix
    assert "RTK fixed, 14 satellites, 0.02 m by its own word" in next(iter(GNSS.checks([fix()], 5.0))).found
    assert {check.name: check.level for check in DVL.checks([], 0.0)} == {"bottom": "warning", "rate": "warning"}
