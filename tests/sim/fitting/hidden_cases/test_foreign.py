"""The foreign plant of the hidden cases: six degrees of freedom against the plane, its sensors, what is passable."""

from dataclasses import replace

import numpy as np
import pytest

from tests.hidden import draw, scoring
from tests.hidden.plant.foreign import passable_names
from tests.hidden.plant.hull import HullMotion
from tests.hidden.plant.six_dof import SixDof
from tests.hidden.plant.thrusters import Thruster, bollard
from tests.hidden.plant.world import STEP_S, STEPS_HZ
from tests.hidden.write import log_table, record

AT = (0.0, 0.0, 0.3, 0.8, -0.4, 0.9)
SEED = "foreign-tests"


def foreign(index, **more):
    return draw.draw(SEED, index, foreign=True, **more)


def test_it_is_the_same_case_on_another_boat():
    own, other = draw.draw(SEED, 3), foreign(3)
    assert (own.causes, own.base, own.pilots, own.train_s) == (other.causes, other.base, other.pilots, other.train_s)
    assert own.world.afloat is None and other.world.afloat and own.passable == []
    assert {foreign(i, kind="none").world.sense.tilt_told for i in range(8)} == {True, False}


def test_without_heights_it_moves_as_in_the_plane():
    """Forces in the plane of the centre of gravity neither roll nor pitch: then Fossen's three equations are left."""
    world = foreign(1, kind="none").world
    world.afloat = replace(world.afloat, z_g=0.0, thrust_z=0.0, drag_z=0.0)
    plane, six = HullMotion(world), SixDof(world)
    s, t = AT, six.begin(AT)
    for k in range(10 * STEPS_HZ):
        tau = ((9 * np.cos(k / 200), 5 * np.sin(k / 130), 2 * np.sin(k / 90)),) * 3
        s = plane.step(s, tau, (0.05, 0.02), 1.0, STEP_S)
        t = six.step(t, tau, (0.05, 0.02), 1.0, STEP_S)
    assert np.abs(t[6:]).max() < 1e-9
    assert np.array(t[:6]) == pytest.approx(np.array(s), abs=1e-3)  # midpoint rule against Runge-Kutta 4


@pytest.mark.parametrize("index", range(3))
def test_energy_falls_without_thrust(index):
    world = foreign(index, kind="none").world
    six, s = SixDof(world), SixDof(world).begin(AT)
    s = (*s[:7], 0.1, -0.05, *s[9:])
    M, springs, start = np.array(six.M), np.array(six.springs), None
    for k in range(20 * STEPS_HZ):
        nu = np.array([s[3], s[4], *s[9:12], s[5]])
        potential = springs[0] * s[6] ** 2 / 2 + springs[1] * (1 - np.cos(s[7])) + springs[2] * (1 - np.cos(s[8]))
        energy = nu @ M @ nu / 2 + potential
        start = start or energy
        assert energy <= start * 1.001, k  # springs are of Euler angles: small exchanges remain
        s = six.step(s, ((0.0,) * 3,) * 3, (0.0, 0.0), 1.0, STEP_S)
    assert energy < 0.1 * start


def test_curves_bend_by_three_per_cent_of_full_thrust():
    case = foreign(2, kind="none")
    plain = Thruster("", 0.0, 0.0, 0.0, 0)
    straight = replace(case.world.drive, bend=(0.0, 0.0), quantum_us=0.0)
    pulses = np.arange(1100.0, 1901.0, 5.0)

    def curve(drive):
        return np.array([bollard(drive, plain, p, 15.0) for p in pulses])

    for bend in (-0.1, 0.1):
        off = curve(replace(straight, bend=(bend, bend))) - curve(straight)
        ahead = np.abs(off[pulses > 1500]).max() / curve(straight).max()
        assert 0.02 < ahead < 0.04
        assert (
            np.abs(off[[0, -1]]).max() < 0.012 * curve(straight).max()
        )  # full command lies within the dead band's 0.06


def test_an_ahrs_takes_acceleration_for_gravity_and_logs_may_lack_it():
    case = foreign(0, kind="none", train_s=60.0)
    case.world.sense.tilt_told = True
    track, said = record(case.world, case, 0, 60.0, 0.0, case.open_rng())
    error = np.degrees(said.imu[:, 5:7] - track.tilt)
    assert 0.2 < error.std() < 2.0 and np.abs(error).max() < 4.0
    assert {"phi_rad", "theta_rad"} <= set(log_table(case.base.thruster_names, track, said).columns)
    said.tilt_told = False
    assert "phi_rad" not in log_table(case.base.thruster_names, track, said).columns


def test_what_is_off_the_file_by_a_nameable_size_is_neither_asked_for_nor_wrong():
    case = foreign(0, kind="none")
    calm = case.base.copy()
    calm.drive.thrusters[0].gain *= 1.06
    name = f"thruster_gain:{calm.drive.thrusters[0].name}"
    assert passable_names(case.base, calm) == [name]
    truth = {"kind": "none", "causes": [], "outside": None, "uwb_hz": 5, "passable": [name]}
    assert scoring.judge(truth, {"verdict": "named", "causes": [{"name": name}]})["outcome"] == "exact"
    both = {"verdict": "named", "causes": [{"name": name}, {"name": "wind"}]}
    assert scoring.judge(truth, both)["wrong"] == ["wind"]
