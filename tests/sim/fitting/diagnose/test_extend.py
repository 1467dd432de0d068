"""Causes in vessel files: a boat sailed by the plant with the extended file shows the engine that very effect.

Teleoperation logs of 60 s, seed 5. The engine knows the base file only, and a single effect that may be there.
"""

from dataclasses import replace as replace_state

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.model.load_vessel import load_vessel
from companion.core.model.sensor_errors import apply_imu_errors, correct_imu
from companion.core.model.thrust_losses import apply_thrust_losses
from companion.core.model.vessel_text import vessel_toml
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter
from sim.fitting.diagnose.posterior.converged_rollout import converged_rollout
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.selection.greedy_selection import Selector
from sim.fitting.diagnose.vessel_edits.edits import CauseValues, NotInVesselFileError
from sim.fitting.diagnose.vessel_edits.extend import base_numbers, extended, refitted, with_causes
from sim.fitting.diagnose.vessel_edits.public_form import public_values
from sim.fitting.diagnose.vessel_edits.public_table import LogReference
from sim.fitting.engine.noise import STATE, L
from sim.fitting.excite.information import true_nodes
from sim.world.environment import Weather
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
RUN = teleop_run(VESSEL, 4, 60.0)
PLACE = LogReference(RUN.samples("north_m", "east_m")[1].mean(axis=0), 30.0)
EFFECTS = {e.id: e for e in catalogue(VESSEL, [RUN])}
WEATHER = ("V_c_m_s", "beta_c_deg", "V_w_m_s", "beta_w_deg")
long = pytest.mark.long


def cause(id: str, *values: float) -> CauseValues:
    effect = EFFECTS[id]
    own = {p.name: v + effect.origin.get(p.name, 0.0) for p, v in zip(effect.parameters, values, strict=True)}
    return CauseValues(effect, own, public_values(effect, np.array(values), PLACE), "test")


def seen(vessel, effect: Effect) -> np.ndarray:
    """What the engine, which believes in `VESSEL`, estimates of `effect` in a log of `vessel`."""
    air_and_water = {
        k: v for name in ("current", "wind") for k, v in vessel.terms.get(name, {}).items() if k in WEATHER
    }
    run = teleop_run(vessel, 5, 60.0, weather=Weather(**air_and_water))  # the plant has both from the weather
    entries = catalogue(VESSEL, [run])
    mine = next(e for e in entries if e.id == effect.id)
    fit = PosteriorFit(
        EffectPhysics([run], VESSEL, 1.0), [*(e for e in entries if e.family == "base"), mine], stated_noise(VESSEL)
    )
    selector = Selector(fit)
    base = selector.base()
    start = {mine.id: base.point.theta.get(mine.id, np.zeros(len(mine.parameters)))}
    if mine.nonlinear:
        start = {mine.id: np.array([p.step for p in mine.parameters])}
    return selector.refit(base, frozenset({mine.id}), start).point.theta[mine.id]


@pytest.mark.long
@pytest.mark.parametrize(
    ("id", "values", "within"),
    [
        pytest.param("thruster_gain:rear_port", [-0.4], 0.04, marks=long),
        ("current", [0.1, -0.06], 0.01),
        ("hard_iron", [4.0, -3.0], 0.8),
        pytest.param("uwb_lever_arm", [0.2, -0.1], 0.03, marks=long),
        pytest.param("wind", [8.0, 5.0], 1.5, marks=long),
        pytest.param("dead_band", [25.0], 5.0, marks=long),
        pytest.param("lag", [0.15], 0.03, marks=long),
        pytest.param("dead_time", [0.15], 0.03, marks=long),
        pytest.param("hull_fouling", [0.5], 0.12, marks=long),
        pytest.param("munk_moment", [15.0], 3.0, marks=long),
        pytest.param("gyro_scale", [0.1], 0.01, marks=long),
        pytest.param("imu_misalignment", [9.0], 2.0, marks=long),
        pytest.param("accel_bias", [0.15, -0.2], 0.1, marks=long),  # the simulated sensor draws one of its own, too
        pytest.param("rate_limit", [0.04], 0.012, marks=long),
        pytest.param("advance_loss", [0.3], 0.1, marks=long),
        pytest.param("uwb_latency", [0.2], 0.05, marks=long),
        pytest.param("swapped_pair:front_port+rear_starboard", [1.0], 0.15, marks=long),
    ],
)
def test_the_plant_with_the_extended_file_shows_the_effect(id, values, within):
    one = cause(id, *values)
    assert seen(extended(VESSEL, one), one.effect) == pytest.approx(values, abs=within)


def test_wash_blows_where_the_thruster_ahead_pushes_its_water_whichever_way_it_is_mounted():
    """Engine against the plant's thrusters: the one ahead turned round, so that it blows at the other when astern."""
    turned = tuple(
        replace(t, azimuth_deg=t.azimuth_deg + 180.0) if t.name == "front_port" else t for t in VESSEL.thrusters
    )
    vessel = replace(VESSEL, thrusters=turned)
    effect = next(e for e in catalogue(vessel, [RUN]) if e.id == "wash")
    told = public_values(effect, np.array([0.3]), PLACE)
    washed = extended(vessel, CauseValues(effect, {"loss": 0.3}, told, "test"))
    for f in ([20.0, 0, 20, 0], [-20.0, 0, 20, 0], [0, 20.0, 0, 20], [0, -20.0, 0, 20]):
        expected = np.array(apply_thrust_losses(washed, np.zeros(3), np.array(f, dtype=float))).ravel()
        found = effect.hooks["thrust"]({"loss": 0.3}, None, np.array([[f]], dtype=float))[0, 0]
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_in_an_open_loop_a_strong_tether_moves_the_boat_as_in_the_plant():
    """From true states 20 s on, 4 N/m: without it the boat ends metres away."""
    one = cause("tether@+0.0", 4.0, 0.0, 0.0, 0.0)
    run = teleop_run(extended(VESSEL, one), 5, 60.0)
    physics = EffectPhysics([run], VESSEL, 20.0)
    physics.centre_m = PLACE.centre_m
    states = true_nodes(physics.windows, run)
    z = np.zeros((len(states), L))
    z[:, STATE] = states
    there = converged_rollout(physics, [one.effect], {one.effect.id: np.array([4.0, 0.0, 0.0, 0.0])}, z)
    off_m = np.linalg.norm(there.x[:-1, -1, :2] - states[1:, :2], axis=1)
    assert len(off_m) and off_m.max() < 0.05


TURNING = next(i for i in EFFECTS if i.startswith("turning_current"))
SAYABLE = [
    cause("common_loss", 0.1), cause("payload", 5.0), cause("yaw_inertia", 1.0), cause("cg_shift", 0.05, -0.03),
    cause("added_mass", 0.4), cause("voltage_exponent", 0.7), cause("wash", 0.3), cause("gyro_bias", 0.01),
    cause("heading_offset", 4.0), cause("imu_lever_arm", 0.1, 0.0), cause("uwb_scale", 0.03),
    cause("clock_drift", 1e-3),
    cause("astern_asymmetry", -0.2), cause("yaw_sway_coupling", 0.5, 0.3), cause("tether@+0.0", 0.3, 1.0, 2.0, 0.0),
    cause("shallow_zone@0", 0.5, 0.0, 0.0, 0.0), cause("cross_flow", 0.6), cause(TURNING, 0.1, 0.0, 0.0),
    cause("thruster_fouling:rear_port@30", -0.3, 0.0),
]  # fmt: skip


@pytest.mark.parametrize("one", SAYABLE, ids=lambda c: c.effect.name)
def test_every_cause_changes_the_file_and_loads(one):
    new = extended(VESSEL, one)
    assert new != VESSEL and load_vessel(vessel_toml(new), name="x") == new
    assert "test" in vessel_toml(new)


def test_all_at_once_load_and_a_pair_that_changed_places_comes_last():
    swap = cause("swapped_pair:front_port+rear_port", 1.0)
    weak = cause("thruster_gain:front_port", -0.5)
    vessel, left = with_causes(VESSEL, [swap, weak, *SAYABLE])
    assert left == {}
    by_name = {t.name: t for t in vessel.thrusters}
    there = {t.name: t for t in VESSEL.thrusters}
    assert (
        by_name["rear_port"].x_m == there["front_port"].x_m
        and by_name["rear_port"].channel == there["rear_port"].channel
    )
    assert by_name["rear_port"].gain == pytest.approx(0.5 * 0.9)
    assert {w.behind for w in vessel.propulsion.wash} >= {"front_port"}


def test_what_a_file_cannot_say_is_left_out_and_said():
    mine = Effect(
        "bent_skeg", "hull", "", "", (EffectParameter("k", "1", 1.0, 1.0, 0.3),), {"force": lambda p, scene: 0.0}
    )
    causes = [
        cause("cross_flow", -2.0),
        CauseValues(mine, {"k": 1.0}, {"k": 1.0}, "test"),
        cause("munk_moment", 400.0),
    ]
    vessel, left = with_causes(VESSEL, causes)
    assert vessel == VESSEL and set(left) == {"cross_flow", "bent_skeg", "munk_moment"}
    assert "feeds energy" in left["munk_moment"] and "feeds energy" in left["cross_flow"]
    with pytest.raises(NotInVesselFileError, match="no key of a vessel file stands for it"):
        extended(VESSEL, causes[1])


def test_currents_and_winds_add_to_those_of_the_file():
    once = extended(VESSEL, cause("current", 0.1, 0.0))
    twice = extended(once, cause("current", 0.0, 0.1))
    assert twice.terms["current"]["V_c_m_s"] == pytest.approx(0.1 * np.sqrt(2))
    assert twice.terms["current"]["beta_c_deg"] == pytest.approx(45.0)
    windy = extended(extended(VESSEL, cause("wind", 3.0, 4.0)), cause("wind", 3.0, 4.0))
    assert windy.terms["wind"]["V_w_m_s"] == pytest.approx(np.sqrt(2 * 10 / 1.225))


def test_losses_to_moving_water_add_to_those_of_the_file():
    once = extended(extended(VESSEL, cause("wash", 0.2)), cause("advance_loss", 0.1)).propulsion
    twice = extended(replace(VESSEL, propulsion=once), cause("wash", 0.1))
    twice = extended(twice, cause("advance_loss", 0.05)).propulsion
    assert [w.share for w in twice.wash] == pytest.approx([1.5 * w.share for w in once.wash])
    assert twice.advance_loss_s_m == pytest.approx(1.5 * once.advance_loss_s_m) == pytest.approx(0.15)


@pytest.mark.parametrize("m_rad", [0.0, -0.4])
def test_a_bias_beside_a_turned_imu_is_what_the_engine_has(m_rad):
    """Oracle: the sensor model. The engine sees readings freed of what the base file knows."""
    imu = replace(VESSEL.sensors.imu, misalignment_rad=m_rad, accel_bias_x_m_s2=0.1)
    base = replace(VESSEL, sensors=replace(VESSEL.sensors, imu=imu))
    bias, turn = cause("accel_bias", 0.3, -0.2), cause("imu_misalignment", 20.0)
    y = np.array([[[0.0, 0.1, 0.7, -0.4]]])
    for one in sorted((bias, turn), key=lambda c: list(EFFECTS).index(c.effect.id)):
        y = one.effect.hooks["imu"](one.engine, None, y)
    there = with_causes(base, [bias, turn])[0].sensors.imu
    assert correct_imu(imu, *apply_imu_errors(there, 0.7, -0.4, 0.1))[:2] == pytest.approx(y[0, 0, 2:], abs=1e-12)


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        (["tether@+0.0", 0.3, 1.0, 2.0, 0.0], ["tether@+0.0", 0.1, -1.5, 0.5, 0.0], "tether"),
        (["shallow_zone@0", 0.5, 0.0, 0.0, 0.0], ["shallow_zone@4", 0.8, 0.0, 0.0, 0.0], "shallow zone"),
        (["current", 0.1, 0.0], [TURNING, 0.1, 0.0, 0.0], "current"),
        ([TURNING, 0.1, 0.0, 0.0], ["current", 0.1, 0.0], "current that turns"),
    ],
)
def test_what_a_file_has_one_of_is_not_replaced(first, second, said):
    once, other = extended(VESSEL, cause(*first)), cause(*second)
    assert with_causes(once, [other]) == (once, {other.effect.name: f"the file has a {said} already"})


def test_a_zone_beside_fouling_damps_as_the_engine_has_both():
    zone, fouling = cause("shallow_zone@0", 0.6, 0.0, 0.0, 6.0), cause("hull_fouling", 0.5)
    run = teleop_run(VESSEL, 5, 20.0)
    found = []
    for vessel, causes in ((VESSEL, (zone, fouling)), (with_causes(VESSEL, (zone, fouling))[0], ())):
        physics = EffectPhysics([run], vessel, 1.0)
        z = np.zeros((len(physics.windows.t_s), L))
        z[:, 3:6], z[:, :2] = (0.5, -0.2, 0.3), (zone.public["north_m"] + 5.0, zone.public["east_m"])
        state = physics.one_pass((), {}, z, None)
        theta = {c.effect.id: np.array([v - c.effect.origin.get(k, 0.0) for k, v in c.engine.items()]) for c in causes}
        none = np.zeros((len(z), 3))
        rest = physics.remainder([c.effect for c in causes], theta, replace_state(state, nu_dot=0 * state.nu_dot), none)
        found.append((state.x, rest.nodes))
    np.testing.assert_allclose(found[0][1][:, 0], found[1][1][:, 0], rtol=1e-12)


def test_a_refitted_base_holds_numbers_and_nothing_else():
    nuisances = [cause("base:M11_kg", 0.04), cause("base:X_u_N_s_m", -0.03), cause("thruster_gain:rear_port", 0.02),
                 cause("current", 0.01, 0.0), cause("heading_offset", 0.4), cause("uwb_latency", 0.02)]  # fmt: skip
    new = refitted(VESSEL, nuisances, "refitted")
    i, before = new.inertia, VESSEL.inertia
    assert i.mass_kg - i.X_udot_kg == pytest.approx(1.04 * (before.mass_kg - before.X_udot_kg), rel=1e-5)
    assert new.damping.X_u_N_s_m == pytest.approx(0.97 * VESSEL.damping.X_u_N_s_m)
    assert new.thrusters[2].gain == pytest.approx(1.02 * VESSEL.thrusters[2].gain)
    assert new.sensors.uwb.latency_s == pytest.approx(VESSEL.sensors.uwb.latency_s + 0.02)
    assert new.terms == VESSEL.terms and new.sensors.imu == VESSEL.sensors.imu
    assert load_vessel(vessel_toml(new), name="x") == new


def test_couplings_that_feed_energy_stay_as_they_were():
    wild = [cause("yaw_sway_coupling", 60.0, 60.0), cause("base:X_u_N_s_m", -0.03)]
    new = refitted(VESSEL, wild, "refitted")
    assert new.damping.Y_r_N_s == VESSEL.damping.Y_r_N_s
    assert new.damping.X_u_N_s_m == pytest.approx(0.97 * VESSEL.damping.X_u_N_s_m)


def test_a_trim_beyond_the_dead_band_stays_inside_it_and_the_file_loads():
    band = VESSEL.force_maps[VESSEL.thrusters[0].force_map].dead_band_us
    new = refitted(VESSEL, [cause(f"base:trim:{VESSEL.thrusters[0].name}", -band - 4.0)], "refitted")
    assert -band < new.thrusters[0].trim_us <= 1 - band
    assert load_vessel(vessel_toml(new), name="x") == new


def test_a_gain_of_added_mass_is_of_the_numbers_beside_it():
    one = cause("added_mass", 0.5)
    folded = refitted(VESSEL, [cause("base:M11_kg", 0.05)], "refitted")
    full = extended(folded, one)
    numbers = base_numbers(folded, full, [one])
    assert numbers.inertia.X_udot_kg * 1.5 == pytest.approx(full.inertia.X_udot_kg)
    assert base_numbers(folded, full, []) == folded
