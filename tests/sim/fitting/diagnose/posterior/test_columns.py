"""Columns of the diagnosis against finite differences of the motion, for every entry of the catalogue.

Logs are simulated (`teleop_run`, seeds stated); boats differ from the vessel file by one effect.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.fitting.diagnose.catalogue.effect import Scene, parameter_slices
from sim.fitting.diagnose.posterior.converged_rollout import converged_rollout
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.engine.initial_guess import initial_nodes
from sim.fitting.engine.jacobian_rows import AccelerationPartials, sensitivities
from tests.sim.fitting.diagnose.posterior_fixture import VESSEL, bench, short

SMOOTH = ["base:M11_kg", "base:N_v_N_s", "hull_fouling", "payload", "cg_shift", "yaw_inertia", "cross_flow", "current",
          "thruster_gain:front_port", "advance_loss", "wash", "munk_moment", "tether@-0.6", "wind"]  # fmt: skip

BY_WATER = {"munk_moment": 60.0, "cross_flow": 0.3, "advance_loss": 0.3}
DEAD = "thruster_gain:front_port"
BESIDE = BY_WATER | {DEAD: -1.0, "common_loss": 0.4}
BY_THRUST = [("common_loss", DEAD), ("wash", DEAD), ("lag", DEAD), (DEAD, "common_loss"), ("dead_time", "advance_loss")]


@pytest.mark.parametrize(
    ("name", "beside"), [*((name, "") for name in SMOOTH), *(("current", beside) for beside in BY_WATER), *BY_THRUST]
)
def test_columns_are_the_derivatives_of_the_motion(name, beside):
    """Oracle: central differences of the integrated windows themselves. `beside`: what is there with it."""
    fit, by_id = bench()
    effect, physics = by_id[name], fit.physics
    there = {"current": np.array([0.02, -0.03])} | ({beside: np.array([BESIDE[beside]])} if beside else {})
    if name == "wind":
        there[name] = np.array([5.0, -3.0])  # beside this the boat's own way is small: linear in the pressure
    state = physics.move(fit.effects, there, fit.z0, None)
    columns = physics.accelerations(fit.effects, there, state, [effect])
    S = sensitivities(state.A, AccelerationPartials.of(columns.nodes, columns.mid_excess), physics.windows.h_s)
    now = there.get(name, np.zeros(len(effect.parameters)))
    for j, parameter in enumerate(effect.parameters):
        step = np.zeros(len(effect.parameters))
        step[j] = parameter.step
        ahead = physics.move(fit.effects, {**there, name: now + step}, fit.z0, None)
        behind = physics.move(fit.effects, {**there, name: now - step}, fit.z0, None)
        expected = (ahead.x[:, -1] - behind.x[:, -1]) / (2 * parameter.step)
        off = np.abs(S[:, -1, :, 9 + j] - expected).max(axis=0)
        assert (off[3:] <= 0.12 * np.abs(expected).max(axis=0)[3:] + 1e-9).all()


def test_a_shallow_zone_that_is_everywhere_is_a_fouled_hull_also_in_an_open_loop():
    """Oracle: the model integrated with twice its damping. Three passes would be metres off."""
    fit, _ = bench()
    physics = EffectPhysics([short()], VESSEL, 15.0)
    z = initial_nodes(physics.windows, physics.parameters)
    everywhere = {"shallow_zone@4": np.array([1.0, 0.0, 0.0, 1e3])}
    expected = physics.move(fit.effects, {"hull_fouling": np.array([1.0])}, z, None).x
    assert np.abs(converged_rollout(physics, fit.effects, everywhere, z).x - expected).max() < 0.01
    assert np.abs(physics.move(fit.effects, everywhere, z, None).x - expected)[..., :2].max() > 1.0


@pytest.mark.parametrize(
    "theta",
    [
        {"tether@+0.0": [5.0, 3.0, -2.0, 0.0]},
        {"advance_loss": [1.2]},
        {DEAD: [-2.0], "cross_flow": [0.5], "current": [0.1, -0.2], "shallow_zone@4": [1.5, 0.0, 0.0, 0.0]},
        {"advance_loss": [0.02], "current": [0.01, 0.0]},
    ],
)
def test_an_open_loop_goes_on_until_forces_are_those_along_its_own_motion(theta):
    fit, _ = bench()
    physics = EffectPhysics([short()], VESSEL, 15.0)
    theta = {name: np.array(values) for name, values in theta.items()}
    state = converged_rollout(physics, fit.effects, theta, initial_nodes(physics.windows, physics.parameters))
    scene = physics.scene(state)
    more, water = physics.hook_forces(fit.effects, theta, scene, state.forces.f)
    np.testing.assert_allclose(state.tau, state.forces.f @ physics.B.T + more, atol=0.05)
    np.testing.assert_allclose(state.water, water, atol=1e-3)


@pytest.mark.parametrize("trim_us", [0.0, 3.0])
def test_pulses_that_changed_places_are_in_place_when_other_changes_of_thrust_are_taken(trim_us):
    fit, by_id = bench()
    swap, trim = by_id["swapped_pair:front_port+rear_port"], by_id["base:trim:rear_port"]
    theta, step = {swap.id: np.array([1.0]), trim.id: np.array([trim_us])}, np.array([2.0])
    thrusters = fit.physics.thrusters
    found = thrusters.change(fit.effects, theta, trim, step)
    there = {**theta, trim.id: theta[trim.id] + step}
    expected = thrusters.forces(fit.effects, there).minus(thrusters.forces(fit.effects, theta))
    np.testing.assert_allclose(found.f, expected.f, atol=1e-9)
    assert np.abs(found.f - thrusters.change(fit.effects, {trim.id: theta[trim.id]}, trim, step).f).max() > 1e-3


@given(north=st.floats(-0.2, 0.2), east=st.floats(-0.2, 0.2))
def test_a_light_wind_from_behind_is_the_opposite_of_one_from_ahead(north, east):
    """Else a share of one is none of the other, and a strong wind could come out with the wrong sign."""
    fit, by_id = bench()
    scene = fit.physics.scene(fit.physics.move(fit.effects, {}, fit.z0, None))
    force = by_id["wind"].hooks["force"]
    one, other = (force({"north_Pa": s * north, "east_Pa": s * east}, scene) for s in (1.0, -1.0))
    np.testing.assert_allclose(one, -other, atol=1e-12)


@pytest.mark.parametrize("name", ["munk_moment", "cross_flow", "advance_loss", "shallow_zone@0"])
@given(psi=st.floats(-3.1, 3.1), north=st.floats(-0.3, 0.3), east=st.floats(-0.3, 0.3))
def test_a_boat_that_drifts_with_the_water_feels_none_of_it(name, psi, north, east):
    """What hull and propellers feel goes by the motion through the water."""
    effect, t = bench()[1][name], np.zeros((1, 1))
    c, s = np.cos(psi), np.sin(psi)
    x = np.array([[[0.0, 0.0, psi, c * north + s * east, c * east - s * north, 0.0]]])
    scene = Scene(t, t, x, np.zeros((1, 1, 3)), np.zeros(1), np.zeros(2), 0.0, np.array([[[north, east]]]))
    p = {q.name: 0.3 for q in effect.parameters}
    if "force" in effect.hooks:
        assert np.abs(effect.hooks["force"](p, scene)).max() < 1e-12
    else:
        f = np.full((1, 1, 4), 7.0)
        np.testing.assert_allclose(effect.hooks["thrust"](p, scene, f), f, atol=1e-12)


def test_a_tether_counts_by_its_pull_as_well_as_by_its_stiffness():
    tether = next(e for e in bench()[1].values() if e.name == "tether")
    assert tether.size(np.array([0.01, 1.5, 0.0, 0.0])) >= 2.0
    assert tether.size(np.array([0.15, 0.0, 0.0, 0.3])) == pytest.approx(3.0)


@pytest.mark.long
def test_every_entry_changes_something():
    """An entry whose hook does nothing on a log that excites everything would never be found."""
    fit, _ = bench()
    state = fit.physics.move(fit.effects, {}, fit.z0, None)
    columns = fit.lineariser.columns(fit.effects, {}, state, fit.effects)
    silent = set()
    for effect, at in zip(fit.effects, parameter_slices(fit.effects).values(), strict=True):
        first = at.start
        moved = max(np.abs(part[..., first]).max() for part in (columns.a.nodes, columns.imu, columns.tag))
        if moved == 0:
            silent.add(effect.name)
    assert silent <= {"rate_limit"}  # a log of gentle commands does not meet the limit
