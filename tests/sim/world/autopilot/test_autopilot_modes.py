import math

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot import AT_REST
from tests.sim.world.autopilot.autopilot_fixture import Bench, S, command, of_type, override, texts

PLAIN = {f"SERVO{n}_FUNCTION": 58 + n for n in range(1, 5)}
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4


def heartbeat(bench):
    return of_type(bench.run(1.01, every=override()), "HEARTBEAT")[-1]


def test_heartbeat_of_a_boat():
    bench = Bench().ready()
    beat = heartbeat(bench)
    assert (beat.type, beat.autopilot, beat.base_mode, beat.custom_mode) == (11, 3, 193, 0)
    assert (beat.get_srcSystem(), beat.get_srcComponent(), beat.get_msgbuf()[0]) == (1, 1, 0xFD)
    bench.send(command(400, 0))
    assert heartbeat(bench).base_mode == 65
    bench.send(command(176, 1, 4))
    beat = heartbeat(bench)
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (1, 4, 3)


def test_start_up_is_initialising_then_hold_after_a_second_and_a_half_without_rc():
    bench = Bench(dt_s=0.01)
    bench.join("boat")
    bench.run(0.5)
    assert of_type(bench.got["boat"], "HEARTBEAT")[0].custom_mode == 16
    assert bench.ack(command(176, 1, 0)) == FAILED
    bench.run(0.9)
    assert bench.rover.vehicle.modes.mode == 0
    bench.run(0.12)
    assert bench.rover.vehicle.modes.mode == 4
    assert (4, "Radio Failsafe") in texts(bench.got["boat"])
    bench.run(0.3, every=override())
    assert (6, "Radio Failsafe Cleared") in texts(bench.got["boat"])
    assert bench.rover.vehicle.modes.mode == 4
    assert bench.ack(command(176, 1, 0)) == ACCEPTED


@pytest.mark.parametrize("fs_action, mode, armed", [(0, 0, True), (2, 4, True), (5, 0, False)])
def test_radio_failsafe_acts_two_seconds_after_the_last_override(fs_action, mode, armed):
    bench = Bench({"FS_ACTION": fs_action}).ready()
    modes = bench.rover.vehicle.modes
    last_ns = bench.rover.vehicle.rc.last_input_ns
    bench.until(lambda: bench.rover.vehicle.failsafe.triggered)
    assert (bench.t_ns - last_ns) / S == pytest.approx(2.0, abs=0.05)
    assert (modes.mode, modes.armed) == (mode, armed)


def test_no_failsafe_acts_in_hold():
    bench = Bench({"FS_ACTION": 5}).ready()
    bench.send(command(176, 1, 4))
    bench.run(10.0)
    assert bench.rover.vehicle.modes.armed
    assert "Radio Failsafe" not in [text for _, text in texts(bench.got["boat"])]
    assert of_type(bench.got["boat"], "HEARTBEAT")[-1].system_status == 3


def test_the_failsafe_acts_again_at_the_second_loss():
    bench = Bench().ready()
    for _ in range(2):
        bench.run(3.0)
        assert bench.rover.vehicle.modes.mode == 4
        assert of_type(bench.run(1.01), "HEARTBEAT")[-1].system_status == 5
        bench.run(0.3, every=override())
        assert bench.ack(command(176, 1, 0)) == ACCEPTED


def test_a_failsafe_clears_overrides_so_that_sticks_return():
    bench = Bench({"RC_OVERRIDE_TIME": -1}).ready()
    bench.sensors = msgspec.structs.replace(AT_REST, receiver_us=(1444,) * 16)
    bench.run(6.0)
    assert bench.rover.vehicle.rc.radio_in_us[0] == 1500
    bench.run(1.0)  # nothing from SYSID_MYGCS for 6.5 s
    assert bench.rover.vehicle.failsafe.triggered
    assert bench.rover.vehicle.rc.radio_in_us[0] == 1444


def test_overrides_count_as_ground_station_heartbeats():
    bench = Bench({"FS_THR_ENABLE": 0}).ready()
    bench.run(20.0, every=override(), period_s=1.0)
    assert not bench.rover.vehicle.failsafe.bits
    since_s = (bench.t_ns - bench.rover.vehicle.failsafe.gcs_heard_ns) / S
    bench.run(6.45 - since_s)
    assert bench.rover.vehicle.modes.mode == 0
    bench.run(0.1)
    assert bench.rover.vehicle.modes.mode == 4
    assert (4, "GCS Failsafe") in texts(bench.got["boat"])


def test_another_ground_station_does_not_keep_the_failsafe_away():
    bench = Bench({"FS_THR_ENABLE": 0}).ready()
    bench.join("gcs", system=255)
    for _ in range(8):
        bench.send(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), "gcs")
        bench.run(1.0)
    assert bench.rover.vehicle.modes.mode == 4


@pytest.mark.parametrize(
    "params, result",
    [
        ((1, 0), ACCEPTED),
        ((1, 4), ACCEPTED),
        ((1, 15), ACCEPTED),
        ((0, 4), DENIED),
        ((1, 99), FAILED),
        ((1, 16), FAILED),
    ],
)
def test_do_set_mode_disarmed(params, result):
    bench = Bench()
    bench.run(1.2, every=override())
    assert bench.ack(command(176, *params)) == result


def test_guided_needs_a_position():
    bench = Bench().ready()
    assert bench.ack(command(176, 1, 15)) == FAILED
    assert (4, "Flight mode change failed") in texts(bench.got["boat"])
    bench.send(command(400, 0))
    assert bench.ack(command(176, 1, 15)) == ACCEPTED
    assert bench.ack(command(400, 1)) == FAILED
    assert (2, "Arm: AHRS: waiting for home") in texts(bench.got["boat"])
    assert bench.ack(command(400, 1, 2989)) == ACCEPTED


def test_refusal_is_an_ack_then_critical_texts():
    bench = Bench(PLAIN)
    bench.run(1.2, every=override())
    answers = bench.send(command(400, 1))
    assert [m.get_type() for m in answers] == ["COMMAND_ACK", "STATUSTEXT", "STATUSTEXT"]
    assert (answers[0].command, answers[0].result) == (400, FAILED)
    assert (answers[0].target_system, answers[0].target_component) == (1, 191)
    assert texts(answers) == [(2, "PreArm: no motor, sail or scripting outputs defined")]


def test_long_texts_come_in_chunks_of_50_with_one_id():
    bench = Bench(PLAIN)
    bench.run(1.2, every=override())
    chunks = of_type(bench.send(command(401)), "STATUSTEXT")
    assert [(len(m.text), m.chunk_seq) for m in chunks] == [(50, 0), (1, 1)]
    assert len({m.id for m in chunks}) == 1
    assert chunks[0].id
    assert texts(chunks) == [(2, "PreArm: no motor, sail or scripting outputs defined")]


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 99, 100, 101, 230])
def test_texts_of_any_length_survive_and_end(length):
    bench = Bench()
    bench.join("boat")
    text = "".join(chr(33 + i % 90) for i in range(length))
    bench.rover.vehicle.say(6, text)
    got = of_type(bench.run(0.01), "STATUSTEXT")
    assert texts(got) == [(6, text)]
    assert len(got) == 1 or len(got[-1].text) < 50


def test_arming_twice_disarming_twice_and_nonsense():
    bench = Bench().ready()
    assert bench.ack(command(400, 1)) == ACCEPTED
    assert bench.ack(command(400, 0)) == ACCEPTED
    assert bench.ack(command(400, 0)) == ACCEPTED
    assert bench.ack(command(400, 0.5)) == UNSUPPORTED
    assert bench.ack(command(31000, 1)) == UNSUPPORTED
    said = [text for _, text in texts(bench.got["boat"])]
    assert (said.count("Throttle armed"), said.count("Throttle disarmed")) == (1, 1)


def test_arming_is_refused_with_the_safety_switch_on_and_while_starting():
    bench = Bench()
    bench.run(0.5, every=override())
    assert bench.ack(command(400, 1)) == FAILED
    bench.run(0.7, every=override())
    bench.send(command(5300, 0))
    assert bench.ack(command(400, 1)) == FAILED
    said = [text for _, text in texts(bench.got["boat"])]
    assert said == ["Arm: Mode not armable", "Arm: Hardware safety switch"]


def test_arming_check_zero_skips_the_checks():
    bench = Bench({**PLAIN, "ARMING_CHECK": 0})
    bench.run(1.2, every=override())
    assert bench.ack(command(400, 1)) == ACCEPTED


@pytest.mark.parametrize("number", [176, 400, 510, 511, 512, 520, 5300])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_command_with_unfinite_parameters_gets_an_answer(number, bad):
    assert Bench().ack(command(number, bad, bad, bad, bad, bad, bad, bad)) in (ACCEPTED, DENIED, UNSUPPORTED, FAILED)


def test_a_command_to_another_system_is_ignored_and_a_broadcast_obeyed():
    bench = Bench()
    bench.run(1.2, every=override())
    params = [1.0, 4.0, 0, 0, 0, 0, 0]
    assert bench.send(wire.MAVLink_command_long_message(2, 1, 176, 0, *params)) == []
    assert bench.rover.vehicle.modes.mode == 0
    assert bench.send(wire.MAVLink_command_int_message(0, 0, 0, 176, 0, 0, 1.0, 4.0, 0, 0, 0, 0, 0))
    assert bench.rover.vehicle.modes.mode == 4


def test_a_command_to_a_component_of_its_system_is_obeyed_unless_that_one_is_on_another_link():
    bench = Bench()
    bench.run(1.2, every=override())
    bench.join("camera", component=100)
    request = wire.MAVLink_command_long_message(1, 100, 520, 0, 1, 0, 0, 0, 0, 0, 0)
    assert bench.send(request)
    bench.send(wire.MAVLink_heartbeat_message(30, 8, 0, 0, 4, 3), "camera")
    assert bench.send(request) == []


def test_prearm_bit_follows_what_arming_would_say():
    bench = Bench().ready()
    bench.send(command(400, 0))
    bit = wire.MAV_SYS_STATUS_PREARM_CHECK
    status = of_type(bench.run(1.01, every=override()), "SYS_STATUS")[-1]
    assert status.onboard_control_sensors_health & bit
    bench.send(command(176, 1, 15))
    status = of_type(bench.run(1.01, every=override()), "SYS_STATUS")[-1]
    assert not status.onboard_control_sensors_health & bit
