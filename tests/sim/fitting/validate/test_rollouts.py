"""Open-loop rollouts of the models against independent simulations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from companion.core.model.integrate import BufferedStep, step_function
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import configuration_matrix
from sim.fitting.engine.thrust.forces import thruster_forces
from sim.fitting.taylor.abkowitz import C, regressor
from sim.fitting.validate.models import ConstantVelocity, TaylorSimulator, VesselSimulator, ZeroVelocity
from sim.fitting.validate.protocol import STEP_S, Commands
from sim.fitting.validate.scores import SpeedBox, score
from sim.fitting.validate.stability import stability
from sim.fitting.validate.windows import cut_held_out, reference_motion
from tests.sim.fitting.validate.example_vessel import NOISE, VESSEL

BOX = SpeedBox(np.array([-1.0, -0.6, -1.1]), np.array([1.0, 0.6, 1.1]))


@pytest.fixture(scope="module")
def windows(run):
    return cut_held_out(run, reference_motion(run, NOISE), 15.0, horizon_s=20.0, stride_s=10.0)


def commands(pwm, steps, m=1, volts=15.0):
    row = np.broadcast_to(np.asarray(pwm, dtype=float), (m, steps, 4))
    return Commands(row, np.full((m, steps), volts), row[:, :40])


def test_the_true_vessel_file_reproduces_the_plant(run, windows):
    """The plant is another program: 100 Hz, delay line, battery sag; the rest is rounding of volts and stamps."""
    found, _ = score(VesselSimulator("true", VESSEL), windows, BOX)
    assert windows.horizon_s == 20.0
    assert found.rms["position"][found.horizons_s.index(20)] < 0.06
    assert max(found.rms[c].max() for c in "uvr") < 0.01
    assert min(found.r2.values()) > 0.999
    assert not found.diverged.any()


@pytest.mark.parametrize("m", [2, 40])
def test_few_windows_and_many_are_the_models_own_steps(m):
    """Seed 1, 40 s: few by the interpreter, many by machine code; one is gone where its voltage makes no sense."""
    rng = np.random.default_rng(1)
    x0, pwm = rng.uniform(-0.5, 0.5, (m, 6)), np.repeat(rng.uniform(1200, 1800, (m, 40, 4)), 20, axis=1)
    volts, before = np.full((m, 800), 15.0), np.tile(pwm[:, :1], (1, 40, 1))
    volts[1, 300:] = -1.0
    got = VesselSimulator("true", VESSEL).simulate(x0, Commands(pwm, volts, before))
    step = BufferedStep(step_function(StructuredModel.of(VESSEL), STEP_S, 1))
    x = np.concatenate([x0[0], thruster_forces(VESSEL, before[0, :1], volts[0, :1])[0]])
    late = np.concatenate([before[0, -2:], pwm[0, :-2]])
    for k, f_cmd in enumerate(thruster_forces(VESSEL, late, volts[0])):
        x = step(x, f_cmd, np.zeros(3))
        assert got[0, k + 1] == pytest.approx(x[:6], rel=1e-9, abs=1e-10)
    assert np.isfinite(got[1, :300]).all() and np.isnan(got[1, 304:]).all()
    assert np.isfinite(np.delete(got, 1, axis=0)).all()


def test_a_wrong_dead_time_shows(windows):
    late = replace_propulsion(dead_time_s=0.4)
    right, _ = score(VesselSimulator("right", VESSEL), windows, BOX)
    wrong, _ = score(VesselSimulator("late", late), windows, BOX)
    assert wrong.rms["u"][0] > 10 * right.rms["u"][0]


def replace_propulsion(**values):
    from msgspec.structs import replace as with_fields

    return with_fields(VESSEL, propulsion=with_fields(VESSEL.propulsion, **values))


def test_the_taylor_model_against_scipy():
    pwm = np.array([1560, 1540, 1570, 1550])
    steps, x0 = 200, np.array([1.0, 2.0, 0.3, 0.55, 0.02, -0.05])
    got = TaylorSimulator("t", C, VESSEL).simulate(x0[None], commands(pwm, steps))[0]
    t = configuration_matrix(VESSEL) @ thruster_forces(VESSEL, pwm[None], np.array([15.0]))[0] / 9.80665

    def rate(_, x):
        c, s = np.cos(x[2]), np.sin(x[2])
        pose = [c * x[3] - s * x[4], s * x[3] + c * x[4], x[5]]
        return [*pose, *(C @ np.array(regressor(x[3:], t)))]

    want = solve_ivp(rate, (0, steps * STEP_S), x0, rtol=1e-10, atol=1e-12).y[:, -1]
    assert np.allclose(got[-1], want, atol=1e-6)


def test_what_needs_no_model():
    """A quarter circle of radius u / r in closed form; the other stays where it is."""
    x0 = np.array([[0.0, 0.0, 0.0, 0.5, 0.0, np.pi / 20]])
    stays = ConstantVelocity().simulate(x0, commands([1900] * 4, 200))[0]
    assert np.allclose(stays[-1, :3], [0.5 / (np.pi / 20), 0.5 / (np.pi / 20), np.pi / 2])
    zero = ZeroVelocity().simulate(x0, commands([1900] * 4, 200))[0]
    assert np.array_equal(zero[0], x0[0])
    assert np.array_equal(zero[1:], np.zeros((200, 6)))
    straight = ConstantVelocity().simulate(np.array([[0, 0, np.pi / 2, 0.3, 0.1, 0.0]]), commands([1500] * 4, 20))[0]
    assert np.allclose(straight[-1, :2], [-0.1, 0.3])


def test_a_boat_comes_to_rest_and_the_printed_model_does_not():
    box = SpeedBox(np.array([0.43, -0.22, -0.57]), np.array([0.85, 0.22, 0.57]))
    good = stability(VesselSimulator("file", VESSEL), VESSEL, BOX, 1, runs=25)
    assert (good.driven_diverged, good.free_diverged, good.free_at_rest) == (0.0, 0.0, 1.0)
    bad = stability(TaylorSimulator("printed", C, VESSEL), VESSEL, box, 1, runs=25)
    assert bad.free_at_rest == 0.0
    assert bad.driven_diverged > 0.9
