"""Base files that hold effects already, as the extended file of an earlier diagnosis does: the engine plays them.

Logs are simulated by the plant with that very file (`teleop_run`, seeds stated) and hold the true motion.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile, Wash
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.posterior.converged_rollout import converged_rollout
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.posterior.state import WindowTrajectories
from sim.fitting.diagnose.vessel_edits.extend import extended
from sim.fitting.diagnose.vessel_edits.public_form import smallest_size
from sim.fitting.diagnose.vessel_edits.refitted_vessel import cause_of
from sim.fitting.engine.initial_guess import initial_nodes
from sim.fitting.engine.jacobian_rows import AccelerationPartials, sensitivities
from sim.fitting.engine.noise import STATE, L
from sim.studies.boats.draw import in_still_air
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

PLAIN = in_still_air(boat("aritra"))
TRUE = [f"true_{name}" for name in ("north_m", "east_m", "psi_rad", "u_m_s", "v_m_s", "r_rad_s")]


def with_propulsion(**keys: object) -> VesselFile:
    return replace(PLAIN, propulsion=replace(PLAIN.propulsion, **keys))


WASHED = tuple(Wash(behind=f"rear_{side}", ahead=f"front_{side}", share=0.4) for side in ("port", "starboard"))
WEAKENED = with_propulsion(advance_loss_sqrt_N_s_m=1.2, wash=WASHED)
SLOW = replace(
    with_propulsion(slew_N_s=25.0),
    thrusters=tuple(replace(t, gain=g) for t, g in zip(PLAIN.thrusters, (0.5, 1, 1, 0.7), strict=True)),
)
FLOWING = {"V_c_m_s": 0.15, "beta_c_deg": 40.0}


RUN = teleop_run(WEAKENED, 3, 30.0)


def engine(vessel: VesselFile) -> PosteriorFit:
    """Believing in `vessel`, on the log."""
    return PosteriorFit(EffectPhysics([RUN], vessel, 1.0), catalogue(vessel, [RUN]), stated_noise(vessel))


def truth(run, t_s: np.ndarray) -> np.ndarray:
    """True states (.., 6) at `t_s`."""
    t, x = run.samples(*TRUE)
    x[:, 2] = np.unwrap(x[:, 2])
    return np.stack([np.interp(t_s, t, column) for column in x.T], axis=-1)


def missed(run, vessel: VesselFile) -> np.ndarray:
    """By how much the engine that believes in `vessel` misses u, v, r after a second from true states, rms (3,)."""
    physics = EffectPhysics([run], vessel, 1.0)
    z = np.zeros((physics.windows.size[0], L))
    z[:, STATE] = truth(run, physics.windows.t_s[:, 0])
    reached = physics.move((), {}, z, None).x[:, -1]
    return np.sqrt(((reached - truth(run, physics.windows.t_s[:, -1]))[:, 3:] ** 2).mean(axis=0))


def test_thrust_that_moving_water_takes_off_is_taken_off_as_the_plant_does():
    assert (missed(RUN, WEAKENED) < 0.1 * missed(RUN, PLAIN)).all()


def along_itself(fit: PosteriorFit, theta: ParameterValues) -> WindowTrajectories:
    """The motion once what goes by it is along itself."""
    state = None
    for _ in range(4):
        state = fit.physics.move(fit.effects, theta, fit.z0, state)
    assert state is not None
    return state


@cache
def weakened_in_a_current() -> PosteriorFit:
    return engine(replace(WEAKENED, terms=PLAIN.terms | {"current": FLOWING}))


@pytest.mark.parametrize("name", ["thruster_gain:front_port", "base:trim:rear_port", "advance_loss", "wash", "current"])
def test_columns_know_what_the_file_takes_off(name):
    """Oracle: central differences of the integrated windows themselves."""
    fit = weakened_in_a_current()
    effect = next(e for e in fit.effects if e.id == name)
    state = fit.physics.move(fit.effects, {}, fit.z0, None)
    columns = fit.physics.accelerations(fit.effects, {}, state, [effect])
    S = sensitivities(state.A, AccelerationPartials.of(columns.nodes, columns.mid_excess), fit.physics.windows.h_s)
    for j, parameter in enumerate(effect.parameters):
        step = parameter.step * np.eye(len(effect.parameters))[j]
        ahead, behind = (fit.physics.move(fit.effects, {name: s * step}, fit.z0, None) for s in (1, -1))
        expected = (ahead.x[:, -1] - behind.x[:, -1]) / (2 * parameter.step)
        off = np.abs(S[:, -1, :, 9 + j] - expected).max(axis=0)
        assert (off[3:] <= 0.06 * np.abs(expected).max(axis=0)[3:] + 1e-9).all()


@pytest.mark.parametrize("theta", [{"thruster_gain:front_port": [-0.6]}, {"tether@+0.0": [5.0, 3.0, -2.0, 0.0]}])
def test_an_open_loop_settles_where_the_file_weakens_thrust(theta):
    """Forces are those along the motion itself."""
    fit, theta = weakened_in_a_current(), {name: np.array(values) for name, values in theta.items()}
    physics = EffectPhysics([RUN], fit.physics.vessel, 12.0)
    state = converged_rollout(physics, fit.effects, theta, initial_nodes(physics.windows, physics.parameters))
    more, _ = physics.hook_forces(fit.effects, theta, physics.scene(state), state.forces.f)
    np.testing.assert_allclose(state.tau, physics.drive(state.forces.f) + more, atol=0.05)


@pytest.mark.parametrize("name", ["base:trim:front_port", "lag", "common_loss"])
def test_beside_a_thruster_that_is_all_but_dead_a_rate_limited_file_moves_only_the_others(name):
    """Oracle: all the same without a limit, where the gain acts on the forces. Here it lies far above what is asked."""
    beside = {"thruster_gain:front_port": np.array([-0.9])}
    found = []
    for vessel in (with_propulsion(slew_N_s=1e4), PLAIN):
        fit = engine(vessel)
        effect = next(e for e in fit.effects if e.id == name)
        step = np.array([0.25 * p.smallest for p in effect.parameters])
        state = fit.physics.move(fit.effects, beside | {name: step}, fit.z0, None)
        columns = fit.physics.accelerations(fit.effects, beside | {name: step}, state, [effect])
        found.append((columns.nodes, state.nu_dot))
    for limited, plain in zip(*found, strict=True):
        assert np.sqrt(((limited - plain) ** 2).mean()) < 0.02 * np.sqrt((plain**2).mean())


@pytest.mark.parametrize("slew_N_s", [None, 25.0])
def test_a_thruster_that_is_dead_in_the_file_is_the_limit_of_one_that_is_all_but_dead(slew_N_s):
    found = []
    for gain in (0.0, 1e-9):
        thrusters = (replace(PLAIN.thrusters[0], gain=gain), *PLAIN.thrusters[1:])
        fit = engine(replace(with_propulsion(slew_N_s=slew_N_s), thrusters=thrusters))
        commanded = [e for e in fit.effects if e.always_free and "maps" in e.hooks]
        there = {"common_loss": np.array([0.3]), "lag": np.array([0.01])}
        state = fit.physics.move(fit.effects, there, fit.z0, None)
        found.append((state.x, fit.physics.accelerations(fit.effects, there, state, commanded).nodes))
    for dead, all_but in zip(*found, strict=True):
        np.testing.assert_allclose(dead, all_but, atol=1e-6)


@pytest.mark.parametrize(("name", "value"), [("munk_moment", 40.0), ("cross_flow", 0.5), ("advance_loss", 0.4)])
def test_what_goes_by_the_motion_through_the_water_knows_the_current_of_the_file(name, value):
    """Oracle: the same current as an effect."""
    angle, there = np.radians(FLOWING["beta_c_deg"]), {name: np.array([value])}
    flow = FLOWING["V_c_m_s"] * np.array([np.cos(angle), np.sin(angle)])
    told, found = engine(replace(PLAIN, terms=PLAIN.terms | {"current": FLOWING})), engine(PLAIN)
    one, other = along_itself(told, there), along_itself(found, {**there, "current": flow})
    np.testing.assert_allclose(one.x, other.x, atol=1e-6)
    assert np.abs(one.x - along_itself(found, there).x).max() > 1e-3


def test_thrusters_that_are_slow_in_the_file_are_as_slow_as_in_the_plant():
    run = teleop_run(SLOW, 3, 30.0)
    fast = replace(SLOW, propulsion=PLAIN.propulsion)
    assert (missed(run, SLOW) < 0.1 * missed(run, fast)).all()


def test_a_limit_that_is_found_is_the_limit_in_full():
    fit, found = engine(SLOW), np.array([0.02])
    limit = next(e for e in fit.effects if e.id == "rate_limit")
    cause = cause_of(fit, limit, found, "test")
    assert cause.public["rate_limit_N_s"] == pytest.approx(1 / (0.02 + 1 / 25))
    assert smallest_size(limit) == (pytest.approx(1 / (1 / 150 + 1 / 25)), "N/s")


ZONE = {"north_m": 15.0, "east_m": 15.0, "radius_m": 4.0, "share": 0.8, "source": "test"}


@pytest.mark.parametrize(
    ("vessel", "name", "value"),
    [
        (replace(PLAIN, terms=PLAIN.terms | {"shallow_zone": ZONE}), "hull_fouling", 0.5),
        (SLOW, "rate_limit", 0.02),
        (SLOW, "thruster_gain:rear_port", -0.6),
        (SLOW, "common_loss", 0.4),
    ],
    ids=["fouling in a zone", "limit beside a limit", "gain beside a limit", "loss beside a limit"],
)
def test_a_cause_beside_what_the_file_has_is_what_the_extended_file_has(vessel, name, value):
    """Oracle: the engine that believes in the extended file."""
    fit, found = engine(vessel), np.array([value])
    effect = next(e for e in fit.effects if e.id == name)
    told = engine(extended(vessel, cause_of(fit, effect, found, "test")))
    there = told.physics.move((), {}, fit.z0, None).x
    np.testing.assert_allclose(fit.physics.move([effect], {name: found}, fit.z0, None).x, there, atol=1e-9)
    assert np.abs(fit.physics.move((), {}, fit.z0, None).x - there).max() > 0.01
