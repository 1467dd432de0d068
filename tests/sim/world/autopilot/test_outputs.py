import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.outputs import latency_ns
from tests.sim.world.autopilot.autopilot_fixture import MS, Bench, S, command, override, texts

PLAIN = {f"SERVO{n}_FUNCTION": 58 + n for n in range(1, 5)}  # RCIN9-12
SCALED = {f"SERVO{n}_FUNCTION": 147 + n for n in range(1, 5)}  # RCIN9-12 scaled
HIGH = [1600, 1400, 1900, 1100]


def settle(bench, **kwargs):
    bench.run(0.2, every=override(high=HIGH), **kwargs)
    return list(bench.rover.outputs_us[:4])


def test_the_gate_passes_only_while_armed_in_manual_with_rc_input():
    bench = Bench().ready()
    assert settle(bench) == HIGH
    bench.send(command(176, 1, 4))
    assert settle(bench) == [1500] * 4  # HOLD
    bench.send(command(176, 1, 0))
    assert settle(bench) == HIGH
    bench.send(command(400, 0))
    assert settle(bench) == [1500] * 4  # disarmed
    assert bench.ack(command(400, 1)) == 0
    assert settle(bench) == HIGH
    assert set(bench.rover.outputs_us[4:]) == {0}


def test_a_script_that_is_stopped_leaves_its_pulses_for_a_fifth_of_a_second_and_then_the_trim():
    bench = Bench({"SERVO2_TRIM": 1480}, dt_s=0.001).ready()
    assert settle(bench) == HIGH
    assert (2, "Scripting: stopped") in texts(bench.send(command(42701, wire.SCRIPTING_CMD_STOP)))
    bench.run(0.19, every=override(high=[1700] * 4))
    assert list(bench.rover.outputs_us[:4]) == HIGH, "nobody writes what is commanded now"
    assert settle(bench) == [1500, 1480, 1500, 1500]
    assert bench.ack(command(42701, wire.SCRIPTING_CMD_STOP_AND_RESTART)) == 0
    got = bench.run(1.1, every=override(high=HIGH))
    assert list(bench.rover.outputs_us[:4]) == HIGH and (2, "Scripting: restarted") in texts(got)


def test_without_scripts_stopping_them_says_and_does_nothing():
    bench = Bench({"SCR_ENABLE": 0}).ready()
    assert settle(bench) == [0] * 4
    assert bench.ack(command(42701, wire.SCRIPTING_CMD_STOP_AND_RESTART)) == 0
    assert bench.ack(command(42701, wire.SCRIPTING_CMD_REPL_START)) == 3
    assert settle(bench) == [0] * 4 and not [t for _, t in texts(bench.run(2.0)) if "Scripting" in t]


def test_the_gate_clamps_and_treats_a_channel_never_given_as_neutral():
    bench = Bench().ready()
    bench.run(0.2, every=override(high=[2200, 900, 65533, 0]))
    assert bench.rover.outputs_us[:4] == (1900, 1100, 1900, 1500)


def test_the_gate_is_neutral_half_a_second_after_the_last_override():
    bench = Bench(dt_s=0.001).ready()
    assert settle(bench) == HIGH
    last_ns = bench.rover.vehicle.rc.last_input_ns
    bench.until(lambda: bench.out(1) == 1500)
    assert 0.50 <= (bench.t_ns - last_ns) / S <= 0.54
    assert bench.rover.outputs_us[:4] == (1500,) * 4


@pytest.mark.parametrize("gcs_failsafe, after", [(0, HIGH), (1, [1500] * 4)])
def test_without_the_radio_failsafe_only_the_ground_station_failsafe_closes_the_gate(gcs_failsafe, after):
    bench = Bench({"FS_THR_ENABLE": 0, "FS_GCS_ENABLE": gcs_failsafe}).ready()
    assert settle(bench) == HIGH
    bench.run(6.0)
    assert list(bench.rover.outputs_us[:4]) == HIGH
    bench.run(30.0)
    assert list(bench.rover.outputs_us[:4]) == after


def test_a_throttle_channel_below_910_closes_the_gate_although_overrides_flow():
    bench = Bench().ready()
    assert settle(bench) == HIGH
    bench.run(0.2, every=override(low=900, high=HIGH))
    assert bench.rover.outputs_us[:4] == (1500,) * 4


def test_plain_rcin_keeps_its_last_pulse_whatever_happens_but_the_safety_switch():
    bench = Bench(PLAIN)
    bench.run(1.2)
    assert settle(bench) == HIGH  # disarmed: it does not care
    bench.run(60.0)
    zeros = wire.MAVLink_rc_channels_override_message(0, 0, *[0] * 18)
    bench.run(0.2, every=zeros)
    bench.send(command(176, 1, 4))
    bench.send(command(400, 0))
    bench.run(1.0)
    assert list(bench.rover.outputs_us[:4]) == HIGH
    assert bench.ack(command(5300, 0)) == 0
    bench.run(0.1)
    assert bench.rover.outputs_us == (0,) * 16
    assert bench.ack(command(5300, 1)) == 0
    bench.run(0.1)
    assert list(bench.rover.outputs_us[:4]) == HIGH


def test_plain_rcin_takes_any_number():
    bench = Bench(PLAIN)
    bench.run(1.2, every=override(high=[800, 2300, 65533, 1500]))
    assert bench.rover.outputs_us[:4] == (800, 2300, 65533, 1500)


def test_scaled_rcin_is_one_to_one_clipped_and_not_cut_by_disarm_or_hold():
    bench = Bench(SCALED)
    for value, expected in [
        (1100, 1100),
        (1233, 1233),
        (1501, 1501),
        (1899, 1899),
        (2100, 1900),
        (900, 1100),
    ]:
        bench.run(0.2, every=override(high=value))
        assert bench.out(1) == expected
    bench.send(command(176, 1, 4))
    assert settle(bench) == HIGH


def test_the_dead_zone_distorts_the_scaled_mapping():
    bench = Bench({**SCALED, "RC9_DZ": 30})
    for value, expected in [(1530, 1500), (1470, 1500), (1715, 1700), (1900, 1900), (1100, 1100)]:
        bench.run(0.2, every=override(high=value))
        assert bench.out(1) == expected


def test_scaled_rcin_goes_to_trim_on_loss_only_where_the_mask_says_so():
    bench = Bench({**SCALED, "SERVO_RC_FS_MSK": 1 << 8 | 1 << 9, "SERVO2_TRIM": 1480, "SERVO1_REVERSED": 1}, dt_s=0.002)
    bench.run(1.2, every=override())
    bench.run(0.2, every=override(high=HIGH))
    assert bench.out(1) == 1400  # reversed
    last_ns = bench.rover.vehicle.rc.last_input_ns
    bench.until(lambda: bench.out(1) == 1500)
    assert 0.50 <= (bench.t_ns - last_ns) / S <= 0.54
    assert bench.rover.outputs_us[1] == 1480
    assert bench.rover.outputs_us[2:4] == (1900, 1100)  # not in the mask: the last value


@pytest.mark.parametrize("rate_hz, median_ms", [(50, 37), (100, 17), (200, 7), (400, 2)])
def test_latency_table_of_the_real_firmware(rate_hz, median_ms):
    assert latency_ns(rate_hz) == median_ms * MS
    bench = Bench({**PLAIN, "SCHED_LOOP_RATE": rate_hz}, dt_s=0.0005)
    bench.run(0.1, every=override(high=1500))
    start_ns = bench.t_ns
    bench.send(override(high=1700))
    bench.until(lambda: bench.out(1) == 1700)
    assert (bench.t_ns - start_ns) / MS == pytest.approx(median_ms, abs=0.5)


@pytest.mark.parametrize("rate_hz, median_ms", [(50, 50), (100, 27), (200, 15)])
def test_the_gate_is_as_late_as_in_lockstep(rate_hz, median_ms):
    """Medians of 4.6 by its pulses, docs/run-file.md."""
    assert latency_ns(rate_hz, script=True) / MS == pytest.approx(median_ms, abs=0.5)
    bench = Bench({"SCHED_LOOP_RATE": rate_hz}, dt_s=0.0005).ready()
    bench.run(0.1, every=override(high=1500))
    start_ns = bench.t_ns
    bench.send(override(high=1700))
    (due_ns, pulses_us), *_, last = bench.rover.outputs_before(start_ns + 100 * MS)
    assert due_ns - start_ns == latency_ns(rate_hz, script=True) and 1700 in pulses_us
    assert bench.rover.outputs_before(due_ns) == [] and last == (due_ns, (1700,) * 4 + (0,) * 12)
    bench.until(lambda: bench.out(1) == 1700)
    assert (bench.t_ns - start_ns) / MS == pytest.approx(median_ms, abs=1.0)


@pytest.mark.parametrize("seed", range(5))
def test_whatever_is_sent_the_gate_is_neutral_when_disarmed_or_silent(seed):
    draw = random.Random(seed)
    bench = Bench()
    for _ in range(60):
        kind = draw.randrange(5)
        if kind == 0:
            bench.send(command(400, draw.randrange(2), draw.choice([0, 21196])))
        elif kind == 1:
            bench.send(command(176, 1, draw.choice([0, 4, 5, 15, 16, 99])))
        elif kind == 2:
            bench.send(wire.MAVLink_rc_channels_override_message(0, 0, *[draw.randrange(65536) for _ in range(18)]))
        elif kind == 3:
            bench.run(0.5, every=override(high=[draw.randrange(900, 2200) for _ in range(4)]))
        else:
            bench.run(draw.uniform(0.0, 1.5))
        assert all(1100 <= us <= 1900 for us in bench.rover.outputs_us[:4]) or bench.t_ns < bench.boot_ns + S
        if kind == 0 and not bench.rover.vehicle.modes.armed:
            bench.run(0.05)
            assert bench.rover.outputs_us[:4] == (1500,) * 4
    bench.run(0.6)
    assert bench.rover.outputs_us[:4] == (1500,) * 4


def test_a_function_set_while_running_takes_effect_at_once():
    bench = Bench()
    bench.run(1.2, every=override(high=HIGH))
    assert bench.out(5) == 0
    bench.send(wire.MAVLink_param_set_message(1, 1, b"SERVO5_FUNCTION", 59.0, wire.MAV_PARAM_TYPE_INT16))
    bench.run(0.05)
    assert bench.out(5) == HIGH[0]
