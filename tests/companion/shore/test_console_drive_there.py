"""Drive here: a mission of one point and its start; a start that must not come after a STOP."""

import asyncio

import pytest

from companion.core.telemetry.order_gate import MissionFile
from companion.shore.console import drive_there as module
from companion.shore.console.drive_there import LEAVING, drive_there
from tests.companion.shore.orders_fixture import Boat, Water, impatient

POINT = MissionFile(name="there.toml", text="[[waypoints]]\nnorth_m = 1.0\neast_m = 2.0\n")


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr("companion.shore.console.orders.PAUSE_S", 0.001)
    monkeypatch.setattr("companion.shore.console.stop_chase.AGAIN_S", 0.005)


class Refusing(Boat):
    """Refuses one command; `act` is called as it hears another."""

    refused, trigger, act = "", "", staticmethod(lambda: None)

    def answer(self, payload, attachment):
        text = bytes(payload).decode()
        if self.trigger and f'"command":"{self.trigger}"' in text:
            self.trigger = ""
            self.act()
        return super().answer(payload, attachment)

    def outcome(self, status, code, text, repeated=False):
        if self.refused and text.startswith(self.refused):
            status, code = "refused", "not_now"
        return super().outcome(status, code, text, repeated)


def drive(water, commands=LEAVING):
    async def play():
        await drive_there(water.orders, water.orders.begin("b", commands[0]), POINT, commands)

    asyncio.run(play())
    return [(order.command, order.state) for order in water.orders.last.values()]


@pytest.mark.parametrize("commands", [LEAVING, LEAVING[1:]])
def test_each_order_goes_when_the_one_before_is_done(commands):
    water = Water()
    assert drive(water, commands) == [(command, "answered") for command in commands]
    (boat,) = water.programs
    assert tuple(boat.commands) == commands
    assert [order.mission for order in boat.obeyed if order.mission] == [POINT], "with the point, and no other order"


@pytest.mark.parametrize("refused", LEAVING[:2])
def test_nothing_is_started_after_a_step_that_was_refused(refused):
    boat = Refusing()
    boat.refused = refused
    water = Water([boat])
    told = drive(water)
    assert told[-1] == ("start", "not_sent") and "start" not in boat.commands
    assert f"{refused} was not done" in next(reversed(water.orders.last.values())).why


@pytest.mark.parametrize("trigger", ["hold", "load_mission"])
@pytest.mark.parametrize("other", ["stop", "hold", "load_mission", "start"])
def test_any_other_order_meanwhile_ends_it(trigger, other):
    boat = Refusing()
    water = Water([boat])
    boat.trigger, boat.act = trigger, lambda: water.orders.begin("b", other)
    drive(water)
    assert "start" not in boat.commands
    why = next(reversed(water.orders.last.values())).why
    assert "another order was given" in why or "was not done" in why


def test_an_order_to_another_boat_ends_nothing():
    boat = Refusing()
    water = Water([boat])
    boat.trigger, boat.act = "load_mission", lambda: water.orders.begin("c", "stop")
    drive(water)
    assert boat.commands[-1] == "start"


def test_a_program_that_was_started_anew_meanwhile_does_not_drive_its_own_mission():
    boat = Refusing()
    water = Water([boat])

    def anew():
        water.programs[0], water.runs_heard = Boat("other run"), ("other run",)

    boat.trigger, boat.act = "load_mission", anew
    told = drive(water)
    assert told[-1] == ("start", "not_sent") and water.programs[0].commands == []
    assert "started anew" in next(reversed(water.orders.last.values())).why


def test_it_does_not_start_long_after_the_click(monkeypatch):
    monkeypatch.setattr(module, "TOGETHER_S", -1.0)
    water = Water()
    assert drive(water)[-1] == ("start", "not_sent") and "start" not in water.programs[0].commands


@pytest.mark.parametrize("command", ["start", "hold", "load_mission"])
@pytest.mark.parametrize("deaf", [0, 1, 2, 5])
def test_no_order_that_is_still_tried_comes_after_a_stop(command, deaf, monkeypatch):
    """A start that the boat had not heard was repeated after the STOP, made out anew, and obeyed."""
    impatient(monkeypatch, command, 5.0)

    async def play():
        water = Water([Boat(deaf=10_000)])
        mission = POINT if command == "load_mission" else None
        trying = asyncio.create_task(water.orders.give("b", command, mission))
        for _ in range(20 + 3 * deaf):
            await asyncio.sleep(0.001)
        water.programs[0].deaf = 0
        stop = await water.orders.give("b", "stop")
        order = await trying
        return water, stop, order

    water, stop, order = asyncio.run(play())
    assert stop.state == "answered" and water.programs[0].commands[-1:] == ["stop"]
    assert order.state == "not_sent" and "STOP was given after it" in order.why
