"""Sticks of pages at the console: whose they are, how fresh, what goes on to the boat; through real sockets, too."""

import asyncio
import contextlib
import time

import msgspec
import pytest

from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import OrderOutcome, OrderRefused
from companion.core.telemetry.order_sender import Place, Sender
from companion.core.telemetry.sticks import StickGate, StickSample
from companion.shore.console.driving.sticks import AHEAD_MS, FRESH_MS, SticksDesk
from companion.shore.console.orders import SentOrder
from companion.shore.console.requests import StickPlace
from tests.support.console_fixture import answer_as_a_boat
from tests.support.console_server_fixture import KEY, Boat, post, serving, until

S = 1_000_000_000
PAGE, OTHER = "page-0001", "page-0002"


class KnownBoats:
    """What the console knows of boat b: its run, and its clock an hour ahead."""

    run = "run1"

    def __init__(self):
        self.maker = Sender("b", "session-1", "anna", KEY, lambda: 0)

    def sender(self, boat):
        return self.maker if boat == "b" else "no key"

    def place(self, boat):
        return Place(self.run, 3600 * S) if self.run else None

    def runs(self, boat):
        return (self.run,)


def order(number, command="manual", state="answered", status="done", run="run1"):
    outcome = OrderOutcome(run=run, t_ns=0, status=status, code="ok", text="") if state == "answered" else None
    return SentOrder(number=number, boat="b", command=command, state=state, asked_ms=0.0, outcome=outcome)


def sticks(t_ms=1000.0, page=PAGE, boat="b", held=True):
    return StickPlace(page=page, boat=boat, t_ms=t_ms, held=held, surge=0.5, sway=0.0, yaw=-0.5)


def desk(*orders):
    made = SticksDesk(KnownBoats())
    for each in orders or (order(1),):
        made.note(each, PAGE)
    return made


def test_a_place_of_the_sticks_is_signed_for_the_boats_clock_at_the_instant_of_the_hands():
    sealed = desk().sealed(sticks(t_ms=900.0), 1000.0)
    told = msgspec.json.decode(sealed.payload, type=StickSample)
    assert (told.run, told.t_ns) == ("run1", 3600 * S - S // 10) and (told.held, told.surge, told.yaw) == (
        True,
        0.5,
        -0.5,
    )


@pytest.mark.parametrize("age_ms", [FRESH_MS + 1, -AHEAD_MS - 1, 1e9, float("inf"), float("nan")])
def test_what_stood_in_a_queue_or_comes_from_the_future_is_not_sent(age_ms):
    made = desk()
    assert made.sealed(sticks(t_ms=1000.0 - age_ms), 1000.0) is None and made.late == 1


@pytest.mark.parametrize(
    "orders",
    [
        (order(1, status="refused"),),
        (order(1, state="sending"),),
        (order(1, state="no_answer"),),
        *((order(1), order(2, command, "sending")) for command in ("stop", "hold", "start")),
    ],
)
def test_without_a_word_of_the_boat_or_after_another_order_nobody_drives(orders):
    assert desk(*orders).sealed(sticks(), 1000.0) is None


def test_a_stop_that_was_given_before_takes_nothing_away_and_a_mission_neither():
    made = desk(order(2), order(1, "stop"), order(3, "load_mission"))
    assert made.sealed(sticks(), 1000.0) is not None


def test_another_page_drives_once_it_was_given_the_sticks_and_the_first_no_more():
    made = desk()
    assert made.sealed(sticks(page=OTHER), 1000.0) is None
    made.note(order(2), OTHER)
    assert made.sealed(sticks(), 1000.0) is None and made.sealed(sticks(page=OTHER), 1000.0) is not None


def test_another_run_of_the_boats_program_gets_nothing():
    made = desk(order(1, run="before"))
    assert made.sealed(sticks(), 1000.0) is None


def test_a_page_that_left_lets_go():
    told = msgspec.json.decode(desk().let_go(PAGE, "b").payload, type=StickSample)
    assert not told.held and told.surge == 0 and desk().let_go(OTHER, "b") is None


# --- through real sockets, to a boat behind real zenoh --------------------------------------------


class SteeredBoat(Boat):
    """A boat that hears sticks through the real gate; `moved`: (surge, how long they were under way [s])."""

    def __init__(self, port):
        self.sticks, self.moved, self.wrong = StickGate("b", "run1", KEY), [], []
        super().__init__(port)
        self.held.append(self.session.declare_subscriber(shore.sticks_key("b"), self.steer))

    def answer(self, query):
        answer_as_a_boat(query, self.gate, time.monotonic_ns(), self.obeyed, self.sticks.take)

    def steer(self, sample):
        now_ns = time.monotonic_ns()
        try:
            moved = self.sticks.judge(bytes(sample.payload), bytes(sample.attachment), now_ns)
            self.moved.append((moved.surge, (now_ns - moved.t_ns) * 1e-9))
        except OrderRefused as no:
            self.wrong.append(str(no))


def word(t_ms=None, **more):
    told = {"page": PAGE, "boat": "b", "t_ms": time.monotonic() * 1e3 if t_ms is None else t_ms, "held": True}
    return {"sticks": told | {"surge": 0.5, "sway": 0.0, "yaw": 0.0} | more}


def test_from_a_page_to_the_boat_and_no_longer_than_the_page_is_there():
    async def play():
        async with serving() as desk, contextlib.AsyncExitStack() as stack:
            boat = await asyncio.to_thread(SteeredBoat, desk.zenoh)
            stack.push_async_callback(asyncio.to_thread, boat.session.close)
            await until(lambda: "b" in desk.console.store.boats)
            boat.tell(0)
            await until(lambda: desk.console.known.place("b"))
            async with desk.http.ws_connect(f"{desk.url}/ws", origin=desk.url) as page:
                await page.send_json(word())
                async with post(desk, {"boat": "b", "command": "manual", "page": PAGE}) as answer:
                    assert (await answer.json())["outcome"]["status"] == "done"
                for bad in (word(surge=2.0), word(t_ms=0.0), word(page=OTHER), {"sticks": 1}, word(more=1)):
                    await page.send_json(bad)
                await page.send_json(word(surge=0.75))
                await until(lambda: boat.moved)
            await until(lambda: len(boat.moved) == 2)
            await asyncio.sleep(0.2)
            assert [surge for surge, _ in boat.moved] == [0.75, 0.0], "and the page's end lets go"
            assert all(0 <= late_s < 0.5 for _, late_s in boat.moved) and boat.wrong == []

    asyncio.run(play())
