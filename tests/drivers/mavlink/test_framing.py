import random
from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mavlink.framing import STALE_NS, Framer
from tests.drivers.mavlink.mavlink_autopilot import Sender

UNKNOWN = bytes([0xFD, 3, 0, 0, 9, 1, 1, 0x39, 0x30, 0, 1, 2, 3, 0xAA, 0xBB])  # id 12345, not in the dialect


def frames(count: int = 40) -> list[bytes]:
    sender, old = Sender(), Sender(v1=True)
    kinds = (sender.beat, sender.att, old.att, sender.imu)
    return [kinds[i % 4]() for i in range(count)]


def names(framer: Framer, data: bytes, t_ns: int = 0) -> list[str]:
    return [m.get_type() for m in framer.feed(data, t_ns)]


def test_versions_1_and_2_in_one_stream():
    framer = Framer()
    assert names(framer, b"".join(frames(4))) == ["HEARTBEAT", "ATTITUDE", "ATTITUDE", "RAW_IMU"]
    assert (framer.bad_data, framer.bad_bytes, framer.unknown) == (0, 0, {})


@settings(deadline=None)
@given(st.lists(st.integers(0, 2000), max_size=60), st.lists(st.integers(0, 1700), max_size=8))
def test_same_messages_for_any_chunks(cuts: list[int], flips: list[int]):
    data = bytearray(b"".join(frames()) + UNKNOWN + frames(1)[0])
    for at in flips:
        data[at % len(data)] ^= 0x55
    whole, parts = Framer(), Framer()
    expected = [bytes(m.get_msgbuf()) for m in whole.feed(bytes(data), 0)]
    edges = [0, *sorted(min(c, len(data)) for c in cuts), len(data)]
    got = [bytes(m.get_msgbuf()) for a, b in pairwise(edges) for m in parts.feed(bytes(data[a:b]), 0)]
    assert got == expected
    assert (parts.bad_data, parts.bad_bytes, parts.unknown) == (
        whole.bad_data,
        whole.bad_bytes,
        whole.unknown,
    )


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 39), st.integers(0, 10_000), st.integers(1, 255))
def test_a_broken_byte_loses_its_own_frame_only(index: int, at: int, flip: int):
    """The tail of good frames is long enough for the longest claim of a broken length byte (280 bytes)."""
    good = frames(80)
    hit = bytearray(good[index])
    hit[at % len(hit)] ^= flip
    got = Framer().feed(b"".join(good[:index]) + bytes(hit) + b"".join(good[index + 1 :]), 0)
    assert [bytes(m.get_msgbuf()) for m in got] == good[:index] + good[index + 1 :]


@settings(deadline=None)
@given(st.lists(st.binary(max_size=400), max_size=10))
def test_never_raises_and_accounts_for_every_byte(chunks: list[bytes]):
    framer = Framer()
    taken = sum(len(m.get_msgbuf()) for chunk in chunks for m in framer.feed(chunk, 0))
    assert taken + framer.bad_bytes <= sum(map(len, chunks))


@settings(deadline=None)
@given(st.lists(st.sampled_from([0xFD, 0xFE, 0x00, 0x01, 0x09, 0xFF]), max_size=700))
def test_never_raises_on_bytes_that_look_like_frames(data: list[int]):
    framer = Framer()
    framer.feed(bytes(data), 0)
    for i in range(1, 700):
        framer.feed(b"", i * (STALE_NS + 1))
    assert framer.bad_bytes == len(data) or framer.unknown


def test_garbage_between_frames_is_counted():
    rng = random.Random(1)
    framer = Framer()
    good = frames(30)
    junk = [bytes(rng.randrange(0xFD) for _ in range(7)) for _ in good]
    got = framer.feed(b"".join(j + f for j, f in zip(junk, good, strict=True)), 0)
    assert len(got) == 30
    assert (framer.bad_bytes, framer.bad_data) == (210, 30)


def test_unknown_id_is_counted_where_its_neighbours_confirm_it():
    framer = Framer()
    one, two = frames(2)
    assert names(framer, one + UNKNOWN + UNKNOWN + two) == ["HEARTBEAT", "ATTITUDE"]
    assert (framer.unknown, framer.bad_bytes) == ({12345: 2}, 0)


def test_unknown_id_with_a_false_length_hides_nothing():
    framer = Framer()
    broken = bytearray(UNKNOWN)
    broken[1] = 40  # reaches into the next frames, which must come through all the same
    assert names(framer, bytes(broken) + b"".join(frames(4))) == [
        "HEARTBEAT",
        "ATTITUDE",
        "ATTITUDE",
        "RAW_IMU",
    ]
    assert framer.unknown == {}


def test_out_of_step_no_unknown_id_is_believed():
    """Behind garbage, bytes that claim to be an unknown frame ending at a marker hide the frame inside it."""
    one, two = frames(2)
    claim = bytes([0xFD, len(one) - 2, 0, 0, 9, 1, 1, 0x39, 0x30, 0])
    framer = Framer()
    assert names(framer, b"\0" + claim + one + two) == ["HEARTBEAT", "ATTITUDE"]
    assert framer.unknown == {}


def test_unknown_incompatible_flag_is_refused():
    framer = Framer()
    strange = bytearray(frames(1)[0])
    strange[2] = 0x02
    assert names(framer, bytes(strange)) == []
    assert framer.bad_data == 1


def test_a_long_claim_blocks_for_half_a_second_at_most():
    framer = Framer()
    one, two, *_ = frames(2)
    broken = bytearray(one)
    broken[1] = 255
    assert names(framer, bytes(broken) + two, 0) == []
    assert names(framer, b"", STALE_NS) == []
    assert names(framer, b"", STALE_NS + 1) == ["ATTITUDE"]


def test_a_slow_frame_is_kept():
    framer = Framer()
    one = frames(1)[0]
    assert names(framer, one[:5], 0) == []
    assert names(framer, one[5:], 10 * STALE_NS) == ["HEARTBEAT"]
