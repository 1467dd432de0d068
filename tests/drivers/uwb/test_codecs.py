"""What must hold for every UWB codec, whatever arrives on the wire.

Corruption: the text formats and the TLV API carry no checksum, so one wrong byte may turn a digit of a range
or of an anchor's ID into another one, or cut a record. It must never do more: at most one anchor's entry
may differ from what was sent, and in only one of its two parts. LinkTrack has a checksum: nothing may differ.
"""

import itertools
from collections.abc import Callable

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.core.messages import Message, UwbPosition, UwbRanges
from drivers.uwb import CODECS
from drivers.uwb.dwm1001 import AnchorReport, TagFix, encode_lec, encode_lep, encode_les
from drivers.uwb.dwm1001_tlv import encode_location
from drivers.uwb.linktrack import encode_node_frame2
from drivers.uwb.makerfabs import encode_debug, encode_links
from drivers.uwb.mauwb import encode_at, encode_demo
from drivers.uwb.trek1000 import encode_line

Ranges = dict[int, float]
Xyz = tuple[float, float, float]
RANGES_M = st.dictionaries(st.integers(0, 7), st.floats(0.1, 250.0), min_size=1, max_size=4)
METRES = st.floats(-200.0, 200.0)
FIXES = st.none() | st.tuples(METRES, METRES, METRES)


def reports(ranges_m: Ranges) -> list[AnchorReport]:
    return [AnchorReport(f"{0x1780 + i:04X}", (1.0 * i, -2.5, 2.25), r) for i, r in ranges_m.items()]


def fix(xyz: Xyz | None) -> TagFix | None:
    return None if xyz is None else TagFix(xyz, 97)


def les(ranges_m: Ranges, xyz: Xyz | None) -> bytes:
    return encode_les(reports(ranges_m), fix(xyz))


def debug(ranges_m: Ranges, _xyz: Xyz | None) -> bytes:
    lines = [encode_debug(f"{0x1780 + i:X}", r, -72.1) for i, r in ranges_m.items()]
    return b"".join(lines) + encode_links({f"{0x1780 + i:X}": r for i, r in ranges_m.items()})


def trek(ranges_m: Ranges, _xyz: Xyz | None) -> bytes:
    return encode_line("mc", [ranges_m.get(i) for i in range(8)], number=0x95F, seq=0xC1, time=0x24C24)


# name -> (codec, encoder of one cycle, resolution of a range [m], ID of anchor i, carries a position)
FORMATS: dict[str, tuple[str, Callable[[Ranges, Xyz | None], bytes], float, str, bool]] = {
    "lec": ("dwm1001-lec", lambda r, p: encode_lec(reports(r), fix(p)), 0.01, "17{:02X}", True),
    "les": ("dwm1001-les", les, 0.01, "17{:02X}", True),
    "tlv": ("dwm1001-tlv", lambda r, p: encode_location(reports(r), fix(p)), 0.001, "17{:02X}", True),
    "links": (
        "makerfabs",
        lambda r, p: encode_links({f"17{0x80 + i:X}": v for i, v in r.items()}),
        0.1,
        "17{:02X}",
        False,
    ),
    "debug": ("makerfabs", debug, 0.01, "17{:02X}", False),
    "ancid": ("mauwb", lambda r, p: encode_at(7, 300, r), 0.01, "{}", False),
    "rssi": (
        "mauwb",
        lambda r, p: encode_at(7, 0, r, rssi_dbm=dict.fromkeys(r, -77.9), ancid=False),
        0.01,
        "{}",
        False,
    ),
    "demo": ("mauwb", lambda r, p: encode_demo(7, r), 0.01, "{}", False),
    "trek": ("trek1000", trek, 0.001, "{}", False),
    "linktrack": ("linktrack", lambda r, p: encode_node_frame2(1, 123456, r, p), 0.001, "{}", True),
}
each_format = pytest.mark.parametrize("name", FORMATS)


def parts(messages: list[Message]) -> tuple[list[tuple[str, float]], list[Xyz]]:
    ranges = [(r.anchor, r.range_m) for m in messages if isinstance(m, UwbRanges) for r in m.ranges]
    return ranges, [(m.x_m, m.y_m, m.z_m) for m in messages if isinstance(m, UwbPosition)]


def key(name: str, i: int) -> str:
    pattern = FORMATS[name][3]
    return pattern.format(i if pattern == "{}" else 0x80 + i)


@each_format
@given(ranges_m=RANGES_M, xyz=FIXES)
@settings(max_examples=40)
def test_round_trip_within_the_resolution(name, ranges_m, xyz):
    codec_name, encode, resolution_m, _, carries_position = FORMATS[name]
    codec = CODECS[codec_name](tag="boat")
    ranges, positions = parts(codec.feed(encode(ranges_m, xyz), 5))
    assert dict(ranges) == pytest.approx({key(name, i): r for i, r in ranges_m.items()}, abs=resolution_m / 2 + 1e-9)
    expected = [xyz] if xyz is not None and carries_position else []
    assert len(positions) == len(expected)
    for found, true in zip(positions, expected, strict=True):
        assert found == pytest.approx(true, abs=resolution_m / 2 + 1e-9)
    assert codec.counters.garbage == 0


@given(METRES, METRES, METRES, st.integers(1, 100))
def test_round_trip_of_lep(x, y, z, quality):
    (found,) = CODECS["dwm1001-lep"](tag="boat").feed(encode_lep(TagFix((x, y, z), quality)), 0)
    assert isinstance(found, UwbPosition)
    assert (found.x_m, found.y_m, found.z_m) == pytest.approx((x, y, z), abs=0.005001)
    assert found.quality == quality


LIKELY = st.sampled_from(
    [
        b"DIST,", b"POS,1.00,", b"AN0,1151,", b"\r\n", b"dwm> ", b"@\x01\x01", b"\x40\x01\x00\x41\x0d",
        b"I\x15\x01", b"\x55\x04", b"\x55\x04\xac\x00", b'{"links":[', b'{"A":"1","R":"1.0"}', b"]}\n",
        b"AT+RANGE=tid:1,", b"from: 1782\t Range: ", b"mc 0f ", b"0000085c ", b"a0:0\r\n", b"\xff\x00",
        b'{"id":1,"range":[9]}\n',
    ]
)  # fmt: skip
NOISE = st.lists(st.binary(max_size=40) | LIKELY, max_size=25).map(b"".join)


@pytest.mark.parametrize("codec_name", CODECS)
@given(data=NOISE)
@settings(max_examples=50)
def test_arbitrary_bytes_never_raise(codec_name, data):
    codec = CODECS[codec_name](tag="boat")
    codec.feed(data, 0)
    for t_ns in range(0, 20_000_000_000, 700_000_000):
        codec.step(t_ns)
        codec.feed(data, t_ns)


@each_format
@given(data=st.data())
@settings(max_examples=40)
def test_any_chunking_gives_the_same_messages_and_counts(name, data):
    codec_name, encode, *_ = FORMATS[name]
    records = st.builds(encode, RANGES_M, FIXES)
    stream = b"".join(data.draw(st.lists(records | NOISE, min_size=1, max_size=5)))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    whole, cut = CODECS[codec_name](tag="boat"), CODECS[codec_name](tag="boat")
    expected = whole.feed(stream, 9)
    edges = [0, *cuts, len(stream)]
    found = [m for a, b in itertools.pairwise(edges) for m in cut.feed(stream[a:b], 9)]
    assert found == expected
    assert cut.counters == whole.counters


@each_format
@given(ranges_m=RANGES_M, xyz=FIXES, at=st.floats(0.0, 1.0, exclude_max=True), byte=st.integers(0, 255))
@settings(max_examples=120)
def test_one_wrong_byte_spoils_no_more_than_the_format_must_suffer(name, ranges_m, xyz, at, byte):
    codec_name, encode, *_ = FORMATS[name]
    codec = CODECS[codec_name](tag="boat")
    habits = encode({0: 1.5}, None)  # a codec learns a firmware's habits from its first good record
    codec.feed(habits, 0)
    sent = encode(ranges_m, xyz)
    assume(sent != habits)
    truth = set(parts(CODECS[codec_name](tag="boat").feed(sent, 0))[0])
    damaged = bytearray(sent)
    assume(damaged[int(at * len(sent))] != byte)
    damaged[int(at * len(sent))] = byte
    good = encode({1: 7.5}, None)
    messages = codec.feed(bytes(damaged), 1)
    codec.step(10**10)
    ranges, _ = parts(messages + codec.feed(b"\r\n" + good, 2))
    last = set(parts(CODECS[codec_name](tag="boat").feed(good, 0))[0])
    wrong = set(ranges) - truth - last
    assert len(wrong) <= (0 if name == "linktrack" else 1)
    for anchor, range_m in wrong:
        assert any(anchor == a or range_m == r for a, r in truth)


@each_format
def test_the_next_record_survives_a_cut_one(name):
    codec_name, encode, *_ = FORMATS[name]
    record, following = (
        encode({0: 2.5, 3: 11.25}, (1.0, 2.0, 3.0)),
        encode({0: 2.6, 3: 11.5}, (1.0, 2.0, 3.0)),
    )
    for cut in range(1, len(record)):
        codec = CODECS[codec_name](tag="boat")
        codec.step(0)
        codec.feed(record[:cut], 0)
        codec.step(1_000_000_000)  # a polled format is polled here and discards the rest
        codec.feed(b"\n" if codec_name != "linktrack" else b"", 1)
        codec.feed(following + following, 2)
        ranges, _ = parts(codec.feed(encode({0: 2.7, 3: 11.75}, (1.0, 2.0, 3.0)), 3))
        assert len(ranges) == 2, cut


@pytest.mark.parametrize("codec_name", CODECS)
def test_memory_stays_bounded(codec_name):
    codec = CODECS[codec_name](tag="boat")
    for chunk in (b"A" * 4096, b"\x55\x04" * 2048, b"\x40\x01\x00\x41\x0d" * 800, b"\x55" * 4096):
        for _ in range(50):
            codec.feed(chunk, 0)
        held = [v for v in vars(codec).values() if isinstance(v, bytearray)]
        held += [v.tail for v in vars(codec).values() if hasattr(v, "tail")]
        assert held
        assert all(len(v) <= 1024 for v in held)
    assert codec.counters.garbage > 0


@pytest.mark.parametrize("codec_name", CODECS)
def test_start_bytes_forgets_half_a_record_and_sends_nothing(codec_name):
    name = next(n for n, row in FORMATS.items() if row[0] == codec_name.replace("-lep", "-lec"))
    record = FORMATS[name][1]({0: 2.5}, None)
    codec = CODECS[codec_name](tag="boat")
    codec.feed(record[:-5], 0)
    assert codec.start_bytes() == []
    assert len(codec.feed(record, 0)) == 1
    assert codec.counters.garbage == 0
