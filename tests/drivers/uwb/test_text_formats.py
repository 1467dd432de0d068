"""What MaUWB, TREK1000, LinkTrack and the DWM1001 leave out, and why. Each case: input -> ranges, reasons."""

import pytest

from companion.core.messages import UwbRanges
from drivers.uwb import CODECS
from drivers.uwb.dwm1001 import AnchorReport, TagFix
from drivers.uwb.dwm1001_tlv import Dwm1001TlvCodec, encode_location
from drivers.uwb.linktrack import LinkTrackCodec, encode_node_frame2
from drivers.uwb.mauwb import MauwbCodec
from drivers.uwb.trek1000 import Trek1000Codec, encode_line

MC8 = "mc 81 00000663" + " 00000000" * 6 + " 000004cb 0001 01 00000001 a0:0"
FAR = "mc 03 ffffff00 00000000 00000000 00000000 0001 01 01 a0:0"
TWICE = "DIST,2,AN0,11AF,0.00,0.00,0.00,1.50,AN1,11AF,0.00,0.00,0.00,1.50"
TURNED = "DIST,2,AN1,11AF,0.00,0.00,0.00,1.50,AN0,11AE,0.00,0.00,0.00,1.50"
MC = "mc {} 00000663 000005a3 00000512 000004cb 095f c1 {} {}"
AT = "AT+RANGE=tid:7,mask:{},seq:1,range:({}){}"
CASES = [
    # TREK1000: mask, clones' short time, eight anchors, other reporters
    ("trek1000", MC.format("05", "24c24", "a0:0"), {"0": 1.635, "2": 1.298}, {}),
    ("trek1000", MC.format("0f", "1", "t12:3"), {"0": 1.635, "1": 1.443, "2": 1.298, "3": 1.227}, {}),
    ("trek1000", MC8, {"0": 1.635, "7": 1.227}, {}),
    ("trek1000", MC.format("0f", "00024c24", "a0"), {}, {"malformed": 1}),
    ("trek1000", FAR, {}, {"range_limit": 1, "zero_range": 1}),
    # MaUWB: mask by slot, mask by anchor, unused slots, unequal lists
    ("mauwb", AT.format("05", "100,200,300,0,0,0,0,0", ""), {"0": 1.0, "2": 3.0}, {}),
    ("mauwb", AT.format("03", "100,200,0", ",ancid:(4,7,-1)"), {"4": 1.0, "7": 2.0}, {}),
    ("mauwb", AT.format("90", "100,200,0", ",ancid:(4,7,-1)"), {"4": 1.0, "7": 2.0}, {}),
    ("mauwb", AT.format("07", "100,200,300", ",ancid:(4,-1,-1)"), {"4": 1.0}, {}),
    ("mauwb", AT.format("07", "100,200,300", ",ancid:(4,5)"), {}, {"list_length": 1}),
    ("mauwb", AT.format("07", "100,200,300", ",ancid:(4,4,5)"), {}, {"duplicate_anchor": 1}),
    ("mauwb", AT.format("01", "100,200", ",rssi:(-70.10,0.00),ancid:(1,2)"), {"1": 1.0}, {}),
    ("mauwb", AT.format("FF", "-5,99999", ""), {}, {"range_limit": 2}),
    ("mauwb", "AT+RANGE=tid:7,mask:01,seq:1,range:(100,20", {}, {"malformed": 1}),
    ("mauwb", '{"id":1,"range":[0,9,10]}', {"2": 0.1}, {"range_limit": 1}),
    ("mauwb", '{"id":1,"range":[0,53.5]}', {}, {"json": 1}),
    ("mauwb", '{"id":1,"range":[1,2,3,4,5,6,7,8,9]}', {}, {"list_length": 1}),
    ("mauwb", AT.format("01", "9" * 400, ""), {}, {"malformed": 1}),
    ("mauwb", '{"id":1,"range":[' + "9" * 400 + "]}", {}, {"json": 1}),
    ("mauwb", "AT+SETCFG OK", {}, {"text": 1}),
    # DWM1001: index is not identity, duplicates, count, no fix, noise of the shell
    ("dwm1001-lec", "DIST,1,AN2,11AF,0.00,0.00,0.00,1.50", {"11AF": 1.5}, {}),
    ("dwm1001-lec", "DIST,2,AN0,11AF,0.00,0.00,0.00,1.50", {}, {"anchor_count": 1}),
    ("dwm1001-lec", TWICE, {}, {"duplicate_anchor": 1}),
    ("dwm1001-lec", TURNED, {}, {"anchor_order": 1}),
    ("dwm1001-lec", "DIST,1,AN0,11AF,0.00,0.00,0.00,1.5", {}, {"malformed": 1}),
    ("dwm1001-lec", "DIST,1,AN0,11AF,0.00,0.00,0.00,0.00", {}, {"zero_range": 1}),
    ("dwm1001-lec", "DIST,1,AN0,11AF,0.00,0.00,0.00,300.01", {}, {"range_limit": 1}),
    ("dwm1001-lec", "DIST,0", {}, {}),
    ("dwm1001-lec", "dwm> DIST,1,AN0,11af,0.00,0.00,0.00,1.50", {"11AF": 1.5}, {}),
    ("dwm1001-lec", "POS,1.00,2.00,3.00,0", {}, {"no_fix": 1}),
    ("dwm1001-lec", "POS,1.00,2.00,3.00,101", {}, {"quality": 1}),
    ("dwm1001-lec", " DWM1001 TWR Real Time Location System", {}, {"shell_text": 1}),
    ("dwm1001-lec", "dwm> aurs 10 10", {}, {"shell_text": 1}),
    ("dwm1001-lec", "11AF[0.00,0.00,0.00]=1.50", {"11AF": 1.5}, {}),
    ("dwm1001-lec", "11AF[0.00,0.00,0.00]=1.50 11AE[0.00,0.00", {}, {"malformed": 1}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "line", "ranges", "reasons"), CASES)
def test_line(name, line, ranges, reasons):
    codec = CODECS[name](tag="t")
    messages = codec.feed(line.encode() + b"\r\n", 0)
    assert {r.anchor: r.range_m for m in messages if isinstance(m, UwbRanges) for r in m.ranges} == ranges
    assert dict(codec.counters.reasons) == reasons
    assert codec.counters.lines == codec.counters.good + codec.counters.ignored + codec.counters.garbage == 1


@pytest.mark.parametrize(
    ("codec", "own", "other"),
    [
        (MauwbCodec(tag="t", tid=7), AT.format("01", "100", ""), '{"id":1,"range":[100]}'),
        (
            Trek1000Codec(tag="t", tag_number=7),
            MC.format("01", "01", "a7:0"),
            MC.format("01", "01", "a1:0"),
        ),
    ],
)
def test_a_port_that_reports_every_tag_is_filtered(codec, own, other):
    assert codec.feed(f"{other}\n".encode(), 0) == []
    assert len(codec.feed(f"{own}\n{other}\n".encode(), 0)) == 1
    assert codec.counters.reasons == {"other_tag": 2}


def test_trek_raw_lines_count_only_while_there_are_no_corrected_ones():
    codec = Trek1000Codec(tag="t")
    raw = encode_line("mr", [2.0, None, None, None], number=1, seq=1, time=1)
    corrected = encode_line("mc", [1.9, None, None, None], number=1, seq=1, time=1)
    between = encode_line("ma", [3.0, None, None, None], number=1, seq=1, time=1)
    ranges = [m.ranges[0].range_m for m in codec.feed(raw + corrected + raw + between + corrected, 0)]
    assert ranges == [2.0, 1.9, 1.9]
    assert codec.counters.reasons == {"raw_beside_corrected": 1, "anchor_to_anchor": 1}
    assert codec.start_bytes() == []
    assert len(codec.feed(raw, 0)) == 1


def test_mauwb_line_cut_before_its_anchor_ids_is_not_read_by_slot():
    codec = MauwbCodec(tag="t")
    codec.feed(AT.format("01", "100", ",ancid:(5)").encode() + b"\n", 0)
    assert codec.feed(AT.format("01", "100", "").encode() + b"\n", 0) == []
    assert codec.counters.reasons == {"ancid_missing": 1}


def test_linktrack_leaves_out_invalid_fields_and_other_tags():
    codec = LinkTrackCodec(tag="t")
    frame = bytearray(encode_node_frame2(1, 5, {3: 2.5, 4: -8388.0, 5: 3.5}, None))
    frame[119 + 26] = 2  # role of the third node: a tag
    frame[-1] = (frame[-1] + 1) & 0xFF
    (message,) = codec.feed(bytes(frame), 0)
    assert [(r.anchor, r.range_m) for r in message.ranges] == [("3", 2.5)]
    assert codec.counters.reasons == {"invalid_range": 1, "other_tag": 1, "no_fix": 1}


def test_tlv_polls_at_its_rate_even_when_called_late_and_drops_half_answers():
    codec = Dwm1001TlvCodec(tag="t", rate_hz=4.0)
    sent = [t for t in range(0, 2000, 10) if codec.step(t * 1_000_000) == [b"\x0c\x00"]]
    assert sent == list(range(0, 2000, 250))
    assert codec.step(60_000_000_000) == [b"\x0c\x00"]
    assert codec.step(60_100_000_000) == []
    answer = encode_location([AnchorReport("1151", (0.0, 0.0, 0.0), 6.44)], TagFix((1.0, 2.0, 3.0), 90))
    codec.feed(answer[:20], 0)
    codec.step(61_000_000_000)
    assert len(codec.feed(answer, 0)) == 2
    assert codec.counters.reasons == {"truncated": 20}


def test_tlv_refusals_and_repeated_answers_are_counted():
    codec = Dwm1001TlvCodec(tag="t")
    answer = encode_location([AnchorReport("1151", (0.0, 0.0, 0.0), 6.44)], None)
    assert len(codec.feed(b"\x40\x01\x01" + answer + answer, 0)) == 1
    assert codec.counters.reasons == {"refused": 3, "no_fix": 1, "repeated": 1}


def test_tlv_a_lost_byte_anywhere_gives_no_false_range():
    anchors = [AnchorReport(f"{0x1151 + i:04X}", (1.0, 2.0, 3.0), r) for i, r in enumerate((6.44, 7.5, 8.25, 3.19))]
    answer = encode_location(anchors, TagFix((1.0, 2.0, 3.0), 90))
    later = encode_location([a._replace(range_m=9.0) for a in anchors], None)
    true = {(a.anchor, a.range_m) for a in anchors} | {(a.anchor, 9.0) for a in anchors}
    for lost in range(len(answer)):
        codec = Dwm1001TlvCodec(tag="t")
        messages = codec.feed(answer[:lost] + answer[lost + 1 :] + later, 0)
        found = {(r.anchor, r.range_m) for m in messages if isinstance(m, UwbRanges) for r in m.ranges}
        assert found <= true, lost
        in_a_row = (lost - 21) % 20 if lost >= 21 else None  # 21 bytes before the anchors, 20 each
        if in_a_row is not None and in_a_row < 6:  # address and range: seen at once, the next answer survives
            assert found == {(a.anchor, 9.0) for a in anchors}, lost


@pytest.mark.parametrize(("name", "rate_hz"), [("dwm1001-lec", 20.0), ("dwm1001-tlv", 0.0)])
def test_impossible_rate_is_refused(name, rate_hz):
    with pytest.raises(ValueError, match="rate_hz"):
        CODECS[name](tag="t", rate_hz=rate_hz)
