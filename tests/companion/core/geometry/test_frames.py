"""Frames against independent oracles: complex numbers, finite differences, and exact ECEF geometry."""

import cmath
import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.geometry import frames

ANGLE = st.floats(-1e4, 1e4)
LENGTH = st.floats(-100.0, 100.0)


@given(ANGLE)
def test_ssa_is_the_same_direction_and_in_range(angle):
    wrapped = frames.ssa(angle)
    assert -math.pi <= wrapped < math.pi
    assert abs(cmath.exp(1j * wrapped) - cmath.exp(1j * angle)) < 1e-9


@pytest.mark.parametrize("angle", [math.pi, -math.pi, 3 * math.pi, -math.pi - 1e-16, math.nextafter(-math.pi, -4)])
def test_ssa_at_the_seam(angle):
    assert -math.pi <= frames.ssa(angle) < math.pi


@given(ANGLE, ANGLE)
def test_near_is_the_same_direction_close_to_the_reference(angle, reference):
    result = frames.near(angle, reference)
    assert abs(result - reference) <= math.pi + 1e-9
    assert abs(cmath.exp(1j * result) - cmath.exp(1j * angle)) < 1e-7


@given(ANGLE, LENGTH, LENGTH)
def test_rotations_agree_with_complex_numbers_and_with_each_other(psi, x, y):
    expected = cmath.exp(1j * psi) * complex(x, y)
    assert complex(*frames.rotate(psi, x, y)) == pytest.approx(expected, abs=1e-9)
    assert complex(*(frames.R2(psi) @ [x, y])) == pytest.approx(expected, abs=1e-9)
    assert frames.unrotate(psi, *frames.rotate(psi, x, y)) == pytest.approx((x, y), abs=1e-9)
    assert np.array_equal(frames.R2(np.array([psi, 0.3])), [frames.R2(psi), frames.R2(0.3)])
    assert np.array_equal(frames.rotate(np.array([psi]), x, y), np.transpose([frames.rotate(psi, x, y)]))
    assert tuple(map(float, frames.unrotate(ca.DM(psi), x, y))) == pytest.approx(frames.unrotate(psi, x, y))


def test_heading_east_puts_forward_on_the_east_axis_and_starboard_on_south():
    assert frames.rotate(math.pi / 2, 1.0, 0.0) == pytest.approx((0.0, 1.0))
    assert frames.rotate(math.pi / 2, 0.0, 1.0) == pytest.approx((-1.0, 0.0))


@given(LENGTH, LENGTH, st.floats(-7, 7), st.floats(-2, 2), st.floats(-2, 2))
def test_lever_arm_round_trip(x, y, psi, arm_x, arm_y):
    point = frames.point_position((x, y, psi), (arm_x, arm_y))
    assert frames.origin_position(point, psi, (arm_x, arm_y)) == pytest.approx((x, y), abs=1e-9)


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-1, 1), st.floats(-7, 7), st.floats(-2, 2), st.floats(-2, 2))
def test_point_velocity_is_the_derivative_of_point_position(u, v, r, psi, arm_x, arm_y):
    h = 1e-6
    nu = (u, v, r)

    def at(t):
        dx, dy = frames.rotate(psi, u * t, v * t)
        return np.array(frames.point_position((dx, dy, psi + r * t), (arm_x, arm_y)))

    numeric = frames.unrotate(psi, *((at(h) - at(-h)) / (2 * h)))
    assert frames.point_velocity(nu, (arm_x, arm_y)) == pytest.approx(numeric, abs=1e-6)


@given(*[st.floats(-1, 1)] * 8, st.floats(-7, 7))
def test_point_acceleration_is_the_derivative_of_the_velocity_over_ground(u, v, r, u_dot, v_dot, r_dot, l_x, l_y, psi):
    h, arm = 1e-5, (l_x, l_y)

    def over_ground(t):
        nu = (u + u_dot * t, v + v_dot * t, r + r_dot * t)
        return np.array(frames.rotate(psi + r * t, *frames.point_velocity(nu, arm)))

    numeric = frames.unrotate(psi, *((over_ground(h) - over_ground(-h)) / (2 * h)))
    assert frames.point_acceleration((u, v, r), (u_dot, v_dot, r_dot), arm) == pytest.approx(numeric, abs=1e-6)


def ecef(latitude_deg, longitude_deg):
    mu, lon = math.radians(latitude_deg), math.radians(longitude_deg)
    f = 1 / 298.257223563
    e2 = f * (2 - f)
    n = 6378137.0 / math.sqrt(1 - e2 * math.sin(mu) ** 2)
    return np.array([n * math.cos(mu) * math.cos(lon), n * math.cos(mu) * math.sin(lon), n * (1 - e2) * math.sin(mu)])


@given(st.floats(-60, 60), st.floats(-180, 180), st.floats(-math.pi, math.pi), st.floats(-1, 1), st.floats(-1, 1))
def test_flat_earth_against_exact_ecef(latitude, longitude, rotation, x, y):
    origin = frames.Origin(latitude, longitude, rotation)
    mu, lon = math.radians(latitude), math.radians(longitude)
    to_north = np.array([-math.sin(mu) * math.cos(lon), -math.sin(mu) * math.sin(lon), math.cos(mu)])
    to_east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    for reach_m, tolerance_m in ((100.0, 0.005), (1000.0, 0.5)):
        there = frames.geodetic_from_site(origin, reach_m * x, reach_m * y)
        offset = ecef(*there) - ecef(latitude, longitude)
        expected = complex(to_north @ offset, to_east @ offset)
        assert abs(complex(*frames.rotate(rotation, reach_m * x, reach_m * y)) - expected) < tolerance_m
        assert frames.site_from_geodetic(origin, *there) == pytest.approx((reach_m * x, reach_m * y), abs=1e-5)
        arrays = frames.geodetic_from_site(origin, *np.full((2, 3), [[reach_m * x], [reach_m * y]]))
        np.testing.assert_array_equal(np.transpose(arrays), [there] * 3)
        on_site = frames.site_from_geodetic(origin, *arrays)
        np.testing.assert_array_equal(np.transpose(on_site), [frames.site_from_geodetic(origin, *there)] * 3)
