"""Sticks from shore at the boat: through the gate to the pilot, whose dead man has the last word."""

import asyncio
import time
from types import SimpleNamespace

import msgspec

from companion.boat.clock import BoatClock
from companion.boat.uplink.stick_receiver import PENDING, ShoreSticks
from companion.core.messages import ManualInput
from companion.core.telemetry.order_gate import Order
from companion.core.telemetry.order_sender import Place, Sender
from companion.core.telemetry.sticks import StickGate

KEY = bytes(range(1, 33))


def heard(payload, attachment):
    """What zenoh hands over."""
    return SimpleNamespace(payload=payload, attachment=attachment)


class SticksRig:
    """Sticks on a loop of their own, as in a run; `moved`: what the App was told, `alerts`."""

    def __init__(self):
        self.moved, self.alerts = [], []
        self.anna = Sender("b", "session-1", "anna", KEY, time.monotonic_ns)

    def sample(self, late_s=0.0, **shares):
        at = Place("run", time.monotonic_ns() - round(late_s * 1e9))
        return heard(*self.anna.sticks(at, held=True, **({"surge": 0.5, "sway": 0.0, "yaw": 0.0} | shares)))

    def play(self, act):
        """`act(sticks)` from a thread of zenoh's."""

        async def run():
            gate = StickGate("b", "run", KEY)
            self.sticks = ShoreSticks(SimpleNamespace(manual=self.moved.append), gate, BoatClock(), self.alerts.append)
            await asyncio.to_thread(act, self.sticks)
            await asyncio.sleep(0.01)

        asyncio.run(run())

    def take(self, command="manual"):
        at = Place("run", time.monotonic_ns())
        self.sticks.take(msgspec.json.decode(self.anna.order(command, at=at).payload, type=Order))


def test_sticks_reach_the_app_once_they_were_given_and_until_the_end():
    rig = SticksRig()

    def act(sticks):
        sticks(rig.sample())
        rig.take()
        sticks(rig.sample(surge=0.25))
        rig.take("hold")
        sticks(rig.sample())
        rig.take()
        while not rig.moved:  # what was accepted before the end is with the loop by then
            time.sleep(0.005)
        sticks.end()
        sticks(rig.sample())

    rig.play(act)
    assert [m.surge for m in rig.moved] == [0.25] and isinstance(rig.moved[0], ManualInput)
    assert not rig.sticks.refused, "while nobody has them nothing is even looked at"


def test_what_is_refused_is_counted_and_told_at_powers_of_two():
    rig = SticksRig()

    def act(sticks):
        rig.take()
        for _ in range(5):
            sticks(heard(b"{}", None))
        sticks(rig.sample(late_s=1.0))
        sticks(heard(b"x" * 5000, None))
        sticks(SimpleNamespace(payload=None, attachment=None))

    rig.play(act)
    assert rig.sticks.refused == {"unsigned": 5, "late": 1, "too_long": 1, "malformed": 1} and not rig.moved
    assert len(rig.alerts) == 6 and "sticks from shore ignored" in rig.alerts[0].text


def test_a_flood_of_sticks_does_not_pile_up_before_the_loop():
    rig = SticksRig()

    async def run():
        rig.sticks = ShoreSticks(
            SimpleNamespace(manual=rig.moved.append), StickGate("b", "run", KEY), BoatClock(), rig.alerts.append
        )
        rig.take()
        for _ in range(50):  # the loop has no turn in between
            rig.sticks(rig.sample())
        await asyncio.sleep(0.01)
        rig.sticks(rig.sample(surge=-1.0))
        await asyncio.sleep(0.01)

    asyncio.run(run())
    assert len(rig.moved) == PENDING + 1 and rig.moved[-1].surge == -1.0
