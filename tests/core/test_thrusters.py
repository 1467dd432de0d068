"""Rotor map, its inverse, and the configuration matrix."""

import csv

import casadi as ca
import numpy as np
import pytest
from boats import boat
from hypothesis import given
from hypothesis import strategies as st

from companion.core.thrusters import (
    configuration_matrix,
    force_expression,
    force_from_pwm,
    pwm_from_force,
)

VESSEL = boat("aritra")
T, MAP = VESSEL.thrusters[0], VESSEL.force_maps["t200"]


def test_map_against_the_manufacturers_table(shared_data):
    """Within 1 N rms over all 1206 rows and 3 N anywhere; zero where the table is zero by physics."""
    with open(shared_data / "t200_performance.csv", newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    error = np.array(
        [force_from_pwm(T, MAP, r["pwm_us"], r["supply_voltage_V"]) - r["force_kgf"] * 9.80665 for r in rows]
    )
    assert len(rows) == 1206
    assert np.sqrt((error**2).mean()) < 0.85
    assert np.abs(error).max() < 3.0


@given(st.floats(9, 20), st.integers(1100, 1899))
def test_force_rises_with_pwm(voltage, pwm):
    assert force_from_pwm(T, MAP, pwm + 1, voltage) >= force_from_pwm(T, MAP, pwm, voltage)


@given(st.floats(-29, 37), st.floats(13.0, 17.0))
def test_inverse_brings_the_force_back(force, voltage):
    """To within one microsecond's worth of force and 0.1 V of rounding."""
    pwm = pwm_from_force(T, MAP, force, voltage)
    around = [force_from_pwm(T, MAP, p, voltage + dv) for p in (pwm - 1, pwm + 1) for dv in (-0.06, 0.06)]
    assert min(around) <= force <= max(around)
    assert isinstance(pwm, int) and T.pwm_min_us <= pwm <= T.pwm_max_us


@given(st.floats(-1e4, 1e4), st.floats(6, 30))
def test_inverse_stays_within_limits(force, voltage):
    assert T.pwm_min_us <= pwm_from_force(T, MAP, force, voltage) <= T.pwm_max_us


def test_zero_force_is_neutral_and_the_dead_band_is_dead():
    assert pwm_from_force(T, MAP, 0.0, 15.0) == 1500
    assert all(force_from_pwm(T, MAP, p, 20.0) == 0.0 for p in range(1476, 1525))


@given(st.integers(1100, 1900), st.floats(10, 20))
def test_symbolic_map_is_the_same_map(pwm, voltage):
    for name in ("aritra", "cse1"):
        vessel = boat(name)
        t = vessel.thrusters[0]
        fmap = vessel.force_maps[t.force_map]
        symbolic = float(ca.DM(force_expression(t, fmap, ca.DM(pwm), ca.DM(voltage))))
        assert symbolic == pytest.approx(force_from_pwm(t, fmap, pwm, voltage), abs=1e-9)


def test_configuration_matrix_by_hand():
    """Front port at (0.45, -0.25) and 45 degrees: N = 0.45 sin 45 + 0.25 cos 45."""
    column = configuration_matrix(VESSEL)[:, 0]
    assert column == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0.70 * np.sqrt(0.5)])
    assert np.linalg.matrix_rank(configuration_matrix(VESSEL)) == 3
    assert np.linalg.matrix_rank(configuration_matrix(boat("twin"))) == 2
