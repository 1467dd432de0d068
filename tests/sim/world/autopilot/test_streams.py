import itertools
import math
import random
from collections import Counter

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as wire
from pymavlink.quaternion import QuaternionBase

from sim.world.autopilot import AT_REST, rover
from tests.sim.world.autopilot.autopilot_fixture import MS, Bench, S, command, of_type, override

ACCEPTED, DENIED, FAILED = 0, 2, 4
UNASKED = {
    "HEARTBEAT", "SYS_STATUS", "SYSTEM_TIME", "GPS_RAW_INT", "RAW_IMU", "ATTITUDE", "SERVO_OUTPUT_RAW",
    "MISSION_CURRENT", "RC_CHANNELS", "VFR_HUD", "SCALED_IMU2", "BATTERY_STATUS", "AHRS", "AHRS2",
    "EKF_STATUS_REPORT", "GLOBAL_POSITION_INT", "MEMINFO", "POWER_STATUS", "RC_CHANNELS_SCALED", "SCALED_IMU3",
    "SCALED_PRESSURE", "SCALED_PRESSURE2", "VIBRATION",
}  # fmt: skip


def ask(bench, message_id, hz, peer="boat"):
    return bench.ack(command(511, message_id, 1e6 / hz), peer)


def counts(messages):
    return Counter(m.get_type() for m in messages)


def test_unasked_streams_come_once_a_second():
    bench = Bench()
    bench.join("boat")
    bench.run(1.0)
    got = counts(bench.run(10.0))
    assert {name for name, n in got.items() if n == 10} == UNASKED
    assert got["TIMESYNC"] == 1
    assert set(got) - UNASKED <= {"TIMESYNC", "STATUSTEXT"}


@pytest.mark.parametrize(
    "loop_hz, asked_hz, expected_hz",
    [
        (200, 50, 50),
        (200, 10, 10),
        (50, 50, 40),
        (50, 200, 40),
        (50, 20, 20),
        (400, 200, 200),
        (200, 1000, 166.7),
    ],
)
def test_rates_are_exact_and_capped_at_80_percent_of_the_loop_silently(loop_hz, asked_hz, expected_hz):
    bench = Bench({"SCHED_LOOP_RATE": loop_hz}, dt_s=0.00125)
    assert ask(bench, 30, asked_hz) == ACCEPTED
    got = of_type(bench.run(4.0), "ATTITUDE")
    assert len(got) == pytest.approx(4 * expected_hz, abs=1)
    gaps_ms = [b.time_boot_ms - a.time_boot_ms for a, b in itertools.pairwise(got)]
    assert max(gaps_ms) - min(gaps_ms) <= 2


def test_rates_are_kept_with_a_coarse_step():
    bench = Bench(dt_s=0.01)
    ask(bench, 30, 40)
    assert len(of_type(bench.run(10.0), "ATTITUDE")) == pytest.approx(400, abs=1)


def test_rates_are_per_link_and_go_with_it():
    bench = Bench()
    bench.join("other")
    ask(bench, 30, 50)
    bench.run(2.0)
    assert len(of_type(bench.got["boat"], "ATTITUDE")) == 100
    assert len(of_type(bench.got["other"], "ATTITUDE")) == 2
    bench.rover.remove_link("boat")
    bench.rover.add_link("boat")
    assert len(of_type(bench.run(2.0), "ATTITUDE")) == 2


def test_off_default_and_what_is_asked_about_it():
    bench = Bench()
    assert bench.ack(command(511, 30, -1)) == ACCEPTED
    assert not of_type(bench.run(3.0), "ATTITUDE")
    assert of_type(bench.send(command(510, 30)), "MESSAGE_INTERVAL")[0].interval_us == -1
    bench.send(command(511, 30, 0))
    assert len(of_type(bench.run(3.0), "ATTITUDE")) == 3
    bench.send(command(511, 30, 33_333))
    assert of_type(bench.send(command(510, 30)), "MESSAGE_INTERVAL")[0].interval_us == 33_000


@pytest.mark.parametrize("firmware, message_id", [("4.6", 105), ("4.6", 111), ("4.7", 111), ("4.7", 31000)])
def test_a_message_without_a_rate_is_denied(firmware, message_id):
    bench = Bench(firmware=firmware)
    answers = bench.send(command(511, message_id, 20_000))
    assert (answers[0].result, answers[1].text) == (DENIED, f"No ap_message for mavlink id ({message_id})")
    assert of_type(bench.send(command(510, message_id)), "MESSAGE_INTERVAL")[0].interval_us == 0


def test_highres_imu_of_4_7():
    bench = Bench(firmware="4.7")
    assert ask(bench, 105, 10) == ACCEPTED
    imu = of_type(bench.run(1.0), "HIGHRES_IMU")
    assert len(imu) in (9, 10) and imu[-1].zacc == pytest.approx(-9.80665)


def test_what_needs_a_position_is_accepted_and_never_comes():
    bench = Bench()
    assert ask(bench, 32, 10) == ask(bench, 49, 10) == ACCEPTED
    assert not {"LOCAL_POSITION_NED", "GPS_GLOBAL_ORIGIN"} & set(counts(bench.run(3.0)))


def test_attitude_as_a_quaternion_is_the_same_attitude():
    bench = Bench(sensors=msgspec.structs.replace(AT_REST, phi_rad=0.1, theta_rad=-0.2, psi_rad=4.0))
    bench.run(1.2)
    got = of_type(bench.send(command(512, 31)), "ATTITUDE_QUATERNION")[0]
    euler = QuaternionBase([got.q1, got.q2, got.q3, got.q4]).euler
    assert list(euler) == pytest.approx([0.1, -0.2, 4.0 - 2 * math.pi], abs=1e-6)


def test_request_data_stream_sets_groups():
    bench = Bench()
    bench.send(wire.MAVLink_request_data_stream_message(1, 1, wire.MAV_DATA_STREAM_ALL, 4, 1))
    got = counts(bench.run(5.0))
    assert {got[name] for name in UNASKED - {"HEARTBEAT"}} == {20}
    assert got["HEARTBEAT"] in (5, 6)
    bench.send(wire.MAVLink_request_data_stream_message(1, 1, wire.MAV_DATA_STREAM_EXTRA1, 4, 0))
    assert not of_type(bench.run(3.0), "ATTITUDE")


def test_a_parameter_download_slows_the_streams_from_50_to_34_hz():
    bench = Bench(dt_s=0.005)
    ask(bench, 30, 50)
    bench.send(wire.MAVLink_param_request_list_message(1, 1))
    bench.run(0.54)  # 272 parameters at 500 a second
    assert len(of_type(bench.got["boat"], "ATTITUDE")) == pytest.approx(0.54 * 34, abs=1.5)
    assert len(of_type(bench.run(2.0), "ATTITUDE")) == pytest.approx(100, abs=2)


def test_imu_is_in_milli_g_and_mrad_cut_towards_zero():
    sensors = msgspec.structs.replace(
        AT_REST, accel_m_s2=(0.0196, -0.0294, -9.8155), gyro_rad_s=(0.0019, -0.0019, 400.0)
    )
    bench = Bench(sensors=sensors)
    bench.join("boat")
    raw = of_type(bench.run(1.5), "RAW_IMU")[0]
    assert (raw.xacc, raw.yacc, raw.zacc, raw.xgyro, raw.ygyro, raw.zgyro) == (1, -2, -1000, 1, -1, 32767)
    assert (raw.time_usec, raw.id) == (1_000_000, 0)
    second = of_type(bench.got["boat"], "SCALED_IMU2")[0]
    assert (second.xacc, second.zacc, second.time_boot_ms) == (1, -1000, 1000)


def test_attitude_and_battery():
    sensors = msgspec.structs.replace(
        AT_REST, phi_rad=0.1, theta_rad=-0.2, psi_rad=4.0, p_rad_s=0.3, q_rad_s=0.4, r_rad_s=-0.5,
        voltage_v=15.4321, current_a=36.0,
    )  # fmt: skip
    bench = Bench({"BATT_CAPACITY": 100}, sensors=sensors)
    bench.join("boat")
    got = bench.run(5.0)
    a = of_type(got, "ATTITUDE")[0]
    expected = (0.1, -0.2, 4.0 - 2 * math.pi, 0.3, 0.4, -0.5)
    assert (a.roll, a.pitch, a.yaw, a.rollspeed, a.pitchspeed, a.yawspeed) == pytest.approx(expected, abs=1e-6)
    assert of_type(got, "VFR_HUD")[0].heading == int(math.degrees(4.0))
    s, b = of_type(got, "SYS_STATUS")[-1], of_type(got, "BATTERY_STATUS")[-1]
    assert (s.voltage_battery, s.current_battery) == (15432, 3600)
    assert (b.voltages[0], b.voltages[1], b.current_battery) == (15432, 65535, 3600)
    assert b.current_consumed == pytest.approx(50, abs=1)  # 36 A for 5 s
    assert b.battery_remaining == s.battery_remaining == pytest.approx(50, abs=1)


def test_timesync_both_ways_and_the_autopilots_own_clock():
    bench = Bench(drift_ppm=100.0)
    bench.join("boat")
    got = bench.run(20.0)
    answer = bench.send(wire.MAVLink_timesync_message(0, 77))[0]
    assert answer.ts1 == 77
    assert answer.tc1 == pytest.approx(20 * S + 2 * MS, abs=1000)
    assert answer.tc1 % 1000 == 0
    own = of_type(got, "TIMESYNC")
    assert [m.tc1 for m in own] == [0, 0]
    assert own[0].ts1 == pytest.approx(10 * S + MS, abs=1000)
    assert bench.send(wire.MAVLink_timesync_message(5, own[0].ts1)) == []
    times = of_type(got, "SYSTEM_TIME")
    assert {m.time_unix_usec for m in times} == {0}
    assert times[-1].time_boot_ms == 20_002


@pytest.mark.parametrize("request_", [command(512, 148), command(520, 1)])
def test_autopilot_version_on_request(request_):
    bench = Bench()
    ack, version = bench.send(request_)
    assert (ack.get_type(), ack.result) == ("COMMAND_ACK", ACCEPTED)
    assert version.flight_sw_version >> 16 == 0x0406
    assert version.capabilities == 61935


def test_requests_for_messages_and_for_home():
    bench = Bench()
    assert [m.get_type() for m in bench.send(command(512, 30))] == ["COMMAND_ACK", "ATTITUDE"]
    assert bench.ack(command(512, 105)) == FAILED
    assert [m.get_type() for m in bench.send(command(512, 242))] == ["COMMAND_ACK"]
    assert bench.ack(command(410)) == FAILED


def scene(seed):
    """Half a minute with two peers, commands and noise in the sensors: all bytes that came out."""
    draw = random.Random(seed)
    bench = Bench(drift_ppm=20.0, dt_s=0.02)
    bench.join("gcs", system=255)
    ask(bench, 30, 50)
    ask(bench, 27, 50)
    for _ in range(30):
        bench.sensors = msgspec.structs.replace(AT_REST, psi_rad=draw.gauss(0, 1), gyro_rad_s=(0, 0, draw.random()))
        bench.send(command(draw.choice([400, 176]), 1, draw.choice([0, 4])), "gcs")
        bench.run(1.0, every=override(high=draw.randrange(1100, 1900)))
    return bytes(bench.sent["boat"]), bytes(bench.sent["gcs"])


def test_the_same_calls_give_the_same_bytes():
    assert scene(1) == scene(1)
    assert scene(1) != scene(2)


def test_sequence_numbers_have_no_gap():
    bench = Bench()
    ask(bench, 30, 50)
    got = bench.run(10.0)
    numbers = [m.get_seq() for m in got]
    assert all((a + 1) % 256 == b for a, b in itertools.pairwise(numbers))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.binary(max_size=300), max_size=5))
def test_garbage_is_counted_and_what_follows_is_understood(pieces):
    bench = Bench()
    bench.join("boat")
    for piece in pieces:
        bench.rover.receive(piece, "boat", bench.t_ns)
    bench.rover.receive(bytes(280), "boat", bench.t_ns)  # ends whatever frame the garbage began
    assert any(of_type(bench.send(command(410)), "COMMAND_ACK") for _ in range(3))
    if any(len(p) for p in pieces):
        assert bench.rover.links["boat"].bad_data > 0


def test_no_message_of_the_dialect_with_any_content_raises(monkeypatch):
    """Seed 7: every message type that exists, twenty times, all bytes of the payload random."""
    monkeypatch.setattr(rover, "is_for", lambda made, link, message: True)
    draw = random.Random(7)
    bench = Bench()
    bench.run(1.2, every=override())
    frame = wire.MAVLink(None, 1, 191)
    for _ in range(20):
        for message_id, kind in wire.mavlink_map.items():
            message = wire.MAVLink_message(message_id, kind.msgname)
            data = message._pack(frame, kind.crc_extra, draw.randbytes(kind.unpacker.size))
            bench.rover.receive(data, "boat", bench.t_ns)
        bench.run(0.02)
    assert bench.rover.links["boat"].bad_data == 0
