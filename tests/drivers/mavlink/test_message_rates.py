"""Streams by themselves: what is asked for again, and when."""

import pytest

from drivers.mavlink.streams import WINDOW_NS, Request, Streams


@pytest.mark.parametrize("wanted_hz", [0.4, 0.5, 2.0])
def test_a_slow_stream_that_never_comes_is_asked_for_again_and_named(wanted_hz):
    streams = Streams({"GPS_RAW_INT": wanted_hz})
    assert streams.step(lambda _: 0, 0)[0] == [Request("GPS_RAW_INT", wanted_hz)]
    assert streams.step(lambda _: 0, WINDOW_NS)[0] == [Request("GPS_RAW_INT", wanted_hz)]
    assert "comes at 0.0 Hz" in streams.step(lambda _: 0, 3 * WINDOW_NS)[1][0]


def test_one_that_comes_is_left_alone():
    streams = Streams({"GPS_RAW_INT": 0.4})
    for k in range(10):
        requests, warnings = streams.step(lambda _, k=k: int(0.4 * 3 * k), k * WINDOW_NS)
        assert (requests == []) == (k > 0) and warnings == []
