"""Lines as real tags print them. Source: public parsers' code and comments; the LinkTrack frame and the TLV
answer are synthesised to the documented layout."""

import pytest

from companion.core.messages import UwbPosition, UwbRanges
from drivers.uwb.dwm1001 import Dwm1001Codec
from drivers.uwb.dwm1001_tlv import Dwm1001TlvCodec
from drivers.uwb.linktrack import LinkTrackCodec
from drivers.uwb.makerfabs import MakerfabsCodec
from drivers.uwb.mauwb import MauwbCodec
from drivers.uwb.trek1000 import Trek1000Codec

LEC4 = (
    b"DIST,4,AN0,1151,5.00,8.00,2.25,6.44,AN1,0CA8,0.00,8.00,2.25,6.50,AN2,111C,5.00,0.00,2.25,3.24,"
    b"AN3,1150,0.00,0.00,2.25,3.19,POS,2.55,2.01,1.71,98"
)
LEC3 = (
    b"DIST,3,AN0,2F2F,3.05,2.68,0.00,2.20,AN1,2ED0,3.02,0.00,0.00,2.23,AN2,2BA2,0.00,0.00,0.00,3.13,"
    b"POS,1.76,1.59,0.51,40"
)
LEC_DAMAGED = (
    b"DIST,4,AN0,0090,0.00,0.00,0.00,3.25,AN1,D91E,0.00,0.00,0.00,3.33,AN2,0487,0.00,0.00,0.00,0.18,"
    b"AN3,15BA,0.00,0,AN3,15BA,0.00,0.00,0.00,0.00"
)
LES = (
    b"1151[5.00,8.00,2.25]=6.48 0CA8[0.00,8.00,2.25]=6.51 111C[5.00,0.00,2.25]=3.18 "
    b"1150[0.00,0.00,2.25]=3.16 le_us=2576 est[2.57,1.98,1.68,100]"
)
MAUWB_ANCID = b"AT+RANGE=tid:7,mask:0F,seq:128,range:(997,1321,911,738,0,0,0,0),ancid:(0,1,2,3,-1,-1,-1,-1)"
MAUWB_RSSI = b"AT+RANGE=tid:1,mask:04,seq:63,range:(0,0,30,0,0,0,0,0),rssi:(0.00,0.00,-77.93,0.00,0.00,0.00,0.00,0.00)"
MAUWB_DEMO = b'{"id":1,"range":[0,53,423,0,0,0,0,0]}'
LINKS = b'{"links":[{"A":"1782","R":"1.0"},{"A":"1783","R":"0.9"}]}'
DEBUG = b"from: 1782\t Range: 1.02 m\t RX power: -72.1 dBm"
TREK_MR = b"mr 0f 000005a4 000004c8 00000436 000003f9 0958 c0 40424042 a0:0"
TREK_MA = b"ma 07 00000000 0000085c 00000659 000006b7 095b 26 00024bed a0:0"
TREK_MC = b"mc 0f 00000663 000005a3 00000512 000004cb 095f c1 00024c24 a0:0"
NODE_FRAME1 = bytes.fromhex(
    "550344000300e880000000860000015101e801f202029209481302"
    "02005f0b008609009bffffc9378a3406ee373faa0202930900450900c4fcff8d0900660900c4fcff8e"
)
NODE_FRAME2 = bytes.fromhex(
    "5504ac00020140e20100030419380600da07005e0100000000000000000000000000000000000000000000000000"
    "0000000000000000000000000000cdcc1c410000000000000000000000000000000000000000803f0000000000000000"
    "000000000000000040e201000000000000000000000056130401001e0a00a19f40e20100000001018c0f00a2a040e201"
    "0000000102a61300a6a240e2010000000103540b009e9d40e20100000084"
)
TLV = bytes.fromhex(
    "400100410df6090000da070000ae060000624951045111281900006488130000401f0000ca08000064a80c64190000"
    "6400000000401f0000ca080000641c11a80c0000648813000000000000ca080000645011760c000064000000000000"
    "0000ca08000064"
)

XYZQ = tuple[float, float, float, int | None]
CASES = [
    (Dwm1001Codec, LEC4, {"1151": 6.44, "0CA8": 6.50, "111C": 3.24, "1150": 3.19}, (2.55, 2.01, 1.71, 98)),
    (Dwm1001Codec, LEC3, {"2F2F": 2.20, "2ED0": 2.23, "2BA2": 3.13}, (1.76, 1.59, 0.51, 40)),
    (Dwm1001Codec, b"POS,2.57,2.00,1.67,97", None, (2.57, 2.00, 1.67, 97)),
    (Dwm1001Codec, LES, {"1151": 6.48, "0CA8": 6.51, "111C": 3.18, "1150": 3.16}, (2.57, 1.98, 1.68, 100)),
    (MauwbCodec, MAUWB_ANCID, {"0": 9.97, "1": 13.21, "2": 9.11, "3": 7.38}, None),
    (MauwbCodec, MAUWB_RSSI, {"2": 0.30}, None),
    (MauwbCodec, MAUWB_DEMO, {"1": 0.53, "2": 4.23}, None),
    (MakerfabsCodec, LINKS, {"1782": 1.0, "1783": 0.9}, None),
    (MakerfabsCodec, DEBUG + b"\n" + LINKS, {"1782": 1.02}, None),
    (Trek1000Codec, TREK_MR, {"0": 1.444, "1": 1.224, "2": 1.078, "3": 1.017}, None),
    (Trek1000Codec, TREK_MA, None, None),
    (Trek1000Codec, TREK_MC, {"0": 1.635, "1": 1.443, "2": 1.298, "3": 1.227}, None),
    (LinkTrackCodec, NODE_FRAME2, {"0": 2.59, "1": 3.98, "2": 5.03, "3": 2.9}, (1.592, 2.010, 0.350, None)),
    (Dwm1001TlvCodec, TLV, {"1151": 6.44, "0CA8": 6.5, "111C": 3.24, "1150": 3.19}, (2.55, 2.01, 1.71, 98)),
]  # fmt: skip


@pytest.mark.parametrize(("make", "record", "ranges", "position"), CASES)
def test_sample_decodes(make, record: bytes, ranges: dict[str, float] | None, position: XYZQ | None):
    codec = make(tag="t")
    messages = codec.feed(record + b"\r\n" * (make not in (LinkTrackCodec, Dwm1001TlvCodec)), 42)
    found = [m for m in messages if isinstance(m, UwbRanges)]
    places = [m for m in messages if isinstance(m, UwbPosition)]
    assert [{r.anchor: r.range_m for r in m.ranges} for m in found] == ([] if ranges is None else [ranges])
    assert [(m.x_m, m.y_m, m.z_m, m.quality) for m in places] == ([] if position is None else [position])
    assert all((m.t_ns, m.t_rx_ns, m.tag) == (42, 42, "t") for m in found + places)
    assert codec.counters.garbage == 0


def test_the_really_damaged_line_gives_no_range_at_all():
    codec = Dwm1001Codec(tag="t")
    assert codec.feed(LEC_DAMAGED + b"\r\n", 0) == []
    assert codec.counters.garbage == 1
    assert codec.counters.reasons == {"malformed": 1}
    assert len(codec.feed(LEC4 + b"\r\n", 1)) == 2


def test_signal_power_and_quality_are_kept():
    (rssi,) = MauwbCodec(tag="t").feed(MAUWB_RSSI + b"\n", 0)
    assert rssi.ranges[0].rssi_dbm == -77.93
    (debug,) = MakerfabsCodec(tag="t").feed(DEBUG + b"\n" + LINKS + b"\n", 0)
    assert debug.ranges[0].rssi_dbm == -72.1
    link, _ = LinkTrackCodec(tag="t").feed(NODE_FRAME2, 0)
    assert [r.rssi_dbm for r in link.ranges] == [-79.5, -80.0, -81.0, -78.5]
    tlv, _ = Dwm1001TlvCodec(tag="t").feed(TLV, 0)
    assert [r.quality for r in tlv.ranges] == [100] * 4


def test_another_linktrack_frame_is_skipped_and_the_next_one_found():
    codec = LinkTrackCodec(tag="t")
    assert len(codec.feed(NODE_FRAME1 + NODE_FRAME2, 0)) == 2
    assert codec.counters.garbage == len(NODE_FRAME1)
