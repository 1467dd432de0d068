"""Sticks from shore: which samples the boat believes, and what it makes of them."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.telemetry.order_gate import Order, OrderRefused
from companion.core.telemetry.order_sender import Place, Sender
from companion.core.telemetry.sticks import AHEAD_S, FRESH_S, MAX_BYTES, StickGate, StickSample, seal_sticks

KEY, S = bytes(range(32)), 1_000_000_000
NOW = 1_000 * S
SHARES = {"surge": 0.5, "sway": -0.25, "yaw": 1.0}


def sender(session="session-1", key=KEY, boat="b", name="anna"):
    return Sender(boat, session, name, key, lambda: 0)


def order(maker, command="manual"):
    return msgspec.json.decode(maker.order(command, at=Place("run", NOW)).payload, type=Order)


def taken(maker, key=KEY):
    """A gate whose sticks were given to `maker`."""
    gate = StickGate("b", "run", key)
    gate.take(order(maker))
    return gate


def sample(maker, t_ns=NOW, run="run", held=True):
    return maker.sticks(Place(run, t_ns), held=held, **SHARES)


def refused(gate, sealed, now_ns=NOW):
    with pytest.raises(OrderRefused) as no:
        gate.judge(*sealed, now_ns)
    return no.value.code


def test_what_is_signed_fresh_and_of_who_was_given_them_moves_the_boat():
    anna = sender()
    moved = taken(anna).judge(*sample(anna), NOW + S // 10)
    assert (moved.surge, moved.sway, moved.yaw) == (0.5, -0.25, 1.0)
    assert moved.t_ns == NOW and moved.source == "shore, anna", "the instant of the hands, not of the arrival"


def test_without_the_dead_man_the_sticks_are_at_rest_whatever_they_say():
    anna = sender()
    moved = taken(anna).judge(*sample(anna, held=False), NOW)
    assert (moved.surge, moved.sway, moved.yaw) == (0, 0, 0)


def test_nobody_steers_before_the_sticks_were_given_and_after_they_were_taken_away():
    anna, bert = sender(), sender("session-2")
    gate = StickGate("b", "run", KEY)
    assert not gate.is_taken and refused(gate, sample(anna)) == "not_now"
    gate.take(order(anna))
    assert refused(gate, sample(bert)) == "not_now"
    gate.take(order(bert))
    assert refused(gate, sample(anna)) == "not_now" and gate.judge(*sample(bert), NOW).source
    for command in ("stop", "hold", "start"):
        gate.take(order(bert))
        gate.take(order(anna, command))
        assert refused(gate, sample(bert)) == "not_now" and not gate.is_taken


@given(st.floats(-5.0, 5.0).filter(lambda s: min(abs(s + AHEAD_S), abs(s - FRESH_S)) > 1e-6))
def test_only_what_is_fresh_by_the_boats_clock_moves_it_and_never_from_the_future(age_s):
    anna = sender()
    gate, sealed = taken(anna), sample(anna, t_ns=NOW - round(age_s * S))
    if -AHEAD_S <= age_s <= FRESH_S:
        assert gate.judge(*sealed, NOW).t_ns <= NOW
    else:
        assert refused(gate, sealed) == "late"


def test_a_sample_counts_once_and_older_ones_no_more():
    anna = sender()
    gate, first, second = taken(anna), sample(anna), sample(anna)
    gate.judge(*second, NOW)
    assert refused(gate, second) == "replayed" == refused(gate, first)
    gate.take(order(anna))
    assert refused(gate, second) == "replayed", "given anew, what was said before is not said again"


def test_a_sample_of_another_boat_run_key_or_kind_is_nobodys():
    anna = sender()
    gate, (payload, seal) = taken(anna), sample(anna)
    assert refused(gate, (payload, None)) == "unsigned" == refused(gate, (payload.replace(b"0.5", b"0.6"), seal))
    assert refused(gate, sample(sender(key=bytes(32)))) == "unsigned" == refused(gate, sample(sender(boat="c")))
    assert refused(gate, sample(anna, run="before")) == "wrong_run"
    stop = anna.order("stop", at=Place("run", NOW))
    assert refused(gate, stop) == "unsigned", "the signature of an order is none of sticks"
    assert refused(gate, (b"x" * (MAX_BYTES + 1), None)) == "too_long"


@pytest.mark.parametrize(
    ("change", "code"),
    [({"surge": 1.5}, "malformed"), ({"yaw": None}, "malformed"), ({"t_ns": -1}, "malformed"), ({"v": 2}, "version")],
)
def test_what_is_signed_and_no_sample_is_refused(change, code):
    anna = sender()
    told = msgspec.json.decode(sample(anna).payload) | change
    payload = msgspec.json.encode(told)
    assert refused(taken(anna), (payload, seal_sticks(KEY, "b", payload))) == code


def test_a_boat_without_a_key_believes_unsigned_ones_as_it_does_of_orders():
    anna = sender(key=None)
    gate, sealed = taken(anna, key=None), sample(anna)
    assert sealed.attachment is None and gate.judge(*sealed, NOW).surge == 0.5


@given(st.binary(max_size=200))
def test_rubbish_of_whoever_has_the_key_raises_nothing_else(data):
    gate = taken(sender())
    assert refused(gate, (data, seal_sticks(KEY, "b", data))) in ("malformed", "version")


def test_orders_and_sticks_are_of_one_sequence():
    anna = sender()
    counters = [
        msgspec.json.decode(sample(anna).payload, type=StickSample).counter,
        order(anna).counter,
        msgspec.json.decode(sample(anna).payload, type=StickSample).counter,
    ]
    assert counters == [1, 2, 3]
