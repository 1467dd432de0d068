"""Whole trajectories: against the plant step by step, scipy, closed forms; batches, fallbacks, bad input."""

import platform
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from scipy.integrate import solve_ivp

from companion.core.model.integrate import BufferedStep
from companion.core.model.integrate import step_function as model_step
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import force_from_pwm
from companion.jit import NotCompiled, machine
from sim.trajectory import Surroundings, loops, parameters_of, simulate, simulate_forces
from sim.world.environment import Environment, Moment, Weather
from sim.world.plant import Plant, perturbed
from tests.sim.world.test_plant import by_hand
from tests.support.vessel_fixtures import boat

llvm = pytest.importorskip("llvmlite.binding", reason="llvmlite is not installed")
if not machine.may_run_what_was_written():
    pytest.skip("the system forbids machine code", allow_module_level=True)

ROOT = Path(__file__).resolve().parents[3]
VESSEL = boat("aritra")
DT = 0.01
START = np.array([1.0, -2.0, 0.4, 0.5, -0.1, 0.3])


def pulses(count, n=4, seed=1, hold=10):
    """Pulse widths that change every `hold` samples, beyond the ESC's range too."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.integers(1050, 1950, (-(-count // hold), n)), hold, axis=0)[:count]


def by_plant(vessel, pwm, moments, voltage_v=15.6):
    plant = Plant(vessel, START, step_ns=10_000_000, voltage_v=voltage_v)
    x = [plant.motion.x]
    for k, (row, moment) in enumerate(zip(pwm, moments, strict=True)):
        plant.command(k * 10_000_000, tuple(map(float, row)))
        x.append(plant.step(moment).x)
    return np.array(x)


def extended():
    """A boat with everything that a vessel file may have."""
    p = replace(VESSEL.propulsion, slew_N_s=90.0, advance_loss_sqrt_N_s_m=0.4)
    terms = {"speed_damping": {"N_ur_N_s2": -3.0}, "munk_moment": {"k_kg": 2.0},
             "tether": {"north_m": 1.0, "stiffness_N_m": 2.0, "slack_m": 0.5},
             "shallow_zone": {"radius_m": 2.0, "share": 0.5}}  # fmt: skip
    first = replace(VESSEL.thrusters[0], gain=0.7, trim_us=12)
    return replace(VESSEL, propulsion=p, terms=terms, thrusters=(first, *VESSEL.thrusters[1:]))


@pytest.mark.parametrize("name", ["aritra", "twin", "cse1", "extended"])
@pytest.mark.parametrize("rough", [False, True])
def test_it_is_the_plant_all_steps_at_once(name, rough):
    """20 s, seeds 1 and 3: dead time, dead band, battery sag, lag, slew, terms; current, gusts and waves."""
    vessel = extended() if name == "extended" else boat(name)
    pwm = pulses(2000, len(vessel.thrusters))
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


def mixed(m, count=120):
    """Arguments of m different trajectories."""
    rng = np.random.default_rng(m)
    pwm = np.stack([pulses(count, seed=i) for i in range(m)])
    around = Surroundings(rng.uniform(0, 0.3, (m, 1)), 30.0, rng.uniform(0, 8, (m, count)), 200.0)
    numbers = {"inertia.mass_kg": rng.uniform(35, 60, m), "thrusters.rear_port.gain": rng.uniform(0.2, 1.2, m)}
    volts = rng.uniform(13, 16, (m, 1))
    return START + rng.normal(size=(m, 6)), pwm, around, numbers, volts


@pytest.mark.parametrize("m", [2, 3, 8, 9, 17])
def test_many_at_once_are_each_alone_bit_for_bit(m):
    x0, pwm, around, numbers, volts = mixed(m)
    together = simulate(VESSEL, x0, pwm, DT, voltage_v=volts, around=around, parameters=numbers)
    assert together.x.shape == (m, 121, 10) and not together.why_interpreted
    for i in range(m):
        one = Surroundings(around.V_c_m_s[i], 30.0, around.V_w_m_s[i], 200.0)
        own = {name: values[i] for name, values in numbers.items()}
        alone = simulate(VESSEL, x0[i], pwm[i], DT, voltage_v=volts[i], around=one, parameters=own)
        np.testing.assert_array_equal(alone.x, together.x[i])


@pytest.mark.skipif(platform.machine() != "x86_64", reason="names of x86 processors")
@pytest.mark.parametrize("processor", ["x86-64-v3", "x86-64"])
def test_older_processors_give_the_same_bits(processor, monkeypatch):
    """Narrower vectors; the oldest has no fused operation and calls the C library for it."""
    here = simulate(VESSEL, START, pulses(300), DT, around=Surroundings(0.2, 30.0, 5.0, 80.0)).x

    monkeypatch.setattr("llvmlite.binding.get_host_cpu_name", lambda: processor)
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: SimpleNamespace(flatten=lambda: ""))
    monkeypatch.setattr(loops.Here, "get", lambda *_: None)
    monkeypatch.setattr(loops.Here, "put", lambda *_: None)
    loops.loop.cache_clear()
    there = simulate(VESSEL, START, pulses(300), DT, around=Surroundings(0.2, 30.0, 5.0, 80.0)).x
    loops.loop.cache_clear()
    np.testing.assert_array_equal(here, there)


def test_a_number_as_parameter_is_that_number_in_the_file():
    heavy = replace(VESSEL, inertia=replace(VESSEL.inertia, mass_kg=60.0))
    told = simulate(VESSEL, START, pulses(300), DT, parameters={"inertia.mass_kg": 60.0})
    assert told.x == pytest.approx(simulate(heavy, START, pulses(300), DT).x, rel=1e-11, abs=1e-12)
    every = dict(parameters_of(extended()).items())
    moved = simulate(extended(), START, pulses(300), DT, parameters=every)
    assert moved.x == pytest.approx(simulate(extended(), START, pulses(300), DT).x, rel=1e-10, abs=1e-11)


def test_a_second_call_goes_on_where_the_first_ended_bit_for_bit():
    pwm = pulses(400)
    whole = simulate(VESSEL, START, pwm, DT)
    first = simulate(VESSEL, START, pwm[:150], DT)
    second = simulate(VESSEL, first.x[-1], pwm[150:], DT, before_us=pwm[:150])
    np.testing.assert_array_equal(np.vstack([first.x, second.x[1:]]), whole.x)


def test_substeps_are_smaller_steps():
    pwm = np.repeat(pulses(40, hold=1), 4, axis=0)
    fine = simulate(VESSEL, START, pwm, DT, voltage_v=15.0, loaded=True)
    coarse = simulate(VESSEL, START, pwm[::4], 4 * DT, voltage_v=15.0, loaded=True, substeps=4)
    late = round(VESSEL.propulsion.dead_time_s / DT)
    assert late % 4 != 0, "the dead time is rounded up to samples"
    held = simulate(VESSEL, START, np.vstack([np.full((2, 4), 1500), pwm[:-2]]), DT, voltage_v=15.0, loaded=True)
    assert coarse.x == pytest.approx(held.x[::4], rel=1e-10, abs=1e-11)
    assert fine.t_s[-1] == pytest.approx(coarse.t_s[-1]) == pytest.approx(1.6)


@pytest.mark.parametrize("m", [1, 5])
def test_the_interpreter_gives_the_same_to_round_off(m):
    x0, pwm, around, numbers, volts = mixed(m)
    ways = [
        simulate(VESSEL, x0, pwm, DT, voltage_v=volts, around=around, parameters=numbers, machine_code=code)
        for code in (True, False)
    ]
    assert [bool(way.why_interpreted) for way in ways] == [False, True]
    assert ways[0].x == pytest.approx(ways[1].x, rel=1e-10, abs=1e-11)


def test_where_there_is_no_machine_code_the_same_call_works(monkeypatch):
    def none(*_, **__):
        raise NotCompiled("llvmlite is not installed")

    want = simulate(VESSEL, START, pulses(100), DT)
    monkeypatch.setattr(loops, "compile_scan", none)
    loops.loop.cache_clear()
    got = simulate(VESSEL, START, pulses(100), DT)
    loops.loop.cache_clear()
    assert got.why_interpreted == "llvmlite is not installed"
    assert got.x == pytest.approx(want.x, rel=1e-11, abs=1e-12)


def test_kept_code_that_is_damaged_is_made_anew(tmp_path, monkeypatch):
    monkeypatch.setenv("ARITRA_CACHE", str(tmp_path))
    made = []
    real = llvm.create_pass_builder
    monkeypatch.setattr(llvm, "create_pass_builder", lambda *given: made.append(1) or real(*given))
    answers = []
    for damage in (False, False, True):
        loops.loop.cache_clear()
        if damage:
            (kept,) = tmp_path.glob("*.o")
            kept.write_bytes(kept.read_bytes()[:-100] + b"\0" * 100)
        answers.append(simulate(VESSEL, START, pulses(50), DT).x)
    loops.loop.cache_clear()
    assert len(made) == 2, "made, kept, made anew"
    np.testing.assert_array_equal(answers[0], answers[1])
    np.testing.assert_array_equal(answers[0], answers[2])


def test_a_cache_that_cannot_be_written_is_no_obstacle(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ARITRA_CACHE", str(tmp_path / "file"))
    loops.loop.cache_clear()
    assert not simulate(VESSEL, START, pulses(20), DT).why_interpreted
    loops.loop.cache_clear()


@pytest.mark.parametrize("machine_code", [True, False])
def test_what_runs_away_is_nan_from_there_on_and_touches_nobody(machine_code):
    """A boat that feeds itself energy beside a sound one."""
    numbers = {"damping.X_uu_N_s2_m2": np.array([20000.0, VESSEL.damping.X_uu_N_s2_m2])}
    got = simulate(VESSEL, START, pulses(400), DT, parameters=numbers, machine_code=machine_code)
    sound = np.isfinite(got.x).all(axis=2)
    assert sound[1].all() and not sound[0, -1]
    gone = int(np.flatnonzero(~sound[0])[0])
    assert not sound[0, gone:].any() and np.isnan(got.x[0, gone:]).all()
    alone = simulate(VESSEL, START, pulses(400), DT, machine_code=machine_code)
    assert got.x[1] == pytest.approx(alone.x, rel=1e-11, abs=1e-12)


def test_the_example_of_the_documents_runs(capsys):
    (block,) = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / "simulate.md").read_text(), flags=re.M | re.S)
    exec(block, {})
    assert len(capsys.readouterr().out.split("[")) == 5, "four arrays are printed"


PWM = pulses(30)
BAD = {
    "start": ({"x0": np.zeros(5)}, r"x0: expected \(6,\) or \(10,\), or \(m, 6\) or \(m, 10\); found \(5,\)"),
    "no start": ({"x0": np.zeros((0, 6))}, "x0: expected"),
    "start unknown": ({"x0": [0, 0, np.nan, 0, 0, 0]}, r"x0: not a finite number at \[2\]"),
    "start absurd": ({"x0": [0, 0, 0, 2000.0, 0, 0]}, "x0: no boat"),
    "thrusters": ({"pwm_us": PWM[:, :3]}, r"pwm_us: expected \(k, 4\) or \(m, k, 4\).*found \(30, 3\)"),
    "no samples": ({"pwm_us": PWM[:0]}, "pwm_us: expected"),
    "text": ({"pwm_us": [["a"] * 4]}, "pwm_us: expected numbers"),
    "hole": ({"pwm_us": np.where(np.arange(30)[:, None] == 29, np.nan, PWM)}, r"pwm_us: not a finite .* \[29, 0\]"),
    "infinite": ({"pwm_us": np.where(np.arange(30)[:, None] == 3, np.inf, PWM)}, r"not a finite number at \[3, 0\]"),
    "step": ({"dt_s": 0.0}, "dt_s: expected seconds above 0, found 0.0"),
    "step back": ({"dt_s": -0.01}, "dt_s: expected"),
    "step unknown": ({"dt_s": np.nan}, "dt_s: expected"),
    "step long": ({"dt_s": 1.0}, r"dt_s / substeps: expected at most 2.5 x lag_s = 0.25 s"),
    "substeps": ({"substeps": 0}, "substeps: expected a whole number above 0"),
    "counts": ({"x0": np.zeros((3, 6)), "pwm_us": np.stack([PWM] * 2)}, "do not agree: {'x0': 3, 'drive': 2}"),
    "volts": ({"voltage_v": np.zeros(30)}, "voltage_v: expected more than 0 V"),
    "volts long": ({"voltage_v": np.full(29, 15.0)}, r"voltage_v: expected a number, \(30,\)"),
    "before": ({"before_us": PWM[:9]}, "before_us: the dead time needs 10 samples, found 9"),
    "before many": ({"pwm_us": np.stack([PWM] * 2), "before_us": np.stack([PWM] * 3)}, "before_us: expected as many"),
    "parameter": ({"parameters": {"mass": 3.0}}, "no number 'mass' of this vessel; there are inertia.mass_kg"),
    "parameter unknown": ({"parameters": {"inertia.mass_kg": np.nan}}, "inertia.mass_kg.*not a finite number"),
    "lag": ({"parameters": {"propulsion.lag_s": [0.1, 0.0]}}, "dt_s / substeps"),
    "waves": ({"around": Surroundings(force_n=np.zeros((29, 3)))}, r"force_n: expected \(3,\), \(30, 3\)"),
    "wind": ({"around": Surroundings(V_w_m_s=np.zeros((2, 7)))}, "V_w_m_s: expected a number"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_told(name):
    changes, why = BAD[name]
    arguments = {"x0": np.zeros(6), "pwm_us": PWM, "dt_s": DT, **changes}
    with pytest.raises(ValueError, match=why):
        simulate(VESSEL, **arguments)


def test_bad_forces_are_told():
    with pytest.raises(ValueError, match=r"f_cmd_n: expected \(k, 4\)"):
        simulate_forces(VESSEL, START, np.zeros((5, 3)), DT)


def test_one_start_many_commands_and_many_starts_one_command():
    pwm = np.stack([pulses(40, seed=s) for s in range(3)])
    assert simulate(VESSEL, START, pwm, DT).x.shape == (3, 41, 10)
    starts = np.tile(START, (3, 1))
    many = simulate(VESSEL, starts, pwm[0], DT)
    np.testing.assert_array_equal(many.x[2], simulate(VESSEL, START, pwm[0], DT).x)
    assert simulate(VESSEL, starts[:1], pwm[0], DT).x.shape == (1, 41, 10)
    assert many.eta.shape == (3, 41, 3) and many.nu.shape == (3, 41, 3) and many.f.shape == (3, 41, 4)
