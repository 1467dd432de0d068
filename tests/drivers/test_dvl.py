"""Reports of a Water Linked DVL: a line as its documentation has it, ages, lost bottom, and any bytes."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.messages.sensors import DvlVelocity
from drivers.dvl import DvlCodec, encode_report

LINE = (
    b'{"time":106.39,"vx":-0.37,"vy":0.55,"vz":0.01,"fom":0.0016,"covariance":[[1e-6,0,0],[0,1e-6,0],[0,0,1e-6]],'
    b'"altitude":0.4949,"transducers":[{"id":0,"velocity":0.01,"distance":0.5,"rssi":-30,"nsd":-88,"beam_valid":true}],'
    b'"velocity_valid":true,"status":0,"format":"json_v3.1","type":"velocity","time_of_validity":1638191471563017,'
    b'"time_of_transmission":1638191471752336}\r\n'
)
T = 5_000_000_000


def one(line: bytes) -> DvlVelocity:
    (message,) = DvlCodec().feed(line, T)
    assert isinstance(message, DvlVelocity)
    return message


def test_a_report_with_its_own_age():
    m = one(LINE)
    assert (m.x_m_s, m.y_m_s, m.valid, m.altitude_m, m.fom_m_s) == (-0.37, 0.55, True, 0.4949, 0.0016)
    assert (m.t_rx_ns, m.t_ns) == (T, T - 189_319_000)


def test_an_age_that_cannot_be_counts_as_of_the_arrival():
    assert one(LINE.replace(b"1638191471752336", b"1638191471563016")).t_ns == T
    assert one(LINE.replace(b"1638191471752336", b"1638191473563017")).t_ns == T


def test_lost_bottom_is_told_and_other_reports_are_ignored():
    assert not one(LINE.replace(b'"velocity_valid":true', b'"velocity_valid":false')).valid
    codec = DvlCodec()
    assert codec.feed(b'{"type":"position_local","x":1.0}\r\n{"vx":1}\n{"type":"velocity","vx":1e400}\n', T) == []
    assert codec.counters == {"ignored": 1, "garbage": 2}


@pytest.mark.parametrize("value", [b"null", b'"a"', b"[]", b"true", b"9" * 400])
def test_a_speed_that_is_no_number_is_a_lost_bottom_and_no_garbage(value):
    for old in (b"-0.37", b"0.55"):
        m = one(LINE.replace(old, value))
        assert not m.valid and {m.x_m_s, m.y_m_s} <= {-0.37, 0.55, 0.0}
    m = one(LINE.replace(b"0.4949", value).replace(b"0.0016", value).replace(b"1638191471752336", value))
    assert (m.x_m_s, m.valid, m.altitude_m, m.fom_m_s, m.t_ns) == (-0.37, True, None, None, T)


def test_no_wrong_bit_raises_or_spoils_more_than_one_report():
    """msgspec has an error of its own for a text that is none."""
    for bit in range(8 * len(LINE.rstrip())):
        wrong = bytearray(LINE)
        wrong[bit // 8] ^= 1 << bit % 8
        assert one(LINE) in DvlCodec().feed(bytes(wrong) + LINE, T)


@given(st.floats(-10, 10), st.floats(-10, 10), st.booleans(), st.integers(0, 10**6))
def test_what_is_encoded_comes_back(x, y, valid, age_us):
    sent = DvlVelocity(t_ns=T - 1000 * age_us, t_rx_ns=T, x_m_s=x, y_m_s=y, valid=valid, altitude_m=2.0, fom_m_s=0.01)
    assert one(encode_report(sent)) == sent


@given(st.binary(max_size=200), st.integers(1, 60))
def test_no_bytes_raise_and_chunks_do_not_matter(noise, size):
    whole, parts = DvlCodec(), DvlCodec()
    data = noise + b"\n" + LINE
    chunks = [data[i : i + size] for i in range(0, len(data), size)]
    assert whole.feed(data, T) == [m for chunk in chunks for m in parts.feed(chunk, T)]
    assert msgspec.structs.replace(one(LINE)) in whole.feed(LINE, T)
