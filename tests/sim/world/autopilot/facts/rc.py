"""Facts on driving four thrusters by RC override: channels, receiver, fail-safes, latency."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire

from tests.sim.world.autopilot.autopilot_fixture import MS, Bench, S, command, of_type, override
from tests.sim.world.autopilot.facts.facts import ACCEPTED, DRIVING, fact, one
from tests.sim.world.autopilot.facts.wiring import HIGH, PLAIN, SCALED, settle


@fact(DRIVING, "with a receiver each channel's stick takes over RC_OVERRIDE_TIME after its last override")
def _():
    for parameters, seconds in [({"RC_OVERRIDE_TIME": 3}, 3.0), ({"RC_OVERRIDE_TIME": 0.5}, 0.5)]:
        bench = Bench(parameters, dt_s=0.005)
        bench.receiver(*[1444] * 16)
        bench.send(one(9, 1600))
        bench.run(0.2)
        bench.send(one(10, 1600))
        bench.run(seconds - 0.21)
        assert bench.rover.vehicle.rc.radio_in_us[8:10] == [1600, 1600]
        bench.run(0.02)
        assert bench.rover.vehicle.rc.radio_in_us[8:10] == [1444, 1600]
        bench.run(0.2)
        assert bench.rover.vehicle.rc.radio_in_us[8:10] == [1444, 1444]


@fact(DRIVING, "RC_OVERRIDE_TIME 0 disables overrides, -1 never lets them expire")
def _():
    for value, expected in [(0, 1444), (-1, 1600)]:
        bench = Bench({"RC_OVERRIDE_TIME": value, "FS_GCS_ENABLE": 0})
        bench.receiver(*[1444] * 16)
        bench.send(one(9, 1600))
        bench.run(60.0)
        assert bench.rover.vehicle.rc.radio_in_us[8] == expected


@fact(DRIVING, "with a receiver of 8 channels a thruster channel reads 0 when its override ends (source)")
def _():
    bench = Bench().ready()
    bench.receiver(*[1500] * 8)
    assert settle(bench) == HIGH
    bench.run(0.6)
    assert bench.rover.vehicle.rc.radio_in_us[8:12] == [0] * 4
    assert bench.rover.outputs_us[:4] == (1500,) * 4
    bench = Bench({**SCALED, "SERVO_RC_FS_MSK": 0xF00})
    bench.receiver(*[1500] * 8)
    assert settle(bench) == HIGH
    bench.run(0.6)
    assert bench.rover.outputs_us[:4] == (1100,) * 4  # full reverse


@fact(DRIVING, "channels 1-8: 0 releases, 65535 leaves alone, 65534 is a pulse width; 9-16: 65534 releases")
def _():
    rows = [(1, 0, 1444), (8, 65535, 1600), (1, 65534, 65534), (9, 65534, 1444), (16, 0, 1600), (9, 65535, 1600)]
    for channel, value, expected in rows:
        bench = Bench({"MODE_CH": 0})
        bench.send(one(channel, 1600))
        bench.receiver(*[1444] * 16)
        bench.send(one(channel, value))
        bench.run(0.05)
        assert bench.rover.vehicle.rc.radio_in_us[channel - 1] == expected, (channel, value)


@fact(DRIVING, "65534 on a thruster channel below 9 goes out as a pulse of 65534 us")
def _():
    bench = Bench({"SERVO1_FUNCTION": 51})
    bench.run(0.2, every=one(1, 65534))
    assert bench.out(1) == 65534


@fact(DRIVING, "channels 17 and 18 are ignored; without a receiver a release changes nothing")
def _():
    bench = Bench(PLAIN)
    values = [65535] * 8 + [1600] * 4 + [0] * 4 + [1700, 1700]
    bench.send(wire.MAVLink_rc_channels_override_message(0, 0, *values))
    bench.run(0.2)
    assert 1700 not in bench.rover.vehicle.rc.radio_in_us
    bench.send(one(9, 65534))
    bench.run(0.2)
    assert bench.out(1) == 1600


@fact(DRIVING, "overrides of any system but SYSID_MYGCS are dropped without a word; target 0/0 works")
def _():
    bench = Bench()
    bench.join("gcs", system=255)
    assert bench.send(override(high=1700), "gcs") == []
    assert bench.rover.vehicle.rc.radio_in_us[8] == 0
    bench.send(override(high=1700))
    assert bench.rover.vehicle.rc.radio_in_us[8] == 1700


@fact(DRIVING, "a ground station 255 arms and changes mode, and does not keep companion silence from failing safe")
def _():
    bench = Bench({"FS_THR_ENABLE": 0})
    bench.join("gcs", system=255)
    bench.run(1.2, every=override())
    assert bench.ack(command(176, 1, 0), "gcs") == ACCEPTED
    assert bench.ack(command(400, 1), "gcs") == ACCEPTED
    for _ in range(8):
        bench.send(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), "gcs")
        bench.run(1.0)
    assert bench.rover.vehicle.modes.mode == 4


@fact(DRIVING, "overrides count as heartbeats of the ground station: its fail-safe never fires while they flow")
def _():
    bench = Bench({"FS_THR_ENABLE": 0}).ready()
    bench.run(60.0, every=override())
    assert bench.rover.vehicle.modes.mode == 0
    bench.run(8.0)
    assert bench.rover.vehicle.modes.mode == 4


def rudder(bench, us, seconds):
    """Channel 1 at `us`, channel 3 neutral; whether it is armed afterwards."""
    values = [us, 1500, 1500, 1500] + [65535] * 4 + [0] * 10
    bench.run(seconds, every=wire.MAVLink_rc_channels_override_message(0, 0, *values))
    return bench.rover.vehicle.modes.armed


@fact(DRIVING, "channel 1 near full with channel 3 neutral for 2 s arms and disarms, by override too")
def _():
    bench = Bench({"ARMING_RUDDER": 2})
    bench.run(1.2, every=override())
    assert not rudder(bench, 1900, 1.9)
    assert rudder(bench, 1900, 0.4)
    assert rudder(bench, 1100, 1.9)
    assert not rudder(bench, 1100, 0.4)
    assert not rudder(bench, 1850, 10.0)  # not near full


@fact(DRIVING, "ARMING_RUDDER 1 arms only, 0 does nothing; a throttle away from trim prevents it")
def _():
    bench = Bench({"ARMING_RUDDER": 1})
    bench.run(1.2, every=override())
    assert rudder(bench, 1900, 2.5)
    assert rudder(bench, 1100, 10.0)
    bench = Bench({"ARMING_RUDDER": 0})
    bench.run(1.2, every=override())
    assert not rudder(bench, 1900, 10.0)
    bench = Bench({"ARMING_RUDDER": 2})
    bench.run(1.2, every=override())
    bench.run(10.0, every=override(low=1900))
    assert not bench.rover.vehicle.modes.armed


@fact(DRIVING, "channel 3 below 910 is a radio failure")
def _():
    bench = Bench().ready()
    assert settle(bench) == HIGH
    assert settle(bench, low=900, high=HIGH) == [1500] * 4


@fact(DRIVING, "channel 8 is the mode channel")
def _():
    bench = Bench({"MODE1": 4, "MODE6": 0})
    bench.run(1.2, every=override())
    for us, mode in [(1100, 4), (1900, 0), (1100, 4)]:
        bench.run(0.4, every=one(8, us))
        assert bench.rover.vehicle.modes.mode == mode


@fact(DRIVING, "FS_THR: no override for 0.5 s is a failure, the action comes FS_TIMEOUT later, about 2.0 s")
def _():
    for action, mode, armed in [(2, 4, True), (5, 0, False)]:
        bench = Bench({"FS_ACTION": action}).ready()
        last_ns = bench.rover.vehicle.rc.last_input_ns
        bench.until(lambda: not bench.rover.vehicle.failsafe.rc_valid)  # noqa: B023
        assert (bench.t_ns - last_ns) / S == pytest.approx(0.5, abs=0.03)
        bench.until(lambda: bench.rover.vehicle.failsafe.triggered)  # noqa: B023
        assert (bench.t_ns - last_ns) / S == pytest.approx(2.0, abs=0.05)
        modes = bench.rover.vehicle.modes
        assert (modes.mode, modes.armed) == (mode, armed)


@fact(DRIVING, "without a receiver it boots into HOLD at about 1.5 s; overrides, then MANUAL")
def _():
    bench = Bench()
    bench.until(lambda: bench.rover.vehicle.modes.mode == 4)
    assert (bench.t_ns - bench.boot_ns) / S == pytest.approx(1.5, abs=0.05)
    bench.run(0.3, every=override())
    assert bench.ack(command(176, 1, 0)) == ACCEPTED


@fact(DRIVING, "median latency from override to output: 37, 17, 7, 2 ms at 50, 100, 200, 400 Hz")
def _():
    for rate_hz, median_ms in [(50, 37), (100, 17), (200, 7), (400, 2)]:
        bench = Bench({**PLAIN, "SCHED_LOOP_RATE": rate_hz}, dt_s=0.0005)
        bench.run(0.1, every=override(high=1500))
        start_ns = bench.t_ns
        bench.send(override(high=1700))
        bench.until(lambda: bench.out(1) == 1700)  # noqa: B023
        assert (bench.t_ns - start_ns) / MS == pytest.approx(median_ms, abs=0.5)


@fact(DRIVING, "SERVO_OUTPUT_RAW and RC_CHANNELS report what was put out and believed")
def _():
    bench = Bench().ready()
    got = bench.run(1.5, every=override(high=HIGH))
    assert of_type(got, "SERVO_OUTPUT_RAW")[-1].servo3_raw == 1900
    assert of_type(got, "RC_CHANNELS")[-1].chan12_raw == 1100
