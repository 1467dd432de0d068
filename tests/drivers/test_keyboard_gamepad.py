"""Keyboard and gamepad: what hands do becomes shares, and nothing moves that nobody holds."""

import math
import os
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.sticks.gamepad import ABS_RX, ABS_X, ABS_Y, EXPO, FROZEN_S, Gamepad, axis_codes
from drivers.sticks.keyboard import FIRST_S, LEVEL, REPEAT_S, Keyboard
from drivers.sticks.mapping import NEUTRAL, RestFirst, Shares, shaped

S = 1_000_000_000
MS = 1_000_000
unit = st.floats(-1, 1)
zones, expos = st.floats(0, 0.9), st.floats(0, 1)


# --- shaping ----------------------------------------------------------------------------------------------


@settings(max_examples=200, deadline=None)
@given(unit, unit, zones, expos)
def test_more_stick_is_never_less_force(a, b, zone, expo):
    fa, fb = (shaped(v, dead_zone=zone, expo=expo) for v in (a, b))
    assert (fa <= fb + 1e-12) if a <= b else (fb <= fa + 1e-12)
    assert -1 <= fa <= 1 and shaped(-a, dead_zone=zone, expo=expo) == -fa
    assert fa == 0 or (fa > 0) == (a > 0)
    assert shaped(zone * 0.999, dead_zone=zone, expo=expo) == 0 and shaped(1.0, dead_zone=zone, expo=expo) == 1.0


def test_nonsense_is_no_force():
    for value in (math.nan, math.inf, -math.inf):
        assert shaped(value, dead_zone=0.1, expo=0.4) == 0
    assert shaped(5.0, dead_zone=0.1, expo=0.4) == 1.0
    for zone, expo in ((1.0, 0.4), (-0.1, 0.4), (0.1, 1.1), (0.1, -0.1)):
        with pytest.raises(ValueError, match="dead zone"):
            shaped(0.5, dead_zone=zone, expo=expo)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.one_of(st.builds(Shares, unit, unit, unit), st.just(NEUTRAL), st.just("lock")), max_size=30))
def test_nothing_passes_between_a_lock_and_rest(events):
    rest, free = RestFirst(), False
    for event in events:
        if event == "lock":
            rest.lock()
            free = False
            continue
        free = free or event.at_rest
        assert rest.pass_on(event) == (event if free else NEUTRAL)


# --- keyboard ---------------------------------------------------------------------------------------------


def held(key, seconds, delay_s, rate_hz):
    """Arrival times [ns] of the bytes of a key held from 0 on."""
    times, t = [0], delay_s
    while t < seconds:
        times.append(round(t * 1e9))
        t += 1 / rate_hz
    return [(t_ns, key) for t_ns in times]


def shares_over(events, until_s, step_ms=10):
    """Shares every `step_ms`, the bytes fed as they come."""
    board, events, out = Keyboard(), list(events), []
    for t_ns in range(0, round(until_s * S), step_ms * MS):
        data = b""
        while events and events[0][0] <= t_ns:
            data += events.pop(0)[1]
        board.feed(data, t_ns)
        out.append((t_ns * 1e-9, board.shares(t_ns)))
    return out


@pytest.mark.parametrize(("delay_s", "rate_hz"), [(0.25, 11), (0.25, 30), (0.5, 25), (0.6, 25), (0.4, 40)])
def test_a_key_that_is_held_drives_without_a_break_and_one_let_go_stops(delay_s, rate_hz):
    """From the slowest to the quickest repeat that consoles and desktops come with."""
    course = shares_over(held(b"w", 3.0, delay_s, rate_hz), 5.0)
    assert all(s.surge == LEVEL for t, s in course if t < 3.0)
    assert all(s == NEUTRAL for t, s in course if t > 3.0 + REPEAT_S)


def test_a_tap_ends_by_itself():
    course = shares_over([(0, b"d")], 2.0)
    assert max(t for t, s in course if s != NEUTRAL) < FIRST_S <= 0.7


def test_a_key_held_again_after_a_release_is_a_first_press():
    course = shares_over([*held(b"w", 1.0, 0.3, 30), (2 * S, b"w")], 4.0)
    assert max(t for t, s in course if s != NEUTRAL) == pytest.approx(2.0 + FIRST_S, abs=0.02)


def test_the_next_key_replaces_the_one_before_at_once():
    board = Keyboard()
    board.feed(b"w", 0)
    board.feed(b"d", 10 * MS)
    assert board.shares(20 * MS) == Shares(yaw=LEVEL)


@pytest.mark.parametrize(
    ("keys", "shares"),
    [
        (b"w", (1, 0, 0)), (b"s", (-1, 0, 0)), (b"a", (0, 0, -1)), (b"d", (0, 0, 1)), (b"q", (1, 0, -0.5)),
        (b"e", (1, 0, 0.5)), (b"z", (0, -1, 0)), (b"c", (0, 1, 0)), (b"W", (1, 0, 0)),
        (b"\x1b[A", (1, 0, 0)), (b"\x1b[B", (-1, 0, 0)), (b"\x1b[C", (0, 0, 1)), (b"\x1bOD", (0, 0, -1)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("together", [True, False])
def test_each_key(keys, shares, together):
    board = Keyboard()
    commands = board.feed(b"0", 0)
    for i, data in enumerate([keys] if together else [bytes([b]) for b in keys]):
        commands += board.feed(data, i * MS)
    assert commands == [] and board.shares(5 * MS) == shares


def test_levels():
    board = Keyboard()
    for key, level in [(b"1", 0.1), (b"5", 0.5), (b"9", 0.9), (b"0", 1.0)]:
        board.feed(key + b"w", 0)
        assert board.shares(1).surge == level


@pytest.mark.parametrize("key", [b" ", b"x", b"X"])
def test_stop_lets_go_at_once(key):
    board = Keyboard()
    board.feed(b"w", 0)
    assert board.feed(key, 10 * MS) == ["stop"] and board.shares(11 * MS) == NEUTRAL


def test_escape_alone_stops_and_an_arrow_does_not():
    board = Keyboard()
    board.feed(b"w", 0)
    assert board.feed(b"\x1b", 10 * MS) == [] and board.feed(b"", 20 * MS) == []
    assert board.feed(b"", 80 * MS) == ["stop"] and board.shares(81 * MS) == NEUTRAL
    assert board.feed(b"\x1b\x1b", 100 * MS) == ["stop"]
    assert Keyboard().feed(b"\x1b[A\x1b[1;5C\x1b[15~", 0) == []
    assert Keyboard().feed(b"\x1b ", 0) == ["stop", "stop"], "Esc, then space"


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=6), st.sampled_from([b" ", b"x"]))
def test_a_stop_key_stops_whatever_was_typed_before(typed, key):
    """Alt-[ begins what an arrow key begins, and a bad line may lose the end of one."""
    board = Keyboard()
    board.feed(typed, 0)
    assert "stop" in board.feed(key, 100 * MS) and board.shares(101 * MS) == NEUTRAL
    board.feed(b"\x1b[", 200 * MS)
    assert board.feed(b" ", 201 * MS) == ["stop"], "no key's sequence goes on with a space"


@pytest.mark.parametrize("key", [b"\x1b[[A", b"\x1b[[E", b"\x1bOP", b"\x1b[15~", b"\x1b[1;5A", b"\x1b[H"])
def test_other_keys_of_the_top_rows_move_nothing(key):
    """F1 and F5 on a Linux console, F1 and F5 of xterm, Ctrl with an arrow, Home."""
    board = Keyboard()
    assert board.feed(key, 0) == [] and board.shares(1) == NEUTRAL


def test_commands_in_order():
    assert Keyboard().feed(b"rghpm\x03", 0) == ["drive", "start", "hold", "excite", "mark", "quit"]


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 10**9), st.binary(max_size=6)), max_size=12))
def test_whatever_is_typed_silence_is_neutral(events):
    board, t_ns = Keyboard(), 0
    for dt_ns, data in events:
        t_ns += dt_ns
        board.feed(data, t_ns)
        assert all(abs(s) <= 1 for s in board.shares(t_ns))
    assert board.shares(t_ns + round(FIRST_S * S)) == NEUTRAL
    assert board.shares(t_ns - S) == NEUTRAL, "a clock that goes back holds nothing"


# --- gamepad ----------------------------------------------------------------------------------------------

CODES = (0, 1, 2, 3, 4, 5, 16, 17)
"""An Xbox pad: axis 2 and 5 are triggers that rest at -1."""


def event(number, value, kind=2):
    return struct.pack("<IhBB", 0, round(value * 32767), kind, number)


def opened(codes=CODES, x=0.0, y=0.0, rx=0.0):
    """What a pad says when it is opened: every axis, marked as initial."""
    rest = {ABS_X: x, ABS_Y: y, ABS_RX: rx, 2: -1.0, 5: -1.0}
    return b"".join(event(n, rest.get(c, 0.0), 0x82) for n, c in enumerate(codes)) + struct.pack("<IhBB", 0, 0, 0x81, 0)


def test_sticks_ahead_starboard_and_clockwise():
    for axis, value, place in [(1, -1.0, 0), (0, 1.0, 1), (3, 1.0, 2)]:
        pad = Gamepad(CODES)
        pad.feed(opened(), 0)
        assert pad.shares(1) == NEUTRAL
        pad.feed(event(axis, value), MS)
        assert pad.shares(2 * MS)[place] == 1.0 and sum(map(abs, pad.shares(2 * MS))) == 1.0


def test_half_a_stick_is_gentle_and_the_middle_is_dead():
    pad = Gamepad(CODES)
    pad.feed(opened(x=0.1, y=-0.1, rx=0.1), 0)
    assert pad.shares(1) == NEUTRAL
    pad.feed(event(1, -0.56), 1)
    half = (0.56 - 0.12) / 0.88
    assert pad.shares(2).surge == pytest.approx((1 - EXPO) * half + EXPO * half**3, abs=1e-4)


def test_a_pad_that_comes_with_a_stick_held_waits_for_rest():
    pad = Gamepad(CODES)
    pad.feed(opened(y=-1.0), 0)
    assert pad.shares(1) == NEUTRAL
    pad.feed(event(3, 1.0), 1)
    assert pad.shares(2) == NEUTRAL
    pad.feed(event(3, 0.0) + event(1, 0.0), 3)
    assert pad.shares(4) == NEUTRAL
    pad.feed(event(1, -1.0), 5)
    assert pad.shares(6).surge == 1.0


def test_a_pad_that_has_not_told_all_its_axes_does_not_drive():
    pad = Gamepad(CODES)
    pad.feed(event(0, 0.0) + event(1, 0.0) + event(1, -1.0), 0)
    assert pad.shares(1) == NEUTRAL


def test_a_pad_without_the_right_stick_is_said_to_lack_it():
    pad = Gamepad((0, 1, 2, 5))
    pad.feed(opened((0, 1, 2, 5)), 0)
    pad.feed(event(1, -1.0), 1)
    assert pad.missing == (ABS_RX,) and pad.shares(2) == NEUTRAL


def test_a_pad_whose_radio_died_lets_go_and_must_rest():
    pad = Gamepad(CODES)
    pad.feed(opened(), 0)
    pad.shares(1)
    pad.feed(event(1, -1.0), S)
    at = S + round(FROZEN_S * S)
    assert pad.shares(at).surge == 1.0 and pad.shares(at + 1) == NEUTRAL
    pad.feed(event(1, -0.9), at + S)
    assert pad.shares(at + S) == NEUTRAL
    pad.feed(event(1, 0.0), at + 2 * S)
    assert pad.shares(at + 2 * S) == NEUTRAL
    pad.feed(event(1, -1.0), at + 3 * S)
    assert pad.shares(at + 3 * S).surge == 1.0


def test_the_first_button_stops():
    pad = Gamepad(CODES)
    assert pad.feed(opened() + event(0, 1 / 32767, 1) + event(0, 0, 1), 0) == ["stop"]


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=100), st.integers(1, 20))
def test_any_bytes_in_any_pieces_give_bounded_shares(data, cut):
    whole, pieces = Gamepad(CODES), Gamepad(CODES)
    whole.feed(data, 0)
    for at in range(0, len(data), cut):
        pieces.feed(data[at : at + cut], 0)
    assert whole.shares(1) == pieces.shares(1) and all(abs(s) <= 1 for s in whole.shares(1))


def test_a_device_that_is_no_joystick_is_refused():
    with open(os.devnull, "rb") as file, pytest.raises(OSError):
        axis_codes(file.fileno())
