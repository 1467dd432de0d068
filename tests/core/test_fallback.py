"""The fallback ladder: the right rung for every case, always finite and within limits, and a PD that flies."""

import math

import numpy as np
import pytest
from boats import boat
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.allocation import force_limits
from companion.core.dynamics import BufferedStep, step_function
from companion.core.fallback import FallbackSettings, command
from companion.core.messages import PlanResult, StateEstimate
from companion.core.vessel import StructuredModel

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
