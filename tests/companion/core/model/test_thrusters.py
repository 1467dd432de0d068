"""Rotor map, its inverse, and the configuration matrix."""

import csv

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.configuration.vessel_file import PitchMap
from companion.core.model.thrusters import (
    configuration_matrix,
    force_from_pwm,
    forces_from_pwm,
    pwm_from_force,
    steady_forces,
)
from tests.support.vessel_fixtures import boat

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
        symbolic = steady_forces(vessel, ca.DM([pwm] * len(vessel.thrusters)), ca.DM(voltage))
        for t, force in zip(vessel.thrusters, symbolic, strict=True):
            expected = force_from_pwm(t, vessel.force_maps[t.force_map], pwm, voltage)
            assert float(ca.DM(force)) == pytest.approx(expected, abs=1e-9)


@given(st.lists(st.tuples(st.integers(1000, 2000), st.floats(10, 20), st.floats(0.1, 0.6)), max_size=8))
def test_a_log_has_the_forces_of_its_instants(rows):
    pwm, volts, settings = np.array(rows, dtype=float).reshape(-1, 3).T
    for t, fmap in ((T, MAP), (replace(T, trim_us=-12, gain=-0.7), MAP), (T, pitch_map(curve=0.3))):
        want = [force_from_pwm(t, fmap, *row) for row in zip(pwm, volts, settings, strict=True)]
        assert forces_from_pwm(t, fmap, pwm, volts, settings) == pytest.approx(np.array(want), rel=1e-12)


def test_neutral_is_no_force_whatever_the_voltage_was():
    unknown = np.full(2, np.nan)
    assert forces_from_pwm(T, MAP, np.array([1500.0, 1510.0]), unknown).tolist() == [0.0, 0.0]
    assert np.isnan(forces_from_pwm(T, MAP, np.array([1600.0, np.nan]), unknown)).all()


def test_configuration_matrix_by_hand():
    """Front port at (0.45, -0.25) and 45 degrees: N = 0.45 sin 45 + 0.25 cos 45."""
    column = configuration_matrix(VESSEL)[:, 0]
    assert column == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0.70 * np.sqrt(0.5)])
    assert np.linalg.matrix_rank(configuration_matrix(VESSEL)) == 3
    assert np.linalg.matrix_rank(configuration_matrix(boat("twin"))) == 2


def pitch_map(curve=0.0, exponent=2.0):
    return PitchMap(
        setting="speed", nominal_setting=0.4, exponent=exponent, curve=curve, ahead_N=2.0, astern_N=1.0, source="test"
    )


def test_pitch_map_by_hand():
    """Half a command is half the force, or a quarter where all goes with pitch squared; force as speed squared."""
    t = boat("cse1").thrusters[0]
    assert force_from_pwm(t, pitch_map(), 1700, 12.0) == pytest.approx(1.0)
    assert force_from_pwm(t, pitch_map(curve=1.0), 1300, 12.0) == pytest.approx(-0.25)
    assert force_from_pwm(t, pitch_map(), 1700, 12.0, setting=0.2) == pytest.approx(0.25)
    assert force_from_pwm(t, pitch_map(), 1900, 12.0, setting=0.0) == 0.0
    off = replace(t, trim_us=-40)
    assert force_from_pwm(off, pitch_map(), 1500, 12.0) == pytest.approx(0.2)
    assert pwm_from_force(off, pitch_map(), 0.0, 12.0) == 1460


@given(st.floats(-0.95, 1.9), st.floats(-0.9, 1.0), st.integers(-150, 150))
def test_pitch_map_has_an_inverse_and_a_symbolic_twin(force, curve, trim):
    t = replace(boat("cse1").thrusters[0], trim_us=trim)
    fmap = pitch_map(curve)
    pwm = pwm_from_force(t, fmap, force, 12.0)
    got = force_from_pwm(t, fmap, pwm, 12.0)
    if t.pwm_min_us < pwm < t.pwm_max_us:
        assert got == pytest.approx(force, abs=0.02)
    vessel = replace(boat("cse1"), thrusters=(replace(t, force_map="pitch"),), force_maps={"pitch": fmap})
    (symbolic,) = steady_forces(vessel, ca.DM([pwm]), ca.DM(12.0))
    assert float(ca.DM(symbolic)) == pytest.approx(got, abs=1e-12)


@given(st.integers(1100, 1900), st.floats(0.1, 2.0), st.floats(13.0, 17.0))
def test_the_share_astern_counts_astern_only_and_everywhere_alike(pwm, share, voltage):
    plain, own = force_from_pwm(T, MAP, pwm, voltage), replace(MAP, astern_share=share)
    assert force_from_pwm(T, own, pwm, voltage) == pytest.approx(plain if plain > 0 else share * plain, abs=1e-12)
    (log,) = forces_from_pwm(T, own, np.array([float(pwm)]), np.array([voltage]))
    assert log == pytest.approx(force_from_pwm(T, own, pwm, voltage), abs=1e-9)
