"""Orders of the console: signed so that a boat believes them, repeated until answered, told as they are."""

import asyncio

import msgspec
import pytest

from companion.core.telemetry.order_gate import (
    MissionFile,
    OrderGate,
    OrderOutcome,
    OrderRefused,
    Repeated,
    Sender,
    seal,
)
from companion.shore.console import orders as module
from companion.shore.console.orders import Orders, SentOrder

KEY = bytes(range(32))


class Boat:
    """Answers as a boat does; `deaf`: the first so many asks get no answer. `slow`: they are on their way meanwhile."""

    def __init__(self, deaf=0, slow=0, now_ns=1_000):
        self.gate, self.deaf, self.slow, self.heard, self.obeyed = OrderGate("b", "run", KEY), deaf, slow, [], []
        self.now_ns = now_ns

    async def ask(self, boat, payload, attachment, timeout_s):
        assert boat == "b" and 0 < timeout_s <= module.ANSWER_S
        self.heard.append((payload, attachment))
        if self.deaf:
            self.deaf -= 1
            return None
        try:
            order = self.gate.judge(payload, attachment, self.now_ns)
        except Repeated as again:
            if again.outcome is None or self.slow:
                self.slow -= 1
                return self.answer("waiting", "busy", "on its way", repeated=True)
            return msgspec.json.encode(msgspec.structs.replace(again.outcome, repeated=True))
        except OrderRefused as no:
            return self.answer("refused", no.code, no.text)
        self.obeyed.append(order)
        reply = self.answer("done", "ok", f"{order.command}: the pilot has it")
        self.gate.finish(order, msgspec.json.decode(reply, type=OrderOutcome))
        return None if self.slow else reply

    def answer(self, status, code, text, repeated=False):
        return msgspec.json.encode(
            OrderOutcome(run="run", t_ns=1, status=status, code=code, text=text, repeated=repeated)
        )


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(module, "PAUSE_S", 0.001)


def sender(key=KEY, heard=True):
    made = Sender("b", "session-1", "anna", key, lambda: 0)
    if heard:
        made.hear("run", 1_000)
    return made


def give(boat, command="stop", mission=None, who=None):
    told = []

    async def play():
        orders = Orders(lambda _: who or sender(), boat.ask, lambda g: told.append(msgspec.structs.replace(g)))
        return await orders.give("b", command, mission)

    return asyncio.run(play()), told


def test_a_stop_is_obeyed_once_and_the_answer_is_the_boats():
    boat = Boat()
    given, told = give(boat)
    assert given.state == "answered" and given.outcome.text == "stop: the pilot has it" and given.after_ms >= 0
    assert [g.state for g in told] == ["sending", "answered"] and len(boat.obeyed) == 1
    payload, attachment = boat.heard[0]
    assert attachment == seal(KEY, "b", payload)


def test_an_unanswered_order_is_said_again_word_for_word_and_obeyed_once():
    boat = Boat(deaf=3)
    given, told = give(boat)
    assert given.state == "answered" and given.tries == 4 and len(set(boat.heard)) == 1 and len(boat.obeyed) == 1
    assert [g.tries for g in told if g.state == "sending"] == [0, 2, 3]


def test_a_lost_answer_is_asked_for_again():
    boat = Boat(slow=2)
    given, _ = give(boat)
    assert given.outcome.repeated and given.outcome.status == "done" and len(boat.obeyed) == 1


def test_silence_is_told_as_silence(monkeypatch):
    monkeypatch.setitem(module.PATIENCE_S, "stop", 0.05)
    given, _ = give(Boat(deaf=10**6))
    assert given.state == "no_answer" and given.outcome is None and "may not have heard" in given.why


def test_a_boat_that_was_not_heard_yet_is_waited_for(monkeypatch):
    monkeypatch.setitem(module.PATIENCE_S, "stop", 0.05)
    given, _ = give(Boat(), who=sender(heard=False))
    assert given.state == "not_sent" and given.tries == 0 and "nothing was heard of b" in given.why
    monkeypatch.setitem(module.PATIENCE_S, "stop", 5.0)
    late = sender(heard=False)

    async def play():
        boat = Boat()
        orders = Orders(lambda _: late, boat.ask, lambda _: None)
        task = asyncio.create_task(orders.give("b", "stop"))
        await asyncio.sleep(0.01)
        late.hear("run", 1_000)
        return await task

    assert asyncio.run(play()).state == "answered"


def test_refusals_and_rubbish(monkeypatch):
    given, _ = give(Boat(), who=sender(key=bytes(32)))
    assert given.state == "answered" and given.outcome.status == "refused" and given.outcome.code == "unsigned"
    boat = Boat()
    boat.ask = lambda *_: asyncio.sleep(0, b"rubbish")
    monkeypatch.setitem(module.PATIENCE_S, "hold", 0.02)
    given, _ = give(boat, "hold")
    assert given.state == "no_answer"


def test_a_stop_finds_the_run_that_was_started_meanwhile_another_order_does_not(monkeypatch):
    who, boat = sender(), Boat()
    who.hear("before", 1_000)
    given, _ = give(boat, "hold", who=who)
    assert given.outcome.code == "wrong_run" and not boat.obeyed, "what was meant for another situation"

    async def play():
        task = asyncio.create_task(Orders(lambda _: who, boat.ask, lambda _: None).give("b", "stop"))
        await asyncio.sleep(0.01)
        who.hear("run", 1_000)
        return await task

    assert asyncio.run(play()).outcome.status == "done" and [o.command for o in boat.obeyed] == ["stop"]
    who.hear("again", 1_000)
    monkeypatch.setitem(module.PATIENCE_S, "stop", 0.02)
    given, _ = give(boat, who=who)
    assert given.state == "answered" and given.outcome.code == "wrong_run", "told as it is, in the end"


def test_without_a_key_nothing_is_sent():
    boat, told = Boat(), []

    async def play():
        return await Orders(lambda _: None, boat.ask, told.append).give("b", "stop")

    given = asyncio.run(play())
    assert given.state == "not_sent" and "no command key" in given.why and not boat.heard


def test_a_mission_goes_along_and_old_orders_are_forgotten():
    boat = Boat()
    given, _ = give(boat, "load_mission", MissionFile(name="pier.toml", text="x"))
    assert given.state == "answered" and boat.obeyed[0].mission.name == "pier.toml"

    async def play():
        orders = Orders(lambda _: None, boat.ask, lambda _: None)
        for _ in range(module.MAX_TOLD + 5):
            await orders.give("b", "stop")
        return orders.last

    last = asyncio.run(play())
    assert len(last) == module.MAX_TOLD and isinstance(last[module.MAX_TOLD + 5], SentOrder)
