"""The Lua gate in a Lua 5.3 interpreter: what it lets through, and what is left when it breaks."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.sim.world.autopilot.autopilot_fixture import Bench, command, override
from tests.sim.world.wirings.gate_harness import Gate

PULSES = {9: 1600, 10: 1400, 11: 1900, 12: 1100}
NEUTRAL = (1500,) * 4
PULSE = st.one_of(st.none(), st.integers(0, 65535))


def test_it_passes_the_companions_pulses():
    gate = Gate(channels_us=PULSES)
    assert gate.run(50) == (1600, 1400, 1900, 1100)
    assert gate.texts == [(6, "gate: thrusters on channels 9 10 11 12")]


@settings(max_examples=200, deadline=None)
@given(st.booleans(), st.booleans(), st.integers(0, 20), st.lists(PULSE, min_size=4, max_size=4))
def test_only_armed_valid_and_in_manual_and_always_clamped(armed, valid, mode, values):
    gate = Gate(armed=armed, valid=valid, mode=mode, channels_us=dict(zip(range(9, 13), values, strict=True)))
    for us, got in zip(values, gate.run(50), strict=True):
        shut = not (armed and valid and mode == 0) or us in (None, 0)
        assert got == (1500 if shut else min(1900, max(1100, us)))


@pytest.mark.parametrize("change", [{"armed": False}, {"valid": False}, {"mode": 4}, {"channels_us": {}}])
def test_it_shuts_within_one_period(change):
    gate = Gate(channels_us=PULSES)
    gate.run(1000)
    for name, value in change.items():
        setattr(gate, name, value)
    assert gate.run(10) == NEUTRAL


@pytest.mark.parametrize("binding", ["is_armed", "get_mode", "has_valid_input", "get_pwm"])
def test_an_error_is_neutral_at_once_is_told_and_is_got_over(binding):
    gate = Gate(channels_us=PULSES)
    gate.run(100)
    gate.stuck.add(binding)
    assert gate.run(10) == NEUTRAL
    severity, text = gate.texts[-1]
    assert severity == 3 and text.startswith("gate: ")
    gate.run(10_000)
    assert len(gate.texts) < 8  # not at every period
    gate.stuck.clear()
    assert gate.run(2100) == (1600, 1400, 1900, 1100)


def test_when_outputs_cannot_be_written_or_the_script_dies_the_pulses_run_out():
    for kill in (lambda gate: gate.stuck.add("set_output_pwm_chan_timeout"), lambda gate: setattr(gate, "next", None)):
        gate = Gate(channels_us=PULSES)
        gate.run(100)
        kill(gate)
        gate.run(100)
        assert gate.outputs_us == (1600, 1400, 1900, 1100)
        assert gate.run(110) == NEUTRAL


def test_an_output_that_is_missing_is_told_again_and_again_and_nothing_moves():
    gate = Gate(channels_us=PULSES, functions=[94, 95, 0, 97])
    gate.run(4100)
    assert gate.texts == [(3, "gate: no output has SERVOn_FUNCTION 96")] * 3
    assert set(gate.outputs_us) <= {0, 1500}
    gate.functions[2] = 96
    assert gate.run(2100) == (1600, 1400, 1900, 1100)


@pytest.mark.parametrize("seed", range(3))
def test_script_and_simulated_gate_do_the_same(seed):
    draw = random.Random(seed)
    bench, gate = Bench(), Gate()
    bench.run(1.2, every=override())
    for _ in range(40):
        what = draw.randrange(5)
        if what == 0:
            bench.send(command(400, draw.randrange(2), 21196))
        elif what == 1:
            bench.send(command(176, 1, draw.choice([0, 0, 4, 15])))
        elif what == 2:
            bench.run(draw.uniform(0.3, 0.8))
        bench.run(0.3, every=override(high=[draw.randrange(900, 2200) for _ in range(4)]))
        vehicle = bench.rover.vehicle
        gate.armed, gate.valid, gate.mode = vehicle.modes.armed, vehicle.failsafe.rc_valid, int(vehicle.modes.mode)
        gate.channels_us = dict(enumerate(vehicle.rc.radio_in_us, start=1))
        assert gate.run(50) == bench.rover.outputs_us[:4]
