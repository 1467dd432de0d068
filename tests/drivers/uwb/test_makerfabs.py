"""Makerfabs: debug lines before the JSON, groups in time, links that went stale."""

from companion.core.messages import UwbRanges
from drivers.uwb.makerfabs import GROUP_NS, MakerfabsCodec, encode_debug, encode_links

MS = 1_000_000


def found(messages):
    assert all(isinstance(m, UwbRanges) for m in messages)
    return [(m.t_ns, {r.anchor: r.range_m for r in m.ranges}) for m in messages]


def test_json_ends_the_cycle_and_a_silent_anchor_stays_out():
    codec = MakerfabsCodec(tag="t")
    codec.feed(encode_debug("1782", 1.02, -72.1) + encode_debug("1783", 0.93, -73.0), 10)
    assert found(codec.feed(encode_links({"1782": 1.0, "1783": 0.9}), 20)) == [(10, {"1782": 1.02, "1783": 0.93})]
    codec.feed(encode_debug("1782", 1.52, -72.1), 30)
    assert found(codec.feed(encode_links({"1782": 1.5, "1783": 0.9}), 40)) == [(30, {"1782": 1.52})]
    assert codec.feed(encode_links({"1782": 1.5, "1783": 0.9}), 50) == []


def test_ranges_keep_their_own_times_when_the_tag_ranges_faster_than_the_json_comes():
    codec = MakerfabsCodec(tag="t")
    messages = []
    for i in range(5):
        messages += codec.feed(encode_debug("82", 1.0 + i, -70.0), i * 200 * MS)
        messages += codec.feed(encode_debug("83", 2.0 + i, -70.0), i * 200 * MS + 20 * MS)
    messages += codec.feed(encode_links({"82": 5.0, "83": 6.0}), 1000 * MS)
    assert found(messages) == [(i * 200 * MS + 20 * MS, {"82": 1.0 + i, "83": 2.0 + i}) for i in range(5)]


def test_a_late_line_begins_a_new_group():
    codec = MakerfabsCodec(tag="t")
    codec.feed(encode_debug("82", 1.0, -70.0), 0)
    assert found(codec.feed(encode_debug("83", 2.0, -70.0), GROUP_NS + 1)) == [(0, {"82": 1.0})]


def test_without_debug_lines_a_dead_link_is_left_out_once_another_has_moved_and_comes_back_when_it_changes():
    codec = MakerfabsCodec(tag="t")
    heard = [found(codec.feed(encode_links({"A1": 5.0 + 0.2 * k, "A2": 7.0}), k))[0][1] for k in range(20)]
    with_dead = [k for k, ranges in enumerate(heard) if "A2" in ranges]
    assert with_dead == list(range(8))
    assert all("A1" in ranges for ranges in heard)
    assert codec.counters.reasons["stale_link"] == 12
    assert found(codec.feed(encode_links({"A1": 9.0, "A2": 7.1}), 20)) == [(20, {"A1": 9.0, "A2": 7.1})]


def test_a_resting_boat_keeps_all_its_links():
    codec = MakerfabsCodec(tag="t")
    for k in range(100):
        ranges = {"A1": 5.0 + 0.1 * (k % 2), "A2": 7.0, "A3": 11.3}
        assert found(codec.feed(encode_links(ranges), k)) == [(k, ranges)]


def test_a_passed_anchor_is_not_taken_for_a_dead_one():
    """0.5 m/s past an anchor 15 m abeam, one along the track; the case that the numbers are chosen for."""
    codec = MakerfabsCodec(tag="t")
    for k in range(-30, 31):
        abeam, ahead = (15.0**2 + (0.5 * k) ** 2) ** 0.5, 40.0 - 0.5 * k
        (message,) = codec.feed(encode_links({"AB": abeam, "C": ahead}), k)
        assert len(message.ranges) == 2, k


def test_infinite_power_and_negative_ranges_do_not_break_the_line():
    codec = MakerfabsCodec(tag="t")
    codec.feed(b"from: 82\t Range: 1.00 m\t RX power: -inf dBm\nfrom: 83\t Range: -0.02 m\t RX power: nan dBm\n", 0)
    ((_, ranges),) = found(codec.feed(encode_links({}), 0))
    assert ranges == {"82": 1.0}
    assert codec.counters.reasons == {"range_limit": 1}
    codec = MakerfabsCodec(tag="t")
    assert found(codec.feed(encode_links({"82": 1.0, "83": -0.1, "84": 2.5}), 0)) == [(0, {"82": 1.0, "84": 2.5})]
    assert codec.counters.reasons == {"range_limit": 1}


def test_other_text_is_ignored_and_half_lines_are_garbage():
    codec = MakerfabsCodec(tag="t")
    codec.feed(b'ranging init; 1 device added ! -> short:1782\nRange: 1.02 m\n{"links":[{"A":"1\n', 0)
    assert (codec.counters.ignored, codec.counters.garbage) == (1, 2)
