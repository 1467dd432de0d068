"""Many trajectories at once, parameters, going on, substeps: each is what it is alone, bit for bit."""

import platform
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from companion.jit import machine
from sim.trajectory import Surroundings, loops, parameters_of, simulate
from tests.sim.trajectory.trajectory_fixture import DT, START, VESSEL, extended, mixed, pulses

llvm = pytest.importorskip("llvmlite.binding", reason="llvmlite is not installed")
if not machine.may_run_what_was_written():
    pytest.skip("the system forbids machine code", allow_module_level=True)


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


def test_numbers_of_the_file_count_in_wind_that_is_given_too():
    def boat(**wind):
        return replace(VESSEL, terms={"wind": {"V_w_m_s": 3.0, "beta_w_deg": 20.0, **wind}})

    def moved(vessel, **parameters):
        around = Surroundings(V_w_m_s=5.0, beta_w_deg=80.0)
        return simulate(vessel, START, pulses(300), DT, around=around, parameters=parameters).x

    told = moved(boat(), **{"terms.wind.c_y": 2.0})
    assert told == pytest.approx(moved(boat(c_y=2.0)), rel=1e-10, abs=1e-11)
    assert not np.allclose(told, moved(boat()))


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
