"""Dead, weak and reversed thrusters: maps there and back, limits, allocation, the NMPC's commands."""

import time

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.control.allocation import allocate, force_limits, pulse_widths
from companion.core.control.nmpc import Actuation, Nmpc, NmpcSettings
from companion.core.model.integrate import BufferedStep, step_function
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import (
    configuration_matrix,
    force_from_pwm,
    pwm_from_force,
    steady_forces,
)
from companion.jit import compile_loops
from tests.companion.core.control.nmpc_world import leg_rows, request
from tests.support.vessel_fixtures import boat

BASE = boat("aritra")
MAP = BASE.force_maps["t200"]
PULSE = st.integers(1100, 1900)


def geared(*gains, base=BASE):
    return replace(base, thrusters=tuple(replace(t, gain=g) for t, g in zip(base.thrusters, gains, strict=True)))


DEAD, REVERSED = geared(0.0, 1, 1, 1), geared(1, 1, 1, -1.0)


@given(PULSE, st.floats(11, 17))
def test_a_reversed_thruster_gives_the_opposite_and_a_dead_one_nothing(pwm, volts):
    right = force_from_pwm(BASE.thrusters[0], MAP, pwm, volts)
    for gain in (-1.0, -0.4, 0.0):
        t = replace(BASE.thrusters[0], gain=gain)
        assert force_from_pwm(t, MAP, pwm, volts) == pytest.approx(gain * right)
        (symbolic,) = steady_forces(replace(BASE, thrusters=(t,)), ca.DM([pwm]), ca.DM(volts))
        assert float(ca.DM(symbolic)) == pytest.approx(gain * right, abs=1e-9)


@given(st.floats(-29, 29).filter(lambda f: abs(f) > 0.1), st.floats(13.0, 17.0))
def test_the_way_back_goes_the_other_way(force, volts):
    t = replace(BASE.thrusters[0], gain=-1.0)
    assert pwm_from_force(t, MAP, force, volts) == pwm_from_force(BASE.thrusters[0], MAP, -force, volts)


def test_a_dead_thrusters_pulse_stays_neutral():
    assert pulse_widths(np.array([30.0, 1.0, 1.0, 1.0]), DEAD, 15.0)[0] == 1500
    trimmed = replace(BASE.thrusters[0], gain=0.0, trim_us=7)
    assert pwm_from_force(trimmed, MAP, 20.0, 15.0) == 1507


def test_limits_follow_what_a_thruster_can_still_do():
    """The file says -30 to 38 N; a strong one may not do more than that."""
    lower, upper = force_limits(geared(0.0, -1.0, 0.5, 1.4))
    assert lower.tolist() == [0, -38, -15, -30] and upper.tolist() == [0, 30, 19, 38]
    assert not np.signbit(lower[0])
    lower, upper = force_limits(BASE)
    assert lower.tolist() == [-30.0] * 4 and upper.tolist() == [38.0] * 4


@given(st.lists(st.floats(-18, 18), min_size=3, max_size=3))
def test_what_three_thrusters_can_do_is_met_without_the_dead_one(f):
    """Any tau of the other three comes out to 0.05 N and 0.05 N m."""
    B = configuration_matrix(DEAD)
    tau = B @ [0.0, *f]
    ours = allocate(tau, DEAD)
    assert ours[0] == 0.0
    assert B @ ours == pytest.approx(tau, abs=0.05)


def test_a_boat_without_any_thruster_asks_for_nothing():
    assert not allocate(np.array([20.0, 5.0, 3.0]), geared(0.0, 0.0, 0.0, 0.0)).any()


def test_the_plan_asks_no_faster_than_the_thrusters_are():
    slow = replace(BASE, propulsion=replace(BASE.propulsion, slew_N_s=25.0))
    assert Actuation.of(slow).rate_limit_n_s == 25.0
    assert Actuation.of(replace(BASE, propulsion=replace(BASE.propulsion, slew_N_s=500.0))).rate_limit_n_s == 120.0
    assert Actuation.of(BASE).rate_limit_n_s == 120.0


@pytest.mark.parametrize(("vessel", "broken"), [(DEAD, 0), (REVERSED, 3)], ids=["dead", "reversed"])
@pytest.mark.long
def test_the_nmpc_holds_a_leg_and_a_side_force_with_what_is_left(vessel, broken):
    """25 s from 1 m beside the line at 0.5 m/s, 4 N from the side; model and plant the same."""
    s = NmpcSettings()
    nmpc = Nmpc(StructuredModel.of(vessel), Actuation.of(vessel), s, time.perf_counter, compiler=compile_loops)
    plant, d = BufferedStep(step_function(StructuredModel.of(vessel), 0.1, 4)), np.array([0.0, 4.0, 0.0])
    x, f, warm = np.array([0, 1.0, 0, 0.5, 0, 0, 0, 0, 0, 0]), np.zeros(4), None
    low, high = force_limits(vessel)
    for tick in range(250):
        plan, warm = nmpc.solve(request(x, leg_rows(x, s), d=d, f_prev=f, tick=tick), warm)
        assert plan.status == "ok"
        f = np.array(plan.f_n[0])
        assert (low <= f).all() and (f <= high).all()
        x = plant(x, f, d)
    assert abs(x[1]) < 0.06 and x[3] == pytest.approx(0.5, abs=0.03)
    assert (f[broken] == 0.0) == (vessel is DEAD)
