"""Trajectories without machine code or cache, and input that is refused."""

import re
from pathlib import Path

import numpy as np
import pytest

from companion.jit import NotCompiled, machine
from sim.trajectory import Surroundings, loops, simulate, simulate_forces
from tests.sim.trajectory.trajectory_fixture import DT, START, VESSEL, mixed, pulses

llvm = pytest.importorskip("llvmlite.binding", reason="llvmlite is not installed")
if not machine.may_run_what_was_written():
    pytest.skip("the system forbids machine code", allow_module_level=True)
ROOT = Path(__file__).resolve().parents[3]


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
