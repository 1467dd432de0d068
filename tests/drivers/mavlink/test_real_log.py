"""A real autopilot's stream and log (ArduSub 4.1) through our codec; pymavlink's readers are the oracle."""

import gzip
import random
from collections import Counter
from math import hypot, pi
from pathlib import Path
from statistics import fmean

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.core.messages import Attitude, Battery, Heartbeat, ImuSample, ServoOutput, StatusText, TimeSync
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.framing import Framer
from tests.drivers.mavlink.mavlink_autopilot import pymavlink_counts, tlog_frames

Frames = list[tuple[int, bytes]]


@pytest.fixture(scope="module")
def tlog(shared_data: Path) -> bytes:
    return gzip.decompress((shared_data / "ardusub" / "small.tlog.gz").read_bytes())


@pytest.fixture(scope="module")
def frames(tlog: bytes) -> Frames:
    return tlog_frames(tlog)


@pytest.fixture(scope="module")
def stream(frames: Frames) -> bytes:
    """The bytes as they were on the wire."""
    return b"".join(frame for _, frame in frames)


def replay(frames: Frames) -> tuple[MavlinkCodec, list]:
    codec = MavlinkCodec(target_system=1)
    return codec, [m for t_us, frame in frames for m in codec.feed(frame, t_us * 1000)]


def test_counts_per_type_equal_pymavlinks(frames: Frames, tlog: bytes, tmp_path: Path):
    path = tmp_path / "small.tlog"
    path.write_bytes(tlog)
    expected = pymavlink_counts(path)
    codec, messages = replay(frames)
    assert codec.framer.bad_data == expected.pop("BAD_DATA") == 4  # a camera's newer message: checksum differs
    assert codec.counters.received == expected
    assert codec.framer.unknown == {}
    kinds = Counter(type(m) for m in messages)
    assert kinds[Attitude] == expected["ATTITUDE"] == 5245
    assert kinds[ImuSample] == expected["RAW_IMU"] == 528
    assert kinds[ServoOutput] == expected["SERVO_OUTPUT_RAW"]
    assert kinds[Battery] == expected["SYS_STATUS"] + expected["BATTERY_STATUS"]
    assert kinds[TimeSync] == expected["TIMESYNC"]
    assert kinds[StatusText] == expected["STATUSTEXT"]
    assert codec.counters.invalid == {}


def test_values_are_si_and_equal_the_fields(frames: Frames, stream: bytes):
    _, messages = replay(frames)
    oracle = dialect.MAVLink(None)
    oracle.robust_parsing = True
    fields, drift = [], 0.0
    for m in oracle.parse_buffer(stream) or []:
        if m.get_type() == "ATTITUDE":
            fields.append((m.roll, m.pitch, m.yaw, m.yawspeed - drift))
        elif m.get_type() == "AHRS":
            drift = m.omegaIz
    attitudes = [m for m in messages if isinstance(m, Attitude)]
    assert [(a.phi_rad, a.theta_rad, a.psi_rad, a.r_rad_s) for a in attitudes] == fields and drift != 0.0
    assert all(-pi <= a.psi_rad <= pi for a in attitudes)
    samples = [m for m in messages if isinstance(m, ImuSample)]
    assert {s.source for s in samples} == {"RAW_IMU"}
    for s in samples:
        assert 9.3 < hypot(s.ax_m_s2, s.ay_m_s2, s.az_m_s2) < 10.4
        assert hypot(s.p_rad_s, s.q_rad_s, s.r_rad_s) < 0.5
    assert fmean(hypot(s.ax_m_s2, s.ay_m_s2, s.az_m_s2) for s in samples) == pytest.approx(9.80665, abs=0.02)
    assert fmean(s.az_m_s2 for s in samples) == pytest.approx(-9.80, abs=0.02)
    assert all(15.4 < m.voltage_v < 16.3 for m in messages if isinstance(m, Battery))
    assert all(len(m.pwm_us) == 16 for m in messages if isinstance(m, ServoOutput))
    beats = [m for m in messages if isinstance(m, Heartbeat)]
    assert {(b.component, b.autopilot) for b in beats} == {(1, 3)}
    assert 255 <= len(beats) <= 270  # 263 s at 1 Hz
    assert any("ArduSub V4.1.1" in m.text for m in messages if isinstance(m, StatusText))


def test_random_chunks_give_the_same(stream: bytes):
    rng = random.Random(1)
    whole, parts = MavlinkCodec(target_system=1), MavlinkCodec(target_system=1)
    expected = whole.feed(stream, 0)
    got, at = [], 0
    while at < len(stream):
        size = rng.choice((1, 7, 64, 300, 4096))
        got += parts.feed(stream[at : at + size], 0)
        at += size
    assert got == expected
    assert parts.counters == whole.counters


@pytest.mark.long
@pytest.mark.parametrize(("start", "flip"), [(0, 0xFF), (137, 0x01), (999, 0x80)])
def test_a_flipped_byte_every_1000_loses_only_the_messages_it_hits(
    frames: Frames, stream: bytes, start: int, flip: int
):
    """pymavlink's parse_buffer loses some 250 neighbours more and makes up unknown messages."""
    good = Counter(bytes(m.get_msgbuf()) for m in Framer().feed(stream, 0))
    broken = bytearray(stream)
    spared: Counter[bytes] = Counter()
    at = hit = 0
    for _, frame in frames:
        first = start + -(-(at - start) // 1000) * 1000 if at > start else start  # the first flip at or after `at`
        if first < at + len(frame):
            hit += 1
        else:
            spared[frame] += 1
        at += len(frame)
    for i in range(start, len(broken), 1000):
        broken[i] ^= flip
    framer = Framer()
    got = Counter(
        bytes(m.get_msgbuf()) for i in range(0, len(broken), 997) for m in framer.feed(bytes(broken[i : i + 997]), 0)
    )
    assert 1222 <= hit <= 1223
    assert got == spared & good  # nothing else is lost, nothing made up


def test_the_log_with_its_stamps_left_in_loses_nothing(tlog: bytes, stream: bytes):
    """35,916 stamps of 8 bytes between the frames are garbage to the wire codec."""
    clean, dirty = Framer(), Framer()
    expected = [bytes(m.get_msgbuf()) for m in clean.feed(stream, 0)]
    assert [bytes(m.get_msgbuf()) for m in dirty.feed(tlog, 0)] == expected
    assert dirty.bad_bytes == clean.bad_bytes + len(tlog) - len(stream)
