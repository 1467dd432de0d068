"""Kinds of values: what is in range comes through as it is, all else is refused with the range."""

import argparse

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.cli.options.parser import Parser
from companion.cli.options.values import Each, address, angle_deg, number, port, seed, share, whole

BOUNDS = st.floats(-1e12, 1e12)


def refusal(kind, text: str) -> str:
    with pytest.raises(argparse.ArgumentTypeError) as refused:
        kind(text)
    return str(refused.value)


@given(BOUNDS, BOUNDS, st.floats())
def test_a_number_is_in_its_range_or_refused_with_it(a, b, value):
    low, high = min(a, b), max(a, b)
    kind = number(low, high, "a draught [m]")
    if low <= value <= high:
        assert kind(str(value)) == value
    else:
        assert f"expected a draught [m], {low:g} to {high:g}" in refusal(kind, str(value))


@given(st.text(max_size=12))
def test_no_text_ends_in_another_error(text):
    for kind in (number(0, 1), whole(0, 9), seed, port, share, address):
        try:
            kind(text)
        except argparse.ArgumentTypeError as error:
            assert repr(text) in str(error) and "expected" in str(error)


@pytest.mark.parametrize("text", ["-1", "1.0", "1e2", "", " 1", "²", "9" * 5000, "4294967296", "nan"])
def test_a_seed_is_a_whole_number_that_every_generator_takes(text):
    assert "expected a seed" in refusal(seed, text)


@pytest.mark.parametrize("text", ["localhost", "h:", ":1", "h:0", "h:65536", "h:-1", "h:udp"])
def test_an_address_has_a_host_and_a_port(text):
    assert "expected HOST:PORT" in refusal(address, text)
    assert address("fe80::1:14550") == ("fe80::1", 14550)


def test_each_value_of_an_option_has_a_kind_of_its_own(capsys):
    p = Parser(prog="x")
    p.add_argument("--wind", action=Each, kinds=(number(0, 60, "a wind [m/s]"), angle_deg), metavar=("M/S", "DEG"))
    assert p.parse_args(["--wind", "3", "-1e-5"]).wind == (3.0, -1e-5)
    for words, told in (
        (["-3", "0"], "--wind: '-3': expected a wind [m/s], 0 to 60"),
        (["3", "-inf"], "--wind: '-inf': expected an angle [deg], -360 to 360"),
        (["3"], "--wind: expected 2 arguments"),
    ):
        with pytest.raises(SystemExit):
            p.parse_args(["--wind", *words])
        assert told in capsys.readouterr().err
