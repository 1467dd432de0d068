"""Whole trajectories against the plant step by step, scipy and closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from companion.core.model.integrate import BufferedStep
from companion.core.model.integrate import step_function as model_step
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import force_from_pwm
from companion.jit import machine
from sim.trajectory import Surroundings, parameters_of, simulate, simulate_forces
from sim.world.environment import Environment, Moment, Weather
from sim.world.plant import Plant, perturbed
from tests.sim.trajectory.trajectory_fixture import DT, START, VESSEL, extended, pulses
from tests.sim.world.test_plant import by_hand
from tests.support.vessel_fixtures import boat

llvm = pytest.importorskip("llvmlite.binding", reason="llvmlite is not installed")
if not machine.may_run_what_was_written():
    pytest.skip("the system forbids machine code", allow_module_level=True)


def by_plant(vessel, pwm, moments, voltage_v=15.6):
    plant = Plant(vessel, START, step_ns=10_000_000, voltage_v=voltage_v)
    x = [plant.motion.x]
    for k, (row, moment) in enumerate(zip(pwm, moments, strict=True)):
        plant.command(k * 10_000_000, tuple(map(float, row)))
        x.append(plant.step(moment).x)
    return np.array(x)


@pytest.mark.parametrize("name", ["aritra", "twin", "cse1", "extended", "rudder", "azimuth"])
@pytest.mark.parametrize("rough", [False, True])
@pytest.mark.long
def test_it_is_the_plant_all_steps_at_once(name, rough):
    """20 s, seeds 1 and 3: dead time, dead band, battery sag, lag, slew, terms; current, gusts and waves."""
    vessel = extended() if name == "extended" else boat(name)
    pwm = pulses(2000, len(vessel.controls))
    weather = Weather(0.2, 200.0, 1.0, 6.0, 75.0, 0.3, 0.1) if rough else Weather()
    sky = Environment(weather, np.random.default_rng(3))
    moments = [sky.step(k * DT, DT) for k in range(2000)]
    around = Surroundings(
        *(np.array([getattr(m, key) for m in moments]) for key in ("V_c_m_s", "beta_c_deg", "V_w_m_s", "beta_w_deg")),
        np.array([m.wave_n for m in moments]),
    ) if rough else Surroundings(0.0, 0.0, 0.0, 0.0)  # fmt: skip
    got = simulate(vessel, START, pwm, DT, voltage_v=15.6, around=around)
    want = by_plant(vessel, pwm, moments)
    if not rough and name != "extended":
        assert got.x == pytest.approx(want, rel=1e-9, abs=1e-10)
    else:
        assert got.x == pytest.approx(want, rel=1e-7, abs=1e-8)
    assert np.abs(got.f).max() > 0.5 and np.ptp(got.eta[:, 0]) > 0.1


@pytest.mark.parametrize(
    ("name", "pwm_us", "around"),
    [
        ("aritra", (1600.0, 1570.0, 1450.0, 1640.0), Surroundings(V_w_m_s=0.0)),
        ("aritra", (1400.0, 1600.0, 1600.0, 1400.0), Surroundings(0.3, 200.0, 6.0, 75.0, (2.0, -3.0, 0.5))),
        ("twin", (1620.0, 1560.0), Surroundings(0.2, -40.0, 4.0, 10.0)),
    ],
)
def test_it_is_what_scipy_makes_of_equations_written_by_hand(name, pwm_us, around):
    """10 s; pulse widths changed half-way, dead time over at the start, measured voltage."""
    vessel = boat(name)
    a = around
    force = np.zeros(3) if a.force_n is None else np.array(a.force_n)
    moment = Moment(a.V_c_m_s or 0.0, a.beta_c_deg, a.V_w_m_s or 0.0, a.beta_w_deg, force, 0.0, 0.0)
    back = tuple(3000.0 - p for p in pwm_us)
    pwm = np.repeat([pwm_us, back], 500, axis=0)
    x = np.concatenate([START, np.zeros(len(pwm_us))])
    late = round(vessel.propulsion.dead_time_s / DT)
    got = simulate(vessel, START, np.vstack([pwm[late:], pwm[-late:]]) if late else pwm, DT,
                   before_us=pwm[:late] if late else None, voltage_v=14.0, loaded=True, around=around)  # fmt: skip
    for begin, pulse in ((0.0, pwm_us), (5.0, back)):
        found = solve_ivp(by_hand(vessel, pulse, moment, 14.0), (begin, begin + 5), x, rtol=1e-10, atol=1e-11)
        x = found.y[:, -1]
        assert got.x[round(begin / DT) + 500] == pytest.approx(x, abs=2e-5)


@given(
    st.lists(st.floats(-2, 2), min_size=6, max_size=6),
    st.lists(st.floats(-40, 40), min_size=4, max_size=4),
    st.integers(0, 5),
)
@settings(max_examples=25, deadline=None)
def test_forces_move_it_as_the_models_own_interpreted_step_does(x0, force, seed):
    vessel = perturbed(VESSEL, np.random.default_rng(seed), 0.3)
    step, x = BufferedStep(model_step(StructuredModel.of(vessel), DT)), np.concatenate([x0, np.zeros(4)])
    numbers = parameters_of(vessel)
    commands = np.outer(np.cos(np.arange(60) / 7), force)
    got = simulate_forces(VESSEL, x0, commands, DT, parameters=numbers)
    for k, f_cmd in enumerate(commands):
        x = step(x, f_cmd, np.zeros(3))
        assert got.x[k + 1] == pytest.approx(x, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("name", ["aritra", "twin", "cse1"])
def test_the_force_map_is_force_from_pwm_at_every_pulse_width(name):
    """After ten lags of constant pulse widths the forces are those of the map; dead band and limits included."""
    vessel = boat(name)
    widths = np.arange(1000.0, 2001.0, 5.0)
    pwm = np.repeat(np.repeat(widths[:, None, None], len(vessel.thrusters), axis=2), 200, axis=1)
    got = simulate(vessel, np.zeros((len(widths), 6)), pwm, 0.02, voltage_v=13.0, loaded=True).f[:, -1]
    want = [[force_from_pwm(t, vessel.force_maps[t.force_map], w, 13.0) for t in vessel.thrusters] for w in widths]
    np.testing.assert_allclose(got, want, rtol=1e-8, atol=1e-8)
    assert (got[np.abs(widths - 1500) <= 20] == 0.0).all() or name == "cse1"
