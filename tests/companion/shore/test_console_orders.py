"""Orders of the console: signed so that a boat believes them, repeated until answered, told as they are."""

import asyncio

import pytest

from companion.core.telemetry.order_gate import (
    MissionFile,
    OrderGate,
    seal,
)
from companion.core.telemetry.order_sender import Place, Sender
from companion.shore.console import orders as module
from companion.shore.console.orders import SentOrder
from tests.companion.shore.orders_fixture import KEY, Boat, S, Stranger, Water, impatient


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(module, "PAUSE_S", 0.001)
    monkeypatch.setattr("companion.shore.console.stop_chase.AGAIN_S", 0.005)


# --- one boat ---------------------------------------------------------------------------------------


def test_a_stop_is_obeyed_once_and_the_answer_is_the_boats():
    water = Water()
    given = water.give()
    (boat,) = water.programs
    assert given.state == "answered" and given.outcome.text == "stop: the pilot has it" and given.after_ms >= 0
    assert water.told[0].state == "sending" and water.told[-1].state == "answered"
    assert boat.commands == ["stop"] and len(boat.heard) == 1, "at once, without a question before"
    payload, attachment = boat.heard[0]
    assert attachment == seal(KEY, "b", payload)


@pytest.mark.parametrize("t_ns", [-(1 << 70), 1 << 63, 1 << 90])
def test_telemetry_with_a_clock_that_no_order_can_carry_keeps_no_stop_away(t_ns):
    """The boat refused it as malformed, and it was not made out anew."""
    water = Water(by_telemetry=Place("run", t_ns))
    assert water.give().outcome.status == "done" and water.programs[0].commands == ["stop"]


def test_an_unanswered_stop_is_said_again_word_for_word_and_obeyed_once():
    water = Water([boat := Boat(deaf=3)])
    given = water.give()
    assert given.state == "answered" and given.tries == 4 and len(set(boat.heard)) == 1 and len(boat.obeyed) == 1


def test_another_order_asks_who_is_there_and_is_made_out_for_that():
    water = Water([boat := Boat(deaf=2)], by_telemetry=Place("run", 0))
    given = water.give("start")
    assert given.state == "answered" and given.outcome.status == "done" and boat.commands == ["start"]
    assert boat.obeyed[0].t_ns == 1_000 * S, "the boat's own word, whatever its telemetry was made to say"


@pytest.mark.parametrize("command", ["stop", "hold"])
def test_a_lost_answer_is_asked_for_again(command):
    water = Water([boat := Boat(slow=2)])
    given = water.give(command)
    assert given.outcome.repeated and given.outcome.status == "done" and len(boat.obeyed) == 1


@pytest.mark.parametrize(("command", "state"), [("stop", "no_answer"), ("hold", "not_sent")])
def test_silence_is_told_as_silence(command, state, monkeypatch):
    impatient(monkeypatch, command)
    given = Water([Boat(deaf=10**6)]).give(command)
    assert given.state == state and given.outcome is None and "no answer in" in given.why


def test_a_stop_needs_no_telemetry():
    water = Water(by_telemetry=None, runs_heard=())
    assert water.give().outcome.status == "done" and water.programs[0].commands == ["stop"]


def test_the_wrong_key_is_told_and_rubbish_is_no_answer(monkeypatch):
    for command in ("stop", "hold"):
        impatient(monkeypatch, command)
        given = Water(key=bytes(32)).give(command)
        assert given.outcome is None and "not signed with this boat's command key" in given.why
    water = Water([Stranger(never=True)])
    assert water.give("hold").state == "not_sent"


def test_without_a_key_nothing_is_sent():
    water = Water(key="this console has no command key for this boat")
    given = water.give()
    assert given.state == "not_sent" and "no command key" in given.why and not water.programs[0].heard


def test_a_mission_goes_along_and_old_orders_are_forgotten():
    water = Water()
    given = water.give("load_mission", MissionFile(name="pier.toml", text="x"))
    assert given.state == "answered" and water.programs[0].obeyed[0].mission.name == "pier.toml"
    nobody = Water(key="none")

    async def play():
        for _ in range(module.MAX_TOLD + 5):
            await nobody.orders.give("b", "stop")
        return nobody.orders.last

    last = asyncio.run(play())
    assert len(last) == module.MAX_TOLD and isinstance(last[module.MAX_TOLD + 5], SentOrder)


# --- what used to refuse a stop for good --------------------------------------------------------------


@pytest.mark.parametrize("key", [KEY, None])
@pytest.mark.parametrize(
    ("by_telemetry", "runs"),
    [
        (Place("came and went", 7), ("came and went",)),  # a second program, or one unsigned sample of another run
        (Place("run", 4_600 * S), ("run",)),  # one sample with a clock an hour ahead
        (Place("run", 0), ("run",)),  # one far behind
        (None, ("run", "other")),
    ],
)
def test_whatever_telemetry_says_a_stop_gets_through(by_telemetry, runs, key, monkeypatch):
    impatient(monkeypatch, "stop", 0.5)
    water = Water([boat := Boat(key=key)], key=key, by_telemetry=by_telemetry, runs_heard=runs)
    given = water.give()
    assert boat.commands == ["stop"] and given.outcome.status == "done" and given.after_ms < 300


def test_a_stop_reaches_every_program_of_the_name():
    one, other = Boat("run", now_ns=5 * S), Boat("other", now_ns=9_999 * S)
    water = Water([one, other], by_telemetry=Place("run", 5 * S), runs_heard=("run", "other"))
    given = water.give()
    assert one.commands == other.commands == ["stop"] and "2 programs that call themselves b have it" in given.why
    assert given.missing == ()


def test_a_program_whose_answer_takes_longer_than_a_try_is_stopped_once():
    """Each refusal of what was made out for the other run made out one more, and the boat obeyed them all."""
    one, other = Boat("run"), Boat("other")
    one.away_s = other.away_s = 0.05
    water = Water([one, other], runs_heard=("run", "other"))

    async def play():
        given = await water.orders.give("b", "stop")
        await asyncio.sleep(0.1)  # for what is still under way
        return given

    given = asyncio.run(play())
    assert one.commands == other.commands == ["stop"] and given.outcome.status == "done" and given.tries > 1


def test_a_run_that_is_heard_and_does_not_answer_keeps_no_other_waiting_and_is_told(monkeypatch):
    impatient(monkeypatch, "stop", 0.3)
    water = Water(runs_heard=("run", "ghost"))
    given = water.give()
    assert given.outcome.status == "done" and given.after_ms < 100 and "without an answer: run ghost" in given.why
    assert given.missing == ("ghost",)
    assert next(g for g in water.told if g.state == "answered").after_ms == given.after_ms, "told as soon as it came"


def test_a_strangers_answer_ends_nothing():
    water = Water([Stranger(), boat := Boat(deaf=2)])
    given = water.give()
    assert given.outcome.run == "run" and boat.commands == ["stop"]
    assert given.missing == (module.STRANGER,) and "answered under this name, too" in given.why


def test_an_overheard_answer_is_none_to_another_order():
    """An answer is signed together with the order that it answers."""
    maker, boat = Sender("b", "session-1", "anna", KEY, lambda: 0), Boat()
    first, second = (maker.order("stop", at=Place("run", 1_000 * S)) for _ in range(2))
    reply, sealed = boat.answer(*first)
    assert maker.believe(first.payload, reply, sealed).status == "done"
    assert maker.believe(second.payload, reply, sealed) is None and maker.believe(first.payload, reply, None) is None


# --- names that are shared ----------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["start", "hold", "load_mission"])
@pytest.mark.parametrize(
    ("programs", "runs"),
    [(("run", "other"), ("run",)), (("run",), ("run", "other")), (("other",), ("run",)), (("a", "b"), ())],
)
def test_a_name_that_two_share_gets_no_other_order(command, programs, runs):
    boats = [Boat(run) for run in programs]
    given = Water(boats, runs_heard=runs).give(command, MissionFile(name="m", text="") if "load" in command else None)
    assert given.state == "not_sent" and "several programs call themselves b" in given.why
    assert not any(boat.obeyed for boat in boats)


def test_programs_of_one_name_are_told_of_each_other():
    one, other = Boat("run"), Boat("other")
    water = Water([one, other], runs_heard=("run", "other"))
    asyncio.run(water.orders.warn("b"))
    assert one.met == {"other"} and other.met == {"run"} and not one.obeyed


def test_an_order_is_never_taken_by_another_run_than_it_was_made_out_for():
    """Started anew between question and order: what was meant for another situation is not obeyed."""

    class Restarting(Boat):
        def answer(self, payload, attachment):
            answered = super().answer(payload, attachment)
            self.gate, self.run = OrderGate("b", "anew", KEY), "anew"
            return answered

    given = Water([boat := Restarting()]).give("hold")
    assert not boat.obeyed and given.outcome.code == "wrong_run"
