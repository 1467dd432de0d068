"""Bounded allocation with the order yaw, surge, sway."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.control.allocation import allocate, force_limits, pulse_widths
from companion.core.model.thrusters import configuration_matrix
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
B = configuration_matrix(VESSEL)
LOWER, UPPER = force_limits(VESSEL)
wild = st.floats(-500, 500)


@given(wild, wild, wild)
def test_always_within_limits(X, Y, N):
    for name in ("aritra", "twin", "cse1"):
        f = allocate(np.array([X, Y, N]), boat(name))
        lower, upper = force_limits(boat(name))
        assert np.all(f >= lower) and np.all(f <= upper)


@given(st.lists(st.floats(-29, 29), min_size=4, max_size=4))
def test_what_is_within_reach_is_met(f):
    """Any tau made by forces inside the limits comes out to 0.05 N, and with no more effort."""
    tau = B @ np.array(f)
    ours = allocate(tau, VESSEL)
    assert B @ ours == pytest.approx(tau, abs=0.05)
    assert np.linalg.norm(ours) <= np.linalg.norm(f) + 0.05


def test_yaw_comes_first_then_surge_then_sway():
    yaw_alone = np.array([0.0, 0.0, 55.0])
    crowded = allocate(np.array([200.0, 200.0, 55.0]), VESSEL)
    assert (B @ crowded)[2] == pytest.approx((B @ allocate(yaw_alone, VESSEL))[2], abs=0.5)
    surge_only = (B @ allocate(np.array([200.0, 0.0, 30.0]), VESSEL))[0]
    with_sway = B @ allocate(np.array([200.0, 60.0, 30.0]), VESSEL)
    assert with_sway[0] == pytest.approx(surge_only, abs=1.0)


def test_twin_cannot_sway_and_does_not_try():
    assert np.abs(allocate(np.array([0.0, 50.0, 0.0]), boat("twin"))).max() < 1e-6


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_doubt_is_neutral(bad):
    assert not allocate(np.array([bad, 0, 0]), VESSEL).any()
    assert pulse_widths(np.array([bad, 1.0, 1.0, 1.0]), VESSEL, 15.0)[0] == 1500


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=4, max_size=4), st.floats(9, 20))
def test_pulse_widths_are_integers_inside_the_limits(f, voltage):
    for pwm in pulse_widths(np.array(f), VESSEL, voltage):
        assert isinstance(pwm, int) and 1100 <= pwm <= 1900
