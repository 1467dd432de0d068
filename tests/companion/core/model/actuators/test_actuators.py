"""Actuators against equations written out here: forces, inverses, limits, pulses."""

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.configuration.tables import ConfigError
from companion.core.constants import NEUTRAL_US
from companion.core.control.allocation import allocate, pulse_widths
from companion.core.model.actuators.propulsion import ActuatorSet, channels_of, control_limits, is_steered, only_fixed
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import configuration_matrix, force_from_pwm, force_limits
from tests.support.vessel_fixtures import boat

RUDDER, AZIMUTH, X_BOAT = boat("rudder"), boat("azimuth"), boat("aritra")
SPEED = st.floats(0.0, 1.5)
SLIP = st.floats(-0.3, 0.3)


def tau(vessel, nu, f):
    return np.array(ca.DM(StructuredModel.of(vessel).thrust(np.zeros(3), np.asarray(nu, float), np.asarray(f, float))))[
        :, 0
    ]


def rudder_by_angle(nu, thrust, delta):
    """X, Y, N of propeller and rudder in the form of MMG: by the angle of attack, not smoothed."""
    k = RUDDER.thrusters[0].rudder
    u, v, r = nu
    disc = math.pi * k.propeller_diameter_m**2 / 4
    final = math.sqrt(u * u + 2 * max(thrust, 0.0) / (1025.0 * disc))
    race = u + k.race_gain * (final - u)
    u_R = math.sqrt(k.race_share * race**2 + (1 - k.race_share) * u**2)
    v_R = -k.straightening * (v + k.x_m * r)
    attack = delta - math.atan2(v_R, u_R)
    slope = 6.13 * k.aspect_ratio / (k.aspect_ratio + 2.25)
    F = 0.5 * 1025.0 * k.area_m2 * slope * (u_R**2 + v_R**2) * math.sin(attack)
    return np.array([thrust - F * math.sin(delta), -F * math.cos(delta), -k.x_m * F * math.cos(delta)])


@given(st.floats(0.2, 1.5), SLIP, SLIP, st.floats(0.5, 38.0), st.floats(-0.61, 0.61))
def test_rudder_and_propeller_give_what_the_angle_of_attack_says(u, v, r, thrust, delta):
    expected = rudder_by_angle((u, v, r), thrust, delta)
    np.testing.assert_allclose(tau(RUDDER, (u, v, r), (thrust, delta)), expected, rtol=0.03, atol=0.03)


def test_without_flow_a_rudder_gives_nothing_and_astern_it_does_not_steer():
    assert (tau(RUDDER, (0, 0, 0), (0, 0.6)) == 0).all()
    np.testing.assert_allclose(tau(RUDDER, (0, 0, 0), (-5, 0.6)), [-5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(tau(RUDDER, (-0.5, 0, 0), (-5, 0.6)), [-5, 0, 0], atol=1e-12)
    assert tau(RUDDER, (0, 0, 0), (5, 0.6))[2] > 0.5, "the race alone steers"


def test_a_positive_rudder_turns_to_starboard_and_brakes():
    straight, over = tau(RUDDER, (0.5, 0, 0), (4, 0)), tau(RUDDER, (0.5, 0, 0), (4, 0.4))
    assert straight[2] == pytest.approx(0) and over[2] > 0 and over[1] < 0 and over[0] < straight[0]


@given(st.floats(-30.0, 38.0), st.floats(-2.0, 2.0))
def test_an_azimuth_thruster_pushes_where_it_points(thrust, delta):
    t = AZIMUTH.thrusters[0]
    expected = [thrust * math.cos(delta), thrust * math.sin(delta), t.x_m * thrust * math.sin(delta)]
    np.testing.assert_allclose(tau(AZIMUTH, (0.3, 0, 0), (thrust, 0, delta, 0)), expected, atol=1e-9)


def test_fixed_thrusters_are_what_they_were():
    actuators = ActuatorSet.of(X_BOAT)
    np.testing.assert_array_equal(actuators.directions, configuration_matrix(X_BOAT))
    np.testing.assert_array_equal(control_limits(X_BOAT), force_limits(X_BOAT))
    p = X_BOAT.propulsion
    assert not is_steered(X_BOAT) and StructuredModel.of(X_BOAT).lag_s == p.lag_s
    for channel, t in zip(channels_of(X_BOAT), X_BOAT.thrusters, strict=True):
        fmap = X_BOAT.force_maps[t.force_map]
        assert channel.value(1640.0, 14.0) == force_from_pwm(t, fmap, 1640.0, 14.0)
        assert float(ca.DM(channel.expression(ca.DM(1640.0), ca.DM(14.0)))) == pytest.approx(
            channel.value(1640.0, 14.0)
        )


@pytest.mark.parametrize("vessel", [RUDDER, AZIMUTH])
def test_numbers_and_expressions_of_a_channel_agree_and_pulses_lead_back(vessel):
    for channel in channels_of(vessel):
        for pwm in (1100.0, 1310.0, 1500.0, 1777.0, 1900.0):
            value = channel.value(pwm, 14.0)
            assert float(ca.DM(channel.expression(ca.DM(pwm), ca.DM(14.0)))) == pytest.approx(value, abs=1e-12)
            if channel.lower <= value <= channel.upper and value:
                assert channel.pulse(value, 14.0) == pytest.approx(pwm, abs=1)


def test_neutral_is_the_centred_servo_and_what_is_not_finite_is_neutral():
    assert pulse_widths(np.zeros(2), RUDDER, 14.0) == (NEUTRAL_US,) * 2
    assert pulse_widths(np.full(4, np.nan), AZIMUTH, 14.0) == (NEUTRAL_US,) * 4
    assert pulse_widths(np.array([0.0, 9.0]), RUDDER, 14.0)[1] <= 1900


def test_a_mirrored_or_trimmed_servo_turns_its_pulses():
    (t,) = RUDDER.thrusters
    turned = replace(t.rudder, mirrored=True, trim_us=20)
    other = replace(RUDDER, thrusters=(replace(t, rudder=turned),))
    plain, mirrored = (pulse_widths(np.array([0.0, 0.3]), v, 14.0)[1] for v in (RUDDER, other))
    assert plain - 1500 == 1520 - mirrored > 100
    assert channels_of(other)[1].value(mirrored, 14.0) == pytest.approx(0.3, abs=0.002)


@given(st.floats(-2.0, 15.0), st.floats(-2.0, 2.0), st.floats(0.3, 0.8))
def test_allocation_of_a_rudder_boat_gives_surge_and_yaw_within_reach(X, N, u):
    nu = np.array([u, 0.0, 0.0])
    lower, upper = control_limits(RUDDER)
    f = allocate(np.array([X, 0.0, N]), RUDDER, nu_r=nu)
    assert (f >= lower - 1e-9).all() and (f <= upper + 1e-9).all()
    given_ = tau(RUDDER, nu, f)
    if abs(f[1]) < 0.98 * upper[1]:
        assert given_[2] == pytest.approx(N, abs=0.05)


@given(st.floats(-20, 20), st.floats(-8, 8), st.floats(-3, 3), st.floats(-2, 2), st.floats(-2, 2))
def test_allocation_of_an_azimuth_boat_gives_the_force_where_its_angles_reach_it(X, Y, N, bow, stern):
    f = allocate(np.array([X, Y, N]), AZIMUTH, now=np.array([0.0, 0.0, bow, stern]))
    lower, upper = control_limits(AZIMUTH)
    assert (f >= lower - 1e-9).all() and (f <= upper + 1e-9).all()
    e = ActuatorSet.of(AZIMUTH).components(np.zeros(3), f)
    np.testing.assert_allclose(tau(AZIMUTH, (0, 0, 0), f), [X, Y, N], atol=0.35)
    assert e.numel() == 4


def test_an_azimuth_thruster_pushes_astern_rather_than_flip():
    actuators = ActuatorSet.of(AZIMUTH)
    ahead = actuators.controls(np.array([10.0, 1.0, 10.0, 1.0]), None, np.zeros(4))
    astern = actuators.controls(np.array([-10.0, -1.0, -10.0, -1.0]), None, ahead)
    np.testing.assert_allclose(astern[2:], ahead[2:])
    np.testing.assert_allclose(astern[:2], -ahead[:2])
    np.testing.assert_array_equal(actuators.controls(np.full(4, 0.01), None, ahead)[2:], ahead[2:])


def test_no_thrust_is_given_before_the_servo_points_there():
    """From rest to starboard: ticks of 0.1 s; never more surge than the servo's way through it costs."""
    now, tau_n = np.zeros(4), np.array([0.0, 8.0, 0.0])
    rate = channels_of(AZIMUTH)[2].rate
    for _ in range(round(math.pi / 2 / rate / 0.1) + 2):
        f = allocate(tau_n, AZIMUTH, now=now, within_s=0.1)
        assert (np.abs(f[2:] - now[2:]) <= rate * 0.1 + 1e-9).all()
        X, Y, _ = tau(AZIMUTH, (0, 0, 0), f)
        assert abs(X) <= 4.1 and -1e-9 <= Y <= 8.0 + 0.01, "half of 8 N at most: sin cos"
        now = f
    np.testing.assert_allclose(tau(AZIMUTH, (0, 0, 0), now), tau_n, atol=0.05)


def test_a_channel_may_have_its_own_lag_and_dead_time():
    one, *rest = X_BOAT.thrusters
    own = replace(X_BOAT, thrusters=(replace(one, lag_s=0.4, dead_time_s=0.3), *rest))
    model = StructuredModel.of(own)
    np.testing.assert_array_equal(model.lag_s, [0.4, *[X_BOAT.propulsion.lag_s] * 3])
    assert [c.dead_time_s for c in channels_of(own)] == [0.3, *[X_BOAT.propulsion.dead_time_s] * 3]
    with pytest.raises(ConfigError, match=r"boat\.toml: thrusters\[0\]: fits know one lag"):
        only_fixed(own, "boat.toml", "fits")
    with pytest.raises(ConfigError, match="fits are for boats of fixed thrusters so far; rudder has servos"):
        only_fixed(RUDDER, "boat.toml", "fits")
