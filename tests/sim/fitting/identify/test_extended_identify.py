"""Identification that starts from an extended vessel file; the file that it writes loads again. Seed 3."""

import pytest
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Wash
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from sim.fitting.identify.result import fit_structured
from sim.fitting.identify.vessel_out import identified_vessel
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

BASE = boat("aritra")
SENSORS = replace(
    BASE.sensors,
    imu=replace(BASE.sensors.imu, heading_offset_rad=0.2, accel_bias_x_m_s2=0.3, misalignment_rad=0.1),
    uwb=replace(BASE.sensors.uwb, scale=0.03, clock_drift_s_s=0.001),
)
TERMS = {
    "munk_moment": {"k_kg": 6.0, "source": "test"},
    "shallow_zone": {"north_m": 14.0, "east_m": 14.0, "radius_m": 3.0, "share": 1.0, "source": "test"},
}


def extended(*gains, k_kg=6.0):
    thrusters = tuple(replace(t, gain=g) for t, g in zip(BASE.thrusters, gains, strict=True))
    hull = replace(BASE.hull, frontal_area_m2=0.0, lateral_area_m2=0.0)
    terms = TERMS | {"munk_moment": {"k_kg": k_kg, "source": "test"}}
    return replace(BASE, hull=hull, thrusters=thrusters, sensors=SENSORS, terms=terms)


@pytest.mark.long
def test_a_broken_boat_with_sensors_that_err_is_identified():
    """True: one thruster dead, one reversed and 4 % strong, k = 10 kg; the file knows of all but the sizes."""
    log = teleop_run(extended(0.0, 1.0, -1.04, 1.0, k_kg=10.0), 3, 120.0, uwb_hz=5.0, sigma_m=0.07)
    file = extended(0.0, 1.0, -1.0, 1.0)
    result = fit_structured([log], file)
    ratio = result["gain_rear_port"].value / result["gain_front_starboard"].value
    assert result["gain_front_port"].value == 0.0
    assert ratio == pytest.approx(-1.04, abs=0.02)
    assert result["k_kg"].value == pytest.approx(10.0, abs=4 * result["k_kg"].se + 0.3)
    assert result["X_uu_N_s2_m2"].value == pytest.approx(-12.0, rel=0.2)
    found = identified_vessel(file, result, date="2026-01-01")
    assert load_vessel(vessel_toml(found), name="found.toml") == found
    assert (found.sensors.imu, found.sensors.uwb.scale) == (SENSORS.imu, 0.03)


def test_every_new_key_survives_being_written():
    wash = (Wash(behind="rear_port", ahead="front_port", share=0.3),)
    more = {"slew_N_s": 30.0, "advance_loss_sqrt_N_s_m": 0.5, "wash": wash}
    full = replace(extended(0.0, 1.0, -1.0, 1.0), propulsion=replace(BASE.propulsion, **more))
    assert load_vessel(vessel_toml(full), name="full.toml") == full


@pytest.mark.parametrize("name", ["rudder", "azimuth", "aritra"])
def test_a_vessel_with_servos_is_written_as_it_was_read(name):
    assert load_vessel(vessel_toml(boat(name)), name=f"{name}.toml") == boat(name)
