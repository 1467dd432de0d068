"""Which orders from shore the boat believes: signature, run, counter, age, repetition, and strangers' bytes."""

import hashlib
import hmac

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.telemetry.order_gate import (
    MAX_BYTES,
    SESSIONS,
    MissionFile,
    Order,
    OrderGate,
    OrderOutcome,
    OrderRefused,
    Repeated,
    read_outcome,
    seal,
)
from companion.core.telemetry.order_sender import NOWHERE, Place, Sender

S = 1_000_000_000
KEY = bytes(range(32))
BOAT_NS = 500 * S


class Local:
    """The sender's clock."""

    def __init__(self):
        self.ns = 77 * S

    def __call__(self):
        return self.ns


def sender(session="session-1", key=KEY, boat="b", run="run"):
    local = Local()
    made = Sender(boat, session, "anna", key, local)
    made.hear(run, BOAT_NS)
    return made, local


def code(gate, sent, now_ns=BOAT_NS):
    with pytest.raises(OrderRefused) as no:
        gate.judge(*sent, now_ns)
    assert str(no.value)
    return no.value.code


@pytest.mark.parametrize("key", [KEY, None])
def test_an_order_is_believed_once(key):
    gate, (anna, local) = OrderGate("b", "run", key), sender(key=key)
    sent = anna.order("start")
    order = gate.judge(*sent, BOAT_NS + S)
    assert order.command == "start" and order.sender == "anna" and order.t_ns == BOAT_NS
    with pytest.raises(Repeated) as again:
        gate.judge(*sent, BOAT_NS + S)
    assert again.value.outcome is None
    outcome = OrderOutcome(run="run", t_ns=1, status="done", code="ok", text="")
    gate.finish(order, outcome)
    with pytest.raises(Repeated) as again:
        gate.judge(*sent, BOAT_NS + S)
    assert again.value.outcome is outcome and read_outcome(msgspec.json.encode(outcome)) == outcome
    local.ns += S
    assert gate.judge(*anna.order("hold"), BOAT_NS + S).counter == 2
    assert code(gate, sent, BOAT_NS + S) == "replayed"


def test_the_signature_is_hmac_over_boat_and_payload():
    payload, mac = sender()[0].order("stop")
    assert mac == hmac.new(KEY, b"aritra-order-1\0b\0" + payload, hashlib.sha256).digest() == seal(KEY, "b", payload)
    gate = OrderGate("b", "run", KEY)
    assert gate.signed and not OrderGate("b", "run", None).signed
    for wrong in (None, b"", mac[:-1], bytes([mac[0] ^ 1]) + mac[1:], seal(bytes(32), "b", payload),
                  seal(KEY, "other", payload)):  # fmt: skip
        assert code(gate, (payload, wrong)) == "unsigned"
    assert code(gate, (payload.replace(b"stop", b"hold"), mac)) == "unsigned"
    assert gate.judge(payload, mac, BOAT_NS).command == "stop"


def test_a_stop_that_was_overtaken_by_another_order_still_stops_and_only_once():
    """It was refused as replayed: whoever pressed it last, the boat drove."""
    gate, (anna, _) = OrderGate("b", "run", KEY), sender()
    stop, hold, start = anna.order("stop"), anna.order("hold"), anna.order("start")
    gate.judge(*start, BOAT_NS)
    assert gate.judge(*stop, BOAT_NS).command == "stop"
    assert code(gate, hold) == "replayed" and code(gate, stop) == "replayed"
    with pytest.raises(Repeated):
        gate.judge(*start, BOAT_NS)


@pytest.mark.parametrize("command", ["start", "hold", "manual"])
def test_what_was_given_before_somebodys_stop_does_not_drive_the_boat_after_it(command):
    """A bad radio held anna's order up for 4 s; bob stopped the boat meanwhile."""
    gate, (anna, local), (bob, _) = OrderGate("b", "run", KEY), sender(), sender("session-2")
    held_up = anna.order(command)
    gate.judge(*bob.order("stop", at=Place("run", BOAT_NS + 2 * S)), BOAT_NS + 2 * S)
    with pytest.raises(OrderRefused, match="before a STOP"):
        gate.judge(*held_up, BOAT_NS + 4 * S)
    local.ns += 3 * S
    assert gate.judge(*anna.order(command), BOAT_NS + 4 * S).command == command, "given after it"


def test_a_hello_asks_for_the_key_and_for_nothing_else():
    gate, (anna, _) = OrderGate("b", "run", KEY), sender(run="another")
    hello = anna.order("hello", at=NOWHERE)
    for _ in range(3):
        assert gate.judge(*hello, BOAT_NS).command == "hello", "it does nothing, so it may come again"
    for place, heard in ((Place("run", BOAT_NS), ("x",)), (NOWHERE, ()), (Place("run", BOAT_NS - 6 * S), ())):
        told = gate.judge(*anna.order("hello", at=place, heard=("x",)), BOAT_NS).heard
        assert told == heard, "who repeats an old one raises no alarm"
    assert code(gate, (hello.payload, bytes(32))) == "unsigned"


def test_answers_are_signed_with_the_order_that_they_answer():
    gate, order, reply = OrderGate("b", "run", KEY), b"order", b"reply"
    asked = hashlib.sha256(order).digest()
    assert gate.answer_seal(order, reply) == hmac.new(KEY, b"aritra-answer-1\0b\0" + asked + reply, "sha256").digest()
    assert OrderGate("b", "run", None).answer_seal(order, reply) is None
    payload, mac = sender()[0].order("stop")
    assert gate.proves(payload, mac) and not gate.proves(payload, None) and not gate.proves(payload + b" ", mac)
    assert OrderGate("b", "run", None).proves(payload, None)


def test_another_run_or_boat_is_refused():
    assert code(OrderGate("b", "later", KEY), sender()[0].order("start")) == "wrong_run"
    assert code(OrderGate("c", "run", KEY), sender()[0].order("start")) == "unsigned"


@pytest.mark.parametrize(
    ("command", "age_s", "believed"),
    [("start", 4.9, True), ("start", 5.1, False), ("hold", 5.1, False), ("stop", 5.1, True), ("stop", 59.0, True),
     ("stop", 61.0, False), ("start", -0.9, True), ("start", -1.1, False), ("stop", -1.1, False)],
)  # fmt: skip
def test_old_orders_are_refused_and_a_late_stop_is_not(command, age_s, believed):
    gate, sent = OrderGate("b", "run", KEY), sender()[0].order(command)
    now_ns = BOAT_NS + round(age_s * S)
    if believed:
        assert gate.judge(*sent, now_ns).command == command
    else:
        assert code(gate, sent, now_ns) == "late"


def test_nothing_recorded_is_ever_obeyed_twice():
    """Whatever an eavesdropper repeats, and whenever: also after the sender was forgotten."""
    gate, (anna, local) = OrderGate("b", "run", KEY), sender()
    heard = []
    for step in range(40):
        local.ns += 3 * S
        now_ns = BOAT_NS + (local.ns - 77 * S)
        heard.append(anna.order(("start", "stop", "hold")[step % 3]))
        assert gate.judge(*heard[-1], now_ns)
        for old in heard:
            with pytest.raises((OrderRefused, Repeated)):
                gate.judge(*old, now_ns)
    for late_s in (4, 30, 59, 61, 62, 70, 1000):
        for old in heard:
            with pytest.raises((OrderRefused, Repeated)):
                gate.judge(*old, now_ns + late_s * S)
        busy = sender(session=f"other-{late_s:04d}")[0]
        busy.hear("run", BOAT_NS)
        with pytest.raises(OrderRefused):
            gate.judge(*busy.order("stop"), now_ns + late_s * S)  # lets the gate forget


def test_memory_is_bounded_and_a_stop_always_passes():
    gate = OrderGate("b", "run", KEY)
    for k in range(SESSIONS):
        gate.judge(*sender(f"session-{k}")[0].order("hold"), BOAT_NS)
    assert code(gate, sender("one-too-many")[0].order("hold")) == "crowded"
    assert gate.judge(*sender("one-too-many")[0].order("stop"), BOAT_NS).command == "stop"
    for k in range(SESSIONS):  # a minute later all of them are forgotten
        later, local = sender(f"later-{k:04d}")
        local.ns += 62 * S
        assert gate.judge(*later.order("hold"), BOAT_NS + 62 * S)
    assert code(gate, later_than(62).order("hold"), BOAT_NS + 62 * S) == "crowded"


def later_than(seconds):
    one, local = sender("one-too-many-again")
    local.ns += seconds * S
    return one


def test_what_is_refused_takes_no_memory():
    gate = OrderGate("b", "run", KEY)
    for k in range(2 * SESSIONS):
        payload, _ = sender(f"unsigned-{k:04d}")[0].order("hold")
        assert code(gate, (payload, b"\0" * 32)) == "unsigned"
    for k in range(SESSIONS):
        assert gate.judge(*sender(f"session-{k}")[0].order("hold"), BOAT_NS)


def order(**changes):
    told = {"run": "run", "t_ns": BOAT_NS, "session": "session-1", "counter": 1, "sender": "anna", "command": "stop"}
    return msgspec.json.encode(told | changes)


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        (b"", "malformed"),
        (b"stop", "malformed"),
        (b"[" * 60_000, "malformed"),
        (b"\xff\xfe", "malformed"),
        (order(command="self_destruct"), "malformed"),
        (order(sender="anna\n"), "malformed"),
        (order(sender=""), "malformed"),
        (order(session="short"), "malformed"),
        (order(counter=-1), "malformed"),
        (order(counter=1 << 70), "malformed"),
        (order(t_ns=1.5), "malformed"),
        (order(mission={"name": "m.toml", "text": ""}), "malformed"),
        (order(command="load_mission"), "malformed"),
        (order(v=2), "version"),
        (b" " * (MAX_BYTES + 1), "too_long"),
    ],
)
def test_what_is_not_an_order_is_refused_in_words(payload, expected):
    assert code(OrderGate("b", "run", None), (payload, None)) == expected


@settings(max_examples=300, deadline=None)
@given(payload=st.binary(max_size=300), attachment=st.none() | st.binary(max_size=40), key=st.sampled_from([KEY, None]))
def test_strange_bytes_never_raise_anything_else(payload, attachment, key):
    gate = OrderGate("b", "run", key)
    with pytest.raises(OrderRefused):
        gate.judge(payload, attachment, BOAT_NS)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_an_order_with_any_byte_changed_is_refused(data):
    gate, (payload, mac) = (
        OrderGate("b", "run", KEY),
        sender()[0].order("load_mission", MissionFile(name="m", text="x")),
    )
    at, to = data.draw(st.integers(0, len(payload) - 1)), data.draw(st.integers(0, 255))
    if payload[at] != to:
        assert code(gate, (payload[:at] + bytes([to]) + payload[at + 1 :], mac)) == "unsigned"


def test_a_sender_learns_the_boats_clock_from_what_came_quickest():
    anna, local = sender()
    local.ns += 10 * S
    anna.hear("run", BOAT_NS + 7 * S)  # three seconds on the way
    stamped = msgspec.json.decode(anna.order("stop")[0], type=Order)
    assert abs(stamped.t_ns - (BOAT_NS + 10 * S)) < 0.02 * S
    anna.hear("anew", 5 * S)
    stamped = msgspec.json.decode(anna.order("stop")[0], type=Order)
    assert (stamped.run, stamped.t_ns, stamped.counter) == ("anew", 5 * S, 2)
    with pytest.raises(ValueError, match="no telemetry heard"):
        Sender("b", "session-2", "bob", None, local).order("stop")
    with pytest.raises(ValueError, match="not an outcome"):
        read_outcome(b"{}")
