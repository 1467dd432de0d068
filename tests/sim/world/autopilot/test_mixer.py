"""The Omni-X mixer against the matrix of its factors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.sim.world.autopilot.autopilot_fixture import Bench, S, command
from tests.sim.world.autopilot.facts.wiring import OMNI, omni

FACTORS = np.array([[1, -1, -1], [1, -1, 1], [1, 1, -1], [1, 1, 1]])  # of throttle, steering, lateral
STICK = st.integers(1100, 1900)


def outputs(bench, **inputs):
    bench.run(0.2, every=omni(**inputs))
    return np.array(bench.rover.outputs_us[:4])


@settings(max_examples=60, deadline=None, derandomize=True)
@given(STICK, STICK, STICK)
def test_outputs_are_the_mixed_inputs_scaled_back_alike(steer, throttle, lateral):
    inputs = (np.array([throttle, steer, lateral]) - 1500) / 400
    inputs[:2] /= max(1.0, abs(inputs[:2]).sum())
    mixed = FACTORS @ inputs
    expected = 1500 + 400 * mixed / max(1.0, abs(mixed).max())
    bench = Bench({**OMNI, **{f"RC{n}_DZ": 0 for n in (1, 3, 4)}}, firmware="4.7").ready()
    got = outputs(bench, steer=steer, throttle=throttle, lateral=lateral)
    assert got == pytest.approx(expected, abs=0.51)
    assert got.min() >= 1100 and got.max() <= 1900


def test_the_slew_limit_holds_both_ways_and_begins_anew_after_disarming():
    bench = Bench({**OMNI, "MOT_SLEWRATE": 100}, dt_s=0.005).ready()
    bench.run(2.0, every=omni(throttle=1900))
    start_ns = bench.t_ns
    while bench.out(1) > 1500:
        bench.run(0.01, every=omni())
    assert (bench.t_ns - start_ns) / S == pytest.approx(1.0, abs=0.05)
    bench.run(2.0, every=omni(throttle=1900))
    bench.send(command(400, 0))
    bench.run(0.1, every=omni(throttle=1900))
    assert bench.out(1) == 1500
    bench.send(command(400, 1, 2989))
    bench.run(0.1, every=omni(throttle=1900))
    assert 1500 < bench.out(1) < 1560


def test_reversed_channels_and_outputs():
    bench = Bench({**OMNI, "RC3_REVERSED": 1, "SERVO2_REVERSED": 1}).ready()
    assert list(outputs(bench, throttle=1700)) == [1300, 1700, 1300, 1300]


def test_another_frame_type_has_no_such_mixer():
    bench = Bench({**OMNI, "FRAME_TYPE": 0, "ARMING_CHECK": 0}).ready()
    assert list(outputs(bench, throttle=1700)) == [0] * 4


@pytest.mark.parametrize("mode", [4, 15])
def test_only_manual_takes_the_sticks(mode):
    bench = Bench(OMNI).ready()
    bench.send(command(400, 0))
    bench.send(command(176, 1, mode))
    bench.send(command(400, 1, 2989))
    assert bench.rover.vehicle.modes.armed
    assert list(outputs(bench, throttle=1900)) == [1500] * 4
