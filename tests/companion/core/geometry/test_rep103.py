"""ROS frames: against rotations by scipy, and the sentences of REP-103."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from companion.core.geometry.frames import rotate
from companion.core.geometry.rep103 import FLU_FROM_FRD, flu, map_from_site, orientation, yaw

ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
ANGLE, TILT, METRES = st.floats(-math.pi, math.pi), st.floats(-1.5, 1.5), st.floats(-1e4, 1e4)


@given(phi=ANGLE, theta=TILT, psi=ANGLE)
def test_the_quaternion_turns_the_ros_body_onto_the_map(phi, theta, psi):
    ned_from_frd = Rotation.from_euler("ZYX", [psi, theta, phi]).as_matrix()
    made = Rotation.from_quat(orientation(phi, theta, psi)).as_matrix()
    np.testing.assert_allclose(made, ENU_FROM_NED @ ned_from_frd @ FLU_FROM_FRD, atol=1e-12)


@pytest.mark.parametrize(("psi_deg", "yaw_deg"), [(0, 90), (90, 0), (45, 45), (180, -90), (-90, 180)])
def test_yaw_is_zero_for_east_and_grows_to_the_left(psi_deg, yaw_deg):
    assert math.degrees(yaw(math.radians(psi_deg))) % 360 == pytest.approx(yaw_deg % 360)


def test_left_and_up_are_positive():
    assert flu((1.0, 2.0, 3.0)) == (1.0, -2.0, -3.0)
    assert flu((0.0, 0.0, -9.81)) == (0.0, 0.0, 9.81)  # at rest the specific force of ROS points up


@given(north=METRES, east=METRES, turn=ANGLE)
def test_the_map_has_true_east_and_north_however_the_site_is_turned(north, east, turn):
    true_north, true_east = rotate(turn, north, east)
    x, y, _ = map_from_site(turn) @ (north, east, 0.0)
    assert (x, y) == pytest.approx((true_east, true_north), abs=1e-8)


@given(turn=ANGLE, psi=ANGLE, step=st.floats(-0.1, 0.1))
def test_a_turn_to_starboard_is_a_turn_the_other_way(turn, psi, step):
    _, _, turned = map_from_site(turn) @ (0.0, 0.0, step)
    assert turned == pytest.approx(yaw(psi + step + turn) - yaw(psi + turn), abs=1e-12)
