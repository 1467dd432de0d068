"""A thruster whose pulses are mirrored about neutral: map and inverse, the simulated boat, fits. Seed 3."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import PitchMap
from companion.core.model.load_vessel import load_vessel
from companion.core.model.thrusters import force_from_pwm, force_limits, forces_from_pwm, pwm_from_force, steady_forces
from companion.core.model.vessel_text import vessel_toml
from sim.fitting.identify.result import fit_structured
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

PLAIN = boat("aritra")
BOAT = replace(PLAIN, thrusters=tuple(replace(t, mirrored=i in (0, 3)) for i, t in enumerate(PLAIN.thrusters)))
ONE, MAP = PLAIN.thrusters[0], PLAIN.force_maps["t200"]
trims = st.integers(-20, 20)


@given(st.floats(-400, 400), trims, st.floats(10, 20))
def test_a_pulse_gives_what_its_mirror_image_gives_a_plain_thruster(beyond_us, trim_us, volts):
    plain = replace(ONE, trim_us=trim_us)
    mirrored = replace(plain, mirrored=True)
    expected = force_from_pwm(plain, MAP, 1500 + trim_us + beyond_us, volts)
    pulse = 1500 + trim_us - beyond_us
    assert force_from_pwm(mirrored, MAP, pulse, volts) == pytest.approx(expected, abs=1e-9)
    assert forces_from_pwm(mirrored, MAP, np.array([pulse]), np.array([volts]))[0] == pytest.approx(expected, abs=1e-9)


@given(st.floats(-29, 37), trims)
def test_the_pulse_for_a_force_is_the_mirror_image(force, trim_us):
    plain = replace(ONE, trim_us=trim_us)
    pulse = pwm_from_force(replace(plain, mirrored=True), MAP, force, 15.0)
    at = 2 * (1500 + trim_us) - pwm_from_force(plain, MAP, force, 15.0)
    assert pulse == pytest.approx(min(max(at, 1100), 1900), abs=1)


def test_full_ahead_is_1100_us_and_limits_keep_their_sides():
    mirrored = BOAT.thrusters[0]
    assert pwm_from_force(mirrored, MAP, 100.0, 15.0) == 1100
    assert force_from_pwm(mirrored, MAP, 1100, 15.0) > -force_from_pwm(mirrored, MAP, 1900, 15.0) > 0
    assert [side.tolist() for side in force_limits(BOAT)] == [side.tolist() for side in force_limits(PLAIN)]


def test_the_symbolic_map_is_the_same():
    pwm, volts = ca.SX.sym("pwm", 4), ca.SX.sym("V")
    forces = ca.Function("f", [pwm, volts], [ca.vertcat(*steady_forces(BOAT, pwm, volts))])
    pulses = (1200.0, 1300.0, 1700.0, 1800.0)
    expected = [force_from_pwm(t, MAP, p, 15.0) for t, p in zip(BOAT.thrusters, pulses, strict=True)]
    assert np.array(forces(pulses, 15.0)).ravel() == pytest.approx(expected)


def test_the_simulated_boat_moves_alike_and_a_fit_finds_it_whole():
    mirrored, plain = (teleop_run(v, 3, 60.0, uwb_hz=5.0, sigma_m=0.07) for v in (BOAT, PLAIN))
    for i, name in enumerate(plain.thrusters):
        pulses, others = (run.table[f"pwm_{name}"].to_numpy() for run in (mirrored, plain))
        assert pulses == pytest.approx(3000 - others if i in (0, 3) else others, abs=1)
        assert np.ptp(others) > 100
    for column in ("true_north_m", "true_psi_rad"):
        assert mirrored.samples(column)[1] == pytest.approx(plain.samples(column)[1], abs=0.05)
    fit = fit_structured([mirrored], BOAT)
    assert [fit[f"gain_{t.name}"].value for t in BOAT.thrusters] == pytest.approx([1.0] * 4, abs=0.1)


def test_a_vessel_file_keeps_it_and_refuses_it_of_a_pitch_propeller():
    assert "mirrored = true" in vessel_toml(BOAT)
    assert load_vessel(vessel_toml(BOAT), name="b.toml") == BOAT
    pitch = PitchMap(setting="speed", nominal_setting=0.4, ahead_N=10, astern_N=10, source="test")
    with pytest.raises(ConfigError, match=r"thrusters\[0\]\.mirrored: only with an ESC"):
        vessel_toml(replace(BOAT, force_maps={"t200": pitch}))
