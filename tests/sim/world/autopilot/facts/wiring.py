"""Facts on driving four thrusters by RC override: the wirings of the outputs."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire

from tests.sim.world.autopilot.autopilot_fixture import Bench, S, command, override, texts
from tests.sim.world.autopilot.facts.facts import ACCEPTED, DRIVING, FAILED, fact

HIGH = [1600, 1400, 1900, 1100]
PLAIN = {f"SERVO{n}_FUNCTION": 58 + n for n in range(1, 5)}
SCALED = {f"SERVO{n}_FUNCTION": 147 + n for n in range(1, 5)}
OMNI = {"FRAME_TYPE": 2, "MOT_SLEWRATE": 0, **{f"SERVO{n}_FUNCTION": 32 + n for n in range(1, 5)}}


def settle(bench, **high):
    bench.run(0.2, every=override(**(high or {"high": HIGH})))
    return list(bench.rover.outputs_us[:4])


def omni(steer=1500, throttle=1500, lateral=1500):
    values = [steer, 1500, throttle, lateral] + [65535] * 4 + [0] * 10
    return wire.MAVLink_rc_channels_override_message(0, 0, *values)


def trim_time_s(bench, output, value):
    last_ns = bench.rover.vehicle.rc.last_input_ns
    bench.until(lambda: bench.out(output) == value)
    return (bench.t_ns - last_ns) / S


@fact(DRIVING, "plain pass-through ignores arming, mode and limits, and keeps the last pulse for ever")
def _():
    bench = Bench({**PLAIN, "SERVO1_MIN": 1450, "SERVO1_MAX": 1550})
    bench.run(1.2)
    assert settle(bench) == HIGH
    bench.send(command(176, 1, 4))
    bench.send(command(400, 0))
    bench.run(300.0)
    bench.run(0.2, every=wire.MAVLink_rc_channels_override_message(0, 0, *[0] * 18))
    assert list(bench.rover.outputs_us[:4]) == HIGH


@fact(DRIVING, "only the safety switch cuts plain pass-through")
def _():
    bench = Bench(PLAIN)
    bench.run(1.2)
    assert settle(bench) == HIGH
    assert bench.ack(command(5300, 0)) == ACCEPTED
    bench.run(0.1)
    assert bench.rover.outputs_us == (0,) * 16


@fact(DRIVING, "scaled RCIN in the mask goes to trim 0.52 s after the last override, without a receiver")
def _():
    bench = Bench({**SCALED, "SERVO_RC_FS_MSK": 0xF00}, dt_s=0.002)
    bench.run(1.2, every=override())
    assert settle(bench) == HIGH
    assert trim_time_s(bench, 1, 1500) == pytest.approx(0.52, abs=0.02)


@fact(DRIVING, "disarm and HOLD do not cut scaled RCIN; with FS_ACTION = 5 the loss disarms")
def _():
    bench = Bench({**SCALED, "SERVO_RC_FS_MSK": 0xF00, "FS_ACTION": 5, "SERVO8_FUNCTION": 94}).ready()
    bench.send(command(176, 1, 4))
    assert settle(bench) == HIGH
    bench.send(command(176, 1, 0))
    bench.send(command(400, 0))
    assert settle(bench) == HIGH
    assert bench.ack(command(400, 1)) == ACCEPTED
    bench.run(2.5)
    assert not bench.rover.vehicle.modes.armed


@fact(DRIVING, "scaled RCIN is 1:1 and clipped with a dead zone of 0, and distorted by the default of 30")
def _():
    bench = Bench({**SCALED, "RC10_DZ": 30})
    for value, exact, distorted in [(1530, 1530, 1500), (1715, 1715, 1700), (2100, 1900, 1900), (900, 1100, 1100)]:
        assert settle(bench, high=value)[:2] == [exact, distorted]


@fact(DRIVING, "the Lua gate passes only while armed, in MANUAL and with RC input, clamped; lost after 0.5 s")
def _():
    bench = Bench(dt_s=0.002).ready()
    assert settle(bench, high=[2200, 900, 1600, 1400]) == [1900, 1100, 1600, 1400]
    bench.send(command(176, 1, 4))
    assert settle(bench) == [1500] * 4
    bench.send(command(176, 1, 0))
    bench.send(command(400, 0))
    assert settle(bench) == [1500] * 4
    assert bench.ack(command(400, 1)) == ACCEPTED
    assert settle(bench) == HIGH
    assert 0.5 <= trim_time_s(bench, 1, 1500) <= 0.54


@fact(DRIVING, "without the script Script1-4 put out nothing")
def _():
    bench = Bench({"SCR_ENABLE": 0}).ready()
    assert settle(bench) == [0] * 4


@fact(DRIVING, "Omni-X: throttle, steering and lateral reach the motors with the factors observed")
def _():
    bench = Bench(OMNI).ready()
    for inputs, signs in [({"throttle": 1700}, (1, 1, 1, 1)), ({"steer": 1700}, (-1, -1, 1, 1)),
                          ({"lateral": 1700}, (-1, 1, -1, 1))]:  # fmt: skip
        bench.run(0.2, every=omni(**inputs))
        assert bench.rover.outputs_us[:4] == tuple(1500 + 200 * sign for sign in signs)


@fact(DRIVING, "Omni-X: disarm, HOLD and loss all cut")
def _():
    bench = Bench(OMNI, dt_s=0.002).ready()
    drive = omni(throttle=1700)
    for cut, restore in [(command(400, 0), command(400, 1)), (command(176, 1, 4), command(176, 1, 0))]:
        bench.run(0.2, every=drive)
        assert bench.rover.outputs_us[:4] == (1700,) * 4
        bench.send(cut)
        bench.run(0.2, every=drive)
        assert bench.rover.outputs_us[:4] == (1500,) * 4
        assert bench.ack(restore) == ACCEPTED
    bench.run(0.2, every=drive)
    assert 0.5 <= trim_time_s(bench, 1, 1500) <= 0.54


@fact(DRIVING, "MOT_SLEWRATE of 100 %/s, the default, takes a second from nothing to full")
def _():
    bench = Bench({**OMNI, "MOT_SLEWRATE": 100}, dt_s=0.005).ready()
    start_ns = bench.t_ns
    while bench.out(1) < 1900:
        bench.run(0.01, every=omni(throttle=1900))
    assert (bench.t_ns - start_ns) / S == pytest.approx(1.0, abs=0.05)


@fact(DRIVING, "Omni-X inputs are whole per cent in 4.6")
def _():
    for firmware, expected in [("4.6", {1500, 1504, 1508}), ("4.7", set(range(1500, 1509)))]:
        bench = Bench(OMNI, firmware=firmware).ready()
        got = set()
        for us in range(1500, 1509):
            bench.run(0.2, every=omni(throttle=us))
            got.add(bench.out(1))
        assert got == expected


@fact(DRIVING, "pass-through functions alone do not satisfy arming")
def _():
    for functions in (PLAIN, SCALED):
        bench = Bench(functions)
        bench.run(1.2, every=override())
        assert bench.ack(command(400, 1)) == FAILED
        assert texts(bench.got["boat"])[-1] == (2, "Arm: no motor, sail or scripting outputs defined")
