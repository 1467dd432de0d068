"""Public names, units, signs and intervals; against the hidden benchmark's words and by properties."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.model.effects.wind import RHO_AIR
from sim.fitting.diagnose.catalogue import catalogue, stochastic
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter
from sim.fitting.diagnose.vessel_edits.public_form import (
    PublicForm,
    family,
    public_form,
    public_values,
    sentence,
    smallest_size,
)
from sim.fitting.diagnose.vessel_edits.public_table import DIRECTIONS, PUBLIC, LogReference
from tests.companion.logs.readers.run_logs import clean_run
from tests.hidden.names import FAMILIES
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
PLACE = LogReference(np.array([14.0, 16.0]), 200.0)
EFFECTS = {e.id: e for e in catalogue(VESSEL, [clean_run(60.0)])}
NAMED = [*(e for e in EFFECTS.values() if e.family != "base"), *stochastic.effects()]
SPEED = st.floats(0.01, 1.0)
ANGLE = st.floats(0.0, 359.9)


def of(name: str) -> Effect:
    return next(e for e in NAMED if e.name == name)


def same_angle(one: float, other: float) -> bool:
    return abs((one - other + 180) % 360 - 180) < 1e-6


def test_every_entry_of_the_catalogue_has_a_public_form():
    assert {family(e.name) for e in NAMED} <= set(PUBLIC)
    of_gnss = {"gnss_latency", "gnss_lever_arm"}  # the hidden benchmark's boats have UWB
    assert set(PUBLIC) - of_gnss <= set(FAMILIES)


@pytest.mark.parametrize("effect", NAMED, ids=lambda e: e.id)
def test_every_effect_can_be_told(effect):
    values = np.array([(2 if p.upper > 0 else -2) * min(p.smallest, p.prior) for p in effect.parameters])
    told = public_form(effect, values, np.diag((0.1 * values) ** 2), PLACE)
    assert {k: t.value for k, t in told.items()} == pytest.approx(public_values(effect, values, PLACE))
    for number in told.values():
        assert number.ci95[0] <= number.value <= number.ci95[1] and number.se > 0
    text = sentence(effect.name, told)
    assert text.endswith(".") and "{" not in text and len(text) > 20
    size, unit = smallest_size(effect)
    assert size > 0 and unit


@given(SPEED, ANGLE)
def test_a_current_is_told_by_speed_and_direction(speed, angle):
    values = np.array([speed * math.cos(math.radians(angle)), speed * math.sin(math.radians(angle))])
    told = public_values(of("current"), values, PLACE)
    assert told["V_c_m_s"] == pytest.approx(speed) and same_angle(told["beta_c_deg"], angle)


@given(st.floats(0.5, 12.0), ANGLE)
def test_a_wind_is_told_by_where_it_comes_from(speed, angle):
    pressure = RHO_AIR / 2 * speed**2
    values = -pressure * np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    told = public_values(of("wind"), values, PLACE)
    assert told["V_w_m_s"] == pytest.approx(speed) and same_angle(told["beta_w_deg"], angle)


@given(st.floats(0.1, 20.0), ANGLE, ANGLE)
def test_hard_iron_is_the_same_error_at_every_heading(amplitude, phase, psi):
    a = math.radians(phase)
    values = np.array([-amplitude * math.sin(a), amplitude * math.cos(a)])  # of cos psi, sin psi
    told = public_values(of("hard_iron"), values, PLACE)
    error = told["amplitude_deg"] * math.sin(math.radians(psi - told["phase_deg"]))
    assert error == pytest.approx(amplitude * math.sin(math.radians(psi - phase)), abs=1e-6)


def test_a_turning_current_has_its_direction_at_the_beginning():
    effect = next(e for e in NAMED if e.name == "turning_current")
    turn = effect.origin["turn_deg_s"]
    told = public_values(effect, np.array([0.1, 0.0, 0.05]), PLACE)
    assert told["turn_deg_s"] == pytest.approx(turn + 0.05)
    assert same_angle(told["beta_c_deg"] + 200.0 * (turn + 0.05), 0.0)


@pytest.mark.parametrize(
    ("name", "values", "key", "wanted"),
    [
        ("thruster_gain:front_port", [-0.2], "gain", 0.8),
        ("common_loss", [0.2], "gain", 0.8),
        ("hull_fouling", [0.3], "gain", 1.3),
        ("rate_limit", [0.02], "rate_limit_N_s", 50.0),
        ("dead_band", [6.0], "dead_band_us", 6.0),
    ],
)
def test_signs_and_units(name, values, key, wanted):
    assert public_values(of(name), np.array(values), PLACE)[key] == pytest.approx(wanted)


def test_places_count_from_where_positions_lie():
    tether, zone = of("tether"), of("shallow_zone")
    told = public_values(tether, np.array([0.5, 2.0, -1.0, 0.0]), PLACE)
    assert (told["anchor_north_m"], told["anchor_east_m"]) == (18.0, 14.0)
    assert told["x_t_m"] == tether.origin["arm_m"]
    told = public_values(zone, np.array([0.4, 1.0, 0.0, 0.0]), PLACE)
    assert told["north_m"] == pytest.approx(zone.origin["north_m"] + 1.0) and told["gain"] == pytest.approx(1.4)


@given(st.floats(-0.5, 0.5), st.floats(0.001, 0.1))
def test_intervals_of_what_is_linear_are_normal(gain, se):
    told = public_form(of("thruster_gain:rear_port"), [gain], np.array([[se**2]]), PLACE)["gain"]
    assert told.se == pytest.approx(se, rel=0.05)
    assert np.array(told.ci95) - told.value == pytest.approx([-1.96 * se, 1.96 * se], rel=0.06)


def test_intervals_of_directions_wrap_round():
    told = public_form(of("current"), [0.1, -0.0005], np.eye(2) * 0.01**2, PLACE)["beta_c_deg"]
    assert told.value > 359 and told.ci95[0] < 360 < told.ci95[1]
    assert told.ci95[1] - told.ci95[0] == pytest.approx(2 * 1.96 * math.degrees(0.1), rel=0.1)


def test_a_slow_rate_limit_has_an_uneven_interval():
    told = public_form(of("rate_limit"), [0.02], np.array([[0.004**2]]), PLACE)["rate_limit_N_s"]
    assert told.ci95 == pytest.approx((1 / (0.02 + 1.96 * 0.004), 1 / (0.02 - 1.96 * 0.004)), rel=0.02)


def test_a_parameter_that_is_not_there_is_said():
    wrong = Effect("lag", "propulsion", "", "", (EffectParameter("delay_s", "s", 0.1, 0.03, 0.01),), {})
    with pytest.raises(ValueError, match=r"effect lag: has \['delay_s'\], its public entry expects \['lag_s'\]"):
        public_form(wrong, [0.1], np.eye(1), PLACE)
    wrong = Effect("hard_iron", "sensors", "", "", (EffectParameter("cos_rad", "rad", 0.1, 0.03, 0.01),), {})
    with pytest.raises(ValueError, match="effect hard_iron: its public form asks for 'cos_deg', it has cos_rad"):
        public_form(wrong, [0.1], np.eye(1), PLACE)


def test_a_users_effect_keeps_its_names():
    mine = Effect("bent_skeg", "hull", "", "", (EffectParameter("k_kg_m", "kg/m", 5.0, 1.0, 0.3),), {})
    told = public_form(mine, [3.0], np.array([[0.25]]), PLACE)
    assert sentence("bent_skeg", told) == "bent_skeg: k_kg_m 3 kg/m (95 %: 2.02 to 3.98)."
    assert smallest_size(mine) == (1.0, "kg/m")


@pytest.mark.parametrize(
    ("value", "ci95", "spec", "text"),
    [
        (0.73, (0.71, 0.75), "gain| thrust", "27 % less thrust (95 %: 25 to 29)"),
        (1.2, (1.1, 1.3), "gain", "20 % more (95 %: 10 to 30)"),
        (-5.0, (-6.0, -4.0), "heavier/lighter", "5 kg lighter (95 %: 4 to 6)"),
        (-1.0, (-3.0, 1.0), "heavier/lighter", "1 kg lighter (95 %: between 3 lighter and 1 heavier)"),
        (-0.002, (-0.004, 0.0), "to starboard/to port", "0.002 kg to port (95 %: 0 to 0.004)"),
        (0.97, (0.92, 1.02), "gain| thrust", "3 % less thrust (95 %: between 8 less and 2 more)"),
    ],
)
def test_numbers_in_words(value, ci95, spec, text):
    assert format(PublicForm(value, 0.1, ci95, "kg"), spec) == text


def test_a_dead_and_a_reversed_thruster_in_words():
    for gain, words in ((0.01, "gives no thrust"), (-0.9, "pushes the wrong way round")):
        told = {"gain": PublicForm(gain, 0.01, (gain - 0.02, gain + 0.02), "1")}
        assert words in sentence("thruster_gain:rear_port", told)


NEVER_NEGATIVE = {
    "V_c_m_s", "V_w_m_s", "F_w_N", "T_p_s", "gustiness", "gust_time_s", "k_N_m", "radius_m", "amplitude_deg",
    "rate_limit_N_s", "share", "extra_m", "anchor",
}  # fmt: skip
SIGNED = {*DIRECTIONS, "north_m", "east_m", "anchor_north_m", "anchor_east_m", "x_t_m", "Y_r_N_s", "N_v_N_s"}
"""Directions, coordinates and two coefficients are told with their signs; of all else a word tells the sign."""


@pytest.mark.parametrize(
    ("name", "parameter"), [(n, k) for n, e in PUBLIC.items() for k in e.units if k not in NEVER_NEGATIVE | SIGNED]
)
@settings(max_examples=30)
@given(size=st.floats(0.01, 0.3), share=st.floats(0.1, 3.0))
def test_a_word_tells_the_sign_of_every_number(name, parameter, size, share):
    """And nothing but the word: a number and its mirror image have the same digits, none of them with a minus."""
    units, nil = PUBLIC[name].units, 1.0 if parameter == "gain" else 0.0
    others = {k: PublicForm(1.2, 0.1, (1.1, 1.3), unit) for k, unit in units.items()}
    said = []
    for sign in (1.0, -1.0):
        ends = sorted(sign * size * (1 + d * share) for d in (-1, 1))
        number = PublicForm(nil + sign * size, size * share, (nil + ends[0], nil + ends[1]), units[parameter])
        said.append(sentence(name, others | {parameter: number}))
    digits = [sorted(float(number) for number in re.findall(r"[\d.e+-]*\d", text)) for text in said]
    assert said[0] != said[1] and digits[0] == pytest.approx(digits[1], rel=0.02), "but for rounding"
    assert digits[0][0] >= 0
