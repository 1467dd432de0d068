"""The fallback ladder: the right rung for every case, always finite and within limits, and a PD that flies."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.control.allocation import force_limits
from companion.core.control.fallback import FallbackSettings, command, pd_force
from companion.core.messages import PlanResult, StateEstimate
from companion.core.model.integrate import BufferedStep, step_function
from companion.core.model.manoeuvring import StructuredModel, mass_matrix
from tests.support.vessel_fixtures import boat

AZIMUTH = boat("azimuth")
VESSEL, STEP_S, S = boat("aritra"), 0.2, FallbackSettings()
ROW = (0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
STATION = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def estimate(x=(0.0,) * 6, *, health="healthy", d=(0.0, 0.0, 0.0)):
    north, east, psi, u, v, r = map(float, x)
    return StateEstimate(
        t_ns=0, north_m=north, east_m=east, psi_rad=psi, u_m_s=u, v_m_s=v, r_rad_s=r, covariance=(0.0,) * 36,
        accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={}, disturbance_n=d, health=health,
        reason="",
    )  # fmt: skip


def plan(status="ok", f_n=None):
    rows = tuple((float(k),) * 4 for k in range(20)) if f_n is None else f_n
    return PlanResult(
        t_ns=0, index=0, status=status, reason="because", solve_time_s=0.0, iterations=1, cost=0.0, f_n=rows, x=()
    )  # fmt: skip


def ask(plan_, age_s, estimate_, row=ROW):
    return command(plan_, age_s, estimate_, row, VESSEL, step_s=STEP_S, settings=S)


@pytest.mark.parametrize(
    ("age_s", "source", "stage"),
    [(0.0, "plan", 0), (0.1, "plan", 0), (0.2, "shifted_plan", 1), (0.6, "shifted_plan", 3), (1.0, "shifted_plan", 5)],
)  # fmt: skip
def test_a_plan_is_used_at_its_age(age_s, source, stage):
    got = ask(plan(), age_s, estimate())
    assert got.source == source and np.array_equal(got.f_n, np.full(4, stage))


def test_no_azimuth_thruster_pushes_before_its_servo_points_there():
    aside = estimate((0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
    got = command(None, 0.0, aside, STATION, AZIMUTH, step_s=STEP_S, settings=S, now=(0.0,) * 4, within_s=0.05)
    tau = pd_force(aside, STATION, AZIMUTH, S)
    assert got.source == "pd" and tau[1] < -5 and (np.abs(np.abs(got.f_n[2:]) - 0.15) < 0.02).all()
    assert (np.abs(got.f_n[:2]) <= abs(tau[1]) * np.sin(np.abs(got.f_n[2:]))).all()


@pytest.mark.parametrize(
    ("plan_", "age_s", "why"),
    [
        (None, 0.0, "no plan"),
        (plan("failed", ()), 0.0, "plan failed: because"),
        (plan("not_converged"), 0.0, "plan not_converged"),
        (plan(), 1.01, "1.01 s old"),
        (plan(), -0.1, "-0.10 s old"),
        (plan(), math.nan, "nan s old"),
        (plan(f_n=((0.0,) * 4,)), 0.3, "no such stage"),
        (plan(f_n=((0.0,) * 3,) * 20), 0.0, "no such stage"),
        (plan(f_n=((math.nan,) * 4,) * 20), 0.0, "not finite"),
    ],
    ids=str,
)
def test_without_a_usable_plan_it_is_pd_then_neutral(plan_, age_s, why):
    got = ask(plan_, age_s, estimate())
    assert got.source == "pd" and why in got.reason
    for lame in (None, estimate(health="lost"), estimate(health="initialising"), estimate((math.nan,) * 6)):
        got = ask(plan_, age_s, lame)
        assert got.source == "neutral" and why in got.reason and not got.f_n.any()
    assert command(plan_, age_s, estimate(), None, VESSEL, step_s=STEP_S, settings=S).source == "neutral"
    assert ask(plan_, age_s, estimate(), (math.inf,) * 8).source == "neutral"


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(), min_size=6, max_size=6), st.lists(st.floats(), min_size=8, max_size=8))
def test_whatever_comes_in_forces_are_finite_and_within_limits(x, row):
    got = ask(None, 0.0, estimate(x), row)
    low, high = force_limits(VESSEL)
    assert np.isfinite(got.f_n).all() and (got.f_n >= low).all() and (got.f_n <= high).all()


def fly(x0, row_of, seconds, d=(0.0, 0.0, 0.0), told=(0.0, 0.0, 0.0)):
    """Closed loop at 10 Hz on PD alone; the estimate is the truth."""
    step = BufferedStep(step_function(StructuredModel.of(VESSEL), 0.1, 4))
    x = np.array([*x0, 0, 0, 0, 0], dtype=float)
    for _ in range(round(seconds * 10)):
        x = step(x, ask(None, 0.0, estimate(x[:6], d=told), row_of(x)).f_n, np.array(d))
    return x


@pytest.mark.parametrize("start", [(0, 0, 0, 0.5, 0, 0), (0, 2, 1, 0, 0, 0), (0, -2, -3.0, 0.3, 0.1, 0.2)], ids=str)
def test_pd_finds_the_leg(start):
    x = fly(start, lambda x: ROW, 50)
    assert abs(x[1]) < 0.05 and abs(math.remainder(x[2], math.tau)) < 0.02
    assert x[3] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("start", [(1, -1, 2, 0, 0, 0), (-2, 0.5, -1, 0.5, 0, 0)], ids=str)
def test_pd_keeps_station(start):
    x = fly(start, lambda x: STATION, 60)
    assert np.abs(x[:2]).max() < 0.05 and abs(math.remainder(x[2], math.tau)) < 0.02


def test_pd_counters_the_disturbance_that_the_filter_reports():
    d = (1.0, 2.0, 0.3)
    aware, unaware = (fly((0, 0, 0, 0, 0, 0), lambda x: STATION, 40, d, told) for told in (d, (0, 0, 0)))
    assert np.abs(aware[:2]).max() < 0.02
    assert np.abs(unaware[:2]).max() > 0.05


METRES = st.floats(-50.0, 50.0)


@given(METRES, METRES, st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.sampled_from([0.0, 1.0]))
def test_the_pd_law_knows_no_place_but_the_reference(north, east, off_north, off_east, station):
    """Only the error counts: boat and reference moved alike give the same force."""
    row = (0.0, 0.0, 0.4, 0.7, 0.5, 0.1, 0.2, station)
    moved = (north, east, *row[2:])
    here = pd_force(estimate((off_north, off_east, 0.6, 0.4, 0.0, 0.1)), row, VESSEL, S)
    there = pd_force(estimate((north + off_north, east + off_east, 0.6, 0.4, 0.0, 0.1)), moved, VESSEL, S)
    assert there == pytest.approx(here, abs=1e-9)


def test_on_its_reference_the_pd_law_only_makes_up_for_drag_and_disturbance():
    """u, v and r of the reference itself are no error."""
    row, d = (3.0, -2.0, 0.3, 0.5, 0.6, -0.1, 0.2, 0.0), VESSEL.damping
    tau = pd_force(estimate((3.0, -2.0, 0.5, 0.6, -0.1, 0.2), d=(0.4, -0.3, 0.1)), row, VESSEL, S)
    drag = -(d.X_u_N_s_m + d.X_uu_N_s2_m2 * 0.6) * 0.6
    assert tau == pytest.approx([drag - 0.4, 0.3, -0.1], abs=1e-9)


def test_on_station_both_poles_of_every_axis_are_at_minus_omega():
    """M_ii (e_ddot + 2 omega e_dot + omega^2 e) = 0 of each axis on its own; the speed of the path does not count."""
    row, M = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), np.diag(mass_matrix(VESSEL))
    omega = np.array([S.omega_position_rad_s, S.omega_position_rad_s, S.omega_yaw_rad_s])
    for axis in range(3):
        e, e_dot = np.eye(6)[axis] * 0.1, np.eye(6)[3 + axis] * 0.1
        assert pd_force(estimate(e), row, VESSEL, S) == pytest.approx(-0.1 * (M * omega**2) * np.eye(3)[axis], abs=1e-9)
        damped = -0.1 * (2 * M * omega) * np.eye(3)[axis]
        assert pd_force(estimate(e_dot), row, VESSEL, S) == pytest.approx(damped, abs=1e-9)
