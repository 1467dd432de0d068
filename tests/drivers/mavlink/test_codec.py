import math
import random
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.core.messages import (
    Attitude,
    AutopilotInfo,
    Battery,
    CommandAck,
    Heartbeat,
    ImuSample,
    MotorOutputs,
    ParamValue,
    RcChannels,
    ServoOutput,
    StatusText,
)
from drivers.mavlink.codec import MavlinkCodec
from tests.drivers.mavlink.mavlink_autopilot import Sender, frame, read_one

T = 5_000_000_000
G0 = 9.80665
NAN, INF = float("nan"), float("inf")


def one(data: bytes, **kwargs):
    messages = MavlinkCodec(target_system=1, **kwargs).feed(data, T)
    assert len(messages) == 1
    return messages[0]


def test_attitude():
    f = [struct_float(v) for v in (0.1, -0.2, -3.1, 0.01, 0.02, -0.03)]
    assert one(Sender().attitude(1000, *f)) == Attitude(
        t_ns=T,
        t_rx_ns=T,
        phi_rad=f[0],
        theta_rad=f[1],
        psi_rad=f[2],
        p_rad_s=f[3],
        q_rad_s=f[4],
        r_rad_s=f[5],
    )


def test_rates_are_those_of_the_gyros_whatever_the_ahrs_adds():
    """A correction that is no number changes nothing."""
    codec = MavlinkCodec(target_system=1)
    for drift, told in (((0.01, -0.02, 0.03), (0.1, 0.2, 0.3)), ((NAN, 0.0, 0.0), (0.1, 0.2, 0.3))):
        assert codec.feed(Sender().ahrs(*drift, 0, 0, 0, 0), T) == []
        (m,) = codec.feed(Sender().attitude(1000, 0, 0, 0, 0.11, 0.18, 0.33), T)
        assert (m.p_rad_s, m.q_rad_s, m.r_rad_s) == pytest.approx(told, abs=1e-6)
        codec.feed(Sender().attitude(2000, 0, 0, 0, 0, 0, 0), T)
    assert codec.counters.invalid == {"AHRS": 1}


def struct_float(value: float) -> float:
    """`value` as a 32-bit float holds it."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


@pytest.mark.parametrize("name", ["raw_imu", "scaled_imu", "scaled_imu2", "scaled_imu3"])
def test_imu_in_milli_g_and_mrad_s(name: str):
    sample = one(getattr(Sender(), name)(1000, 1000, -500, -1001, 1, -2000, 300, 0, 0, 0))
    assert isinstance(sample, ImuSample)
    assert sample.source == name.upper()
    assert (sample.ax_m_s2, sample.ay_m_s2) == pytest.approx((1.0005 * G0, -0.5005 * G0))  # cut to whole ones
    assert sample.az_m_s2 == pytest.approx(-1.0015 * G0)
    assert (sample.p_rad_s, sample.q_rad_s, sample.r_rad_s) == pytest.approx((0.0015, -2.0005, 0.3005))


def test_absent_imu_of_zeros_is_no_sample():
    assert MavlinkCodec(target_system=1).feed(Sender().scaled_imu2(1, *[0] * 6, -289, 162, 223), T) == []


def highres(accel=(0.5, -0.25, -9.75), updated=0x3F, pressure=1000.0) -> bytes:
    return Sender().highres_imu(1, *accel, 0.125, 0.25, 0.5, 0, 0, 0, pressure, 0, 0, 20, updated)


def test_highres_imu_is_si_already():
    sample = one(highres())
    assert (sample.ax_m_s2, sample.ay_m_s2, sample.az_m_s2) == (0.5, -0.25, -9.75)
    assert (sample.p_rad_s, sample.q_rad_s, sample.r_rad_s) == (0.125, 0.25, 0.5)
    assert one(highres(pressure=NAN)) == sample  # a field that nobody uses
    assert MavlinkCodec(target_system=1).feed(highres(updated=0x1F), T) == []


def sys_status(mv: int, ca: int, percent: int) -> bytes:
    return Sender().sys_status(0, 0, 0, 0, mv, ca, percent, 0, 0, 0, 0, 0, 0)


def test_battery():
    assert one(sys_status(16233, 42, 80)) == Battery(
        t_ns=T, voltage_v=pytest.approx(16.233), current_a=pytest.approx(0.42), remaining_percent=80
    )
    assert one(sys_status(16000, -1, -1)) == Battery(t_ns=T, voltage_v=16.0)
    assert MavlinkCodec(target_system=1).feed(sys_status(65535, 42, 80), T) == []


@pytest.mark.parametrize(("present", "enabled", "told"), [(1, 1, [True]), (1, 0, [False]), (0, 1, []), (0, 0, [])])
def test_the_safety_switch_is_a_bit_of_sys_status(present, enabled, told):
    bit = 0x8000  # MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    others = 0xFFFFFFFF ^ bit
    data = Sender().sys_status(others | present * bit, others | enabled * bit, 0, 0, 65535, -1, -1, 0, 0, 0, 0, 0, 0)
    assert MavlinkCodec(target_system=1).feed(data, T) == [MotorOutputs(t_ns=T, enabled=e) for e in told]


def battery_status(ident: int, cells: list[int], ext=(0, 0, 0, 0)) -> bytes:
    padded = cells + [65535] * (10 - len(cells))
    return Sender().battery_status(ident, 0, 0, 32767, padded, 150, 0, 0, -1, 0, 0, list(ext))


def test_battery_cells_add_up():
    assert one(battery_status(0, [4000, 4010, 4020], (4030, 0, 0, 0))).voltage_v == pytest.approx(16.06)
    assert one(battery_status(0, [4000, 4010, 4020], (65535,) * 4)).voltage_v == pytest.approx(12.03)
    assert one(battery_status(0, [16000])) == Battery(t_ns=T, voltage_v=16.0, current_a=1.5)
    codec = MavlinkCodec(target_system=1)
    assert codec.feed(battery_status(1, [12000]) + battery_status(0, []), T) == []


def test_servo_outputs_of_both_ports():
    codec, sender = MavlinkCodec(target_system=1), Sender()
    first, second = [*range(1100, 1115), 65535], list(range(1200, 1216))

    def port(number: int, pwm: list[int]) -> bytes:
        return sender.servo_output_raw(1, number, *pwm[:8], *pwm[8:])

    assert codec.feed(port(0, first), T) == [ServoOutput(t_ns=T, pwm_us=(*first[:15], 0))]
    assert codec.feed(port(1, second), T) == []
    assert codec.feed(port(0, first), T) == [ServoOutput(t_ns=T, pwm_us=(*first[:15], 0, *second))]
    assert codec.feed(port(7, first), T) == []
    assert codec.counters.invalid == {"SERVO_OUTPUT_RAW": 1}


def test_rc_channels():
    channels = [1500] * 17 + [65535]
    assert one(Sender().rc_channels(1, 17, *channels, 255)) == RcChannels(t_ns=T, pwm_us=(1500,) * 17 + (0,))
    assert one(Sender().rc_channels(1, 17, *channels, 0)).rssi == 0


def test_command_ack_is_for_us_or_not():
    sender, codec = Sender(), MavlinkCodec(system=1, component=191, target_system=1)
    mine = sender.command_ack(400, 4, 0, 0, 1, 191)
    everyones = sender.command_ack(512, 0)
    others = sender.command_ack(400, 0, 0, 0, 255, 190) + sender.command_ack(400, 0, 0, 0, 1, 195)
    assert codec.feed(mine + others + everyones, T) == [
        CommandAck(t_ns=T, command=400, result=4),
        CommandAck(t_ns=T, command=512, result=0),
    ]
    assert codec.counters.ignored == {"COMMAND_ACK": 2}


def test_parameters_version_and_text():
    assert one(Sender().param_value(b"RC1_MIN", 1100.0, 4, 1272, 3)) == ParamValue(
        t_ns=T, name="RC1_MIN", value=1100.0, index=3, count=1272
    )
    assert one(Sender().param_value(b"SIXTEEN_LETTERS_", 1.0, 4, 1272, 65535)) == ParamValue(
        t_ns=T, name="SIXTEEN_LETTERS_", value=1.0, index=None, count=1272
    )
    version = Sender().autopilot_version(7, 0x040600FF, 0, 0, 140, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)
    assert one(version) == AutopilotInfo(t_ns=T, flight_sw_version=0x040600FF, board_version=140, capabilities=7)
    assert one(Sender().statustext(2, b"Arm: no")) == StatusText(t_ns=T, severity=2, text="Arm: no")


def test_long_text_in_chunks_and_with_one_missing():
    sender, codec = Sender(), MavlinkCodec(target_system=1)
    text = b"x" * 50 + b"y" * 50 + b"end"
    parts = [sender.statustext(2, text[i : i + 50], 9, i // 50) for i in range(0, len(text), 50)]
    assert codec.feed(b"".join(parts), T) == [StatusText(t_ns=T, severity=2, text=text.decode())]
    assert codec.feed(parts[0] + parts[2], T) == []
    late = T + 3_000_000_000
    assert codec.feed(b"", late) == [StatusText(t_ns=late, severity=2, text="x" * 50 + "[...]end")]


def test_only_the_autopilot_has_a_heartbeat_and_the_first_one_is_the_target():
    codec = MavlinkCodec()
    ground, camera = Sender(255, 190), Sender(1, 100)
    odd_ground, boat, other = Sender(254, 190), Sender(3, 1), Sender(4, 1)
    before = ground.beat(kind=6, autopilot=8) + camera.beat(kind=30, autopilot=8)
    before += odd_ground.beat(kind=6, autopilot=0) + camera.beat(kind=0, autopilot=8) + boat.att()
    assert codec.feed(before, T) == []
    assert codec.target is None
    assert codec.feed(boat.beat(armed=True), T) == [
        Heartbeat(
            t_ns=T,
            system=3,
            component=1,
            vehicle_type=11,
            autopilot=3,
            base_mode=193,
            custom_mode=0,
            system_status=4,
            armed=True,
        )
    ]
    assert codec.target == (3, 1)
    assert read_one(codec.encoder.arm()).target_system == 3
    assert codec.feed(other.beat() + other.att() + camera.att() + ground.att(), T) == []
    assert [type(m) for m in codec.feed(boat.att(), T)] == [Attitude]
    assert codec.counters.received["ATTITUDE"] == 5
    assert codec.counters.ignored["ATTITUDE"] == 4
    assert codec.counters.from_target("ATTITUDE") == 1


def test_other_autopilots_are_strangers_and_never_taken_for_ours():
    codec, boat, other, camera = MavlinkCodec(), Sender(3, 1), Sender(4, 1), Sender(5, 100)
    codec.feed(boat.beat(), T)
    assert not codec.ambiguous
    codec.feed(camera.beat(kind=30, autopilot=8) + Sender(3, 2).beat() + other.att(), T)
    assert codec.strangers == set(), "a camera, a second component of ours, no heartbeat yet"
    for k in range(600):
        assert codec.feed(other.beat(), T + k * 1_000_000_000) == []
    assert codec.strangers == {4} and codec.ambiguous and codec.target == (3, 1), "however long ours is silent"


def test_where_ours_is_named_the_first_that_is_heard_is_not_taken_for_it():
    codec, boat, other = MavlinkCodec(target_system=3), Sender(3, 1), Sender(4, 1)
    assert codec.feed(other.beat() + other.att(), T) == []
    assert (codec.strangers, codec.ambiguous, codec.target) == ({4}, False, (3, 1))
    assert read_one(codec.encoder.arm()).target_system == 3
    assert [type(m) for m in codec.feed(boat.beat(), T)] == [Heartbeat]


@pytest.mark.parametrize("bad", [NAN, INF, -INF])
@pytest.mark.parametrize("field", range(6))
def test_attitude_that_is_no_number_is_dropped_and_counted(field: int, bad: float):
    codec = MavlinkCodec(target_system=1)
    values = [0.1] * 6
    values[field] = bad
    assert codec.feed(Sender().attitude(1, *values), T) == []
    assert codec.counters.invalid == {"ATTITUDE": 1}
    assert codec.feed(highres(accel=(bad, 0, 0)) + Sender().param_value(b"X", bad, 9, 1, 0), T) == []
    assert codec.counters.invalid == {"ATTITUDE": 1, "HIGHRES_IMU": 1, "PARAM_VALUE": 1}


def imu_stream(preference, schedule) -> list[str]:
    """Sources that come out of a schedule of (t_ms, source)."""
    codec, sender = MavlinkCodec(target_system=1, imu_preference=preference), Sender()
    out = []
    for t_ms, name in schedule:
        frame = getattr(sender, name)(t_ms, 0, 0, -1000, 0, 0, 0, 0, 0, 0)
        out += [m.source for m in codec.feed(frame, t_ms * 1_000_000)]
    return out


def test_one_imu_stream_by_preference_with_fallback():
    both = [(t, name) for t in range(0, 100, 20) for name in ("raw_imu", "scaled_imu2")]
    assert imu_stream(["RAW_IMU", "SCALED_IMU2"], both) == ["RAW_IMU"] * 5
    assert imu_stream(["SCALED_IMU2", "RAW_IMU"], both) == ["RAW_IMU", *["SCALED_IMU2"] * 5]
    assert imu_stream(["SCALED_IMU"], both) == []
    silent = [*both, *[(t, "scaled_imu2") for t in range(500, 1600, 250)], (1700, "raw_imu")]
    expected = ["RAW_IMU"] * 5 + ["SCALED_IMU2"] * 2 + ["RAW_IMU"]  # silence from 80 ms to beyond 1080 ms
    assert imu_stream(["RAW_IMU", "SCALED_IMU2"], silent) == expected


def test_lost_sequence_numbers_per_sender():
    codec, a, b = MavlinkCodec(target_system=1), Sender(), Sender(1, 100)
    frames = [a.att() for _ in range(300)]
    kept = [f for i, f in enumerate(frames) if i not in (5, 6, 256)]
    codec.feed(b"".join(kept) + b.att() + b.att(), T)
    assert codec.counters.lost == {(1, 1): 3, (1, 100): 0}


def test_unmapped_messages_are_counted_only():
    codec = MavlinkCodec(target_system=1)
    assert codec.feed(Sender().vfr_hud(0, 0, 0, 0, 0, 0), T) == []
    assert codec.counters.received == {"VFR_HUD": 1}


@settings(deadline=None)
@given(st.lists(st.binary(max_size=300), max_size=6))
def test_never_raises_on_any_bytes(chunks: list[bytes]):
    codec = MavlinkCodec()
    for i, chunk in enumerate(chunks):
        codec.feed(chunk, i)


@settings(deadline=None)
@given(st.data())
def test_never_raises_on_any_content_and_gives_finite_numbers(data: st.DataObject):
    """Frames of every message type with random contents and a good checksum."""
    codec = MavlinkCodec(target_system=1)
    ident = data.draw(st.sampled_from(sorted(dialect.mavlink_map)))
    mapped = [0, 1, 22, 26, 27, 30, 36, 65, 77, 105, 111, 147, 148, 253]
    rng = random.Random(data.draw(st.integers(0, 2**32)))
    for number in (ident, *mapped):
        payload = rng.randbytes(dialect.mavlink_map[number].unpacker.size)
        for m in codec.feed(frame(number, payload), T):
            values = [getattr(m, name) for name in m.__struct_fields__]
            assert all(math.isfinite(v) for v in values if isinstance(v, float))
    assert codec.framer.bad_bytes == 0
    assert codec.counters.received.total() == 1 + len(mapped)
