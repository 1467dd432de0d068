"""Orders from shore: obeyed, held, refused, limited in rate; one through the real App."""

import asyncio
import threading
import time
from types import SimpleNamespace

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.__main__ import main
from companion.boat.clock import BoatClock
from companion.boat.uplink.order_receiver import PENDING, ShoreCommands
from companion.core.messages import NewMission, OperatorCommand
from companion.core.pilot.modes import ModeState
from companion.core.telemetry.order_gate import MissionFile, OrderGate, read_outcome
from companion.core.telemetry.order_sender import Sender
from tests.companion.boat.app_fixture import Bench, neutral
from tests.support.drive_fixture import setup

KEY = bytes(range(1, 33))


class Query:
    """What zenoh hands over, with its answer."""

    def __init__(self, payload, attachment=None):
        self.payload, self.attachment, self.answer, self.dropped = payload, attachment, None, threading.Event()
        self.hold = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.drop()

    def reply(self, key, payload, *, encoding, attachment, congestion_control, priority, express):
        if self.hold:
            self.hold.wait(5)
        assert str(encoding) == "application/json" and self.answer is None
        self.answer, self.seal, self.reply_bytes = (key, read_outcome(payload)), attachment, payload

    def drop(self):
        self.dropped.set()


def sender(key=KEY, run="run"):
    made = Sender("b", "session-1", "anna", key, time.monotonic_ns)
    made.hear(run, time.monotonic_ns())
    return made


class FakeApp:
    """Takes commands; `refusal` and `takes` as a test sets them."""

    def __init__(self):
        self.given, self.refusal, self.takes = [], None, True
        self.state = SimpleNamespace(helm=ModeState())

    def command(self, command):
        self.given.append(command)
        return self.takes

    load = command


class Desk:
    """ShoreCommands on a loop of its own, as in a run."""

    def __init__(self, key=KEY, meet=lambda run, where: None, vessel=None):
        self.app, self.alerts, self.key, self.meet = FakeApp(), [], key, meet
        self.settings = setup(vessel=vessel).pilot

    def ask(self, *queries, before=lambda: None, after=lambda: None, patience_s=5.0):
        """The queries from a thread of zenoh's, in order; their outcomes."""

        async def play():
            gate = OrderGate("b", "run", self.key)
            self.ear = ShoreCommands(self.app, self.settings, gate, BoatClock(), self.alerts.append, self.meet)
            before()
            await asyncio.to_thread(lambda: [(self.ear(q), q.dropped.wait(patience_s)) for q in queries])
            await asyncio.sleep(0.01)
            after()
            await asyncio.to_thread(queries[-1].dropped.wait, 5)
            self.ear.close()

        asyncio.run(play())
        return [q.answer and q.answer[1] for q in queries]


def test_orders_reach_the_app_and_are_answered():
    desk, anna = Desk(), sender()
    stop = anna.order("stop")
    done = desk.ask(Query(*stop), Query(*stop), Query(*anna.order("start")))
    assert [(x.status, x.repeated, x.mode) for x in done] == [
        ("done", False, "idle"), ("done", True, "idle"), ("done", False, "idle")
    ]  # fmt: skip
    assert [c.command for c in desk.app.given] == ["stop", "start"] and desk.ear.obeyed == 2
    assert [a.text.split(":")[:2] for a in desk.alerts] == [["shore (anna)", " stop"], ["shore (anna)", " start"]]


def test_what_the_guard_holds_or_refuses_is_answered_so():
    desk, anna = Desk(), sender()
    desk.app.takes = False
    (waits,) = desk.ask(Query(*anna.order("start")))
    desk.app.refusal = "the boat might not stop"
    (no,) = desk.ask(Query(*sender().order("start")))
    assert waits.status == "waiting" and (no.status, no.code) == ("refused", "not_now") and "might not" in no.text


def test_once_the_run_ends_nothing_is_obeyed():
    desk = Desk()
    (no,) = desk.ask(Query(*sender().order("start")), before=lambda: desk.ear.end())  # noqa: PLW0108  (the ear comes later)
    assert no.status == "refused" and not desk.app.given


def test_a_mission_is_loaded_or_refused_with_all_its_errors():
    def text(north_m):
        return f"[[waypoints]]\nnorth_m = 9.0\neast_m = 9.0\n[[waypoints]]\nnorth_m = {north_m}\neast_m = 9.0\n"

    desk, anna = Desk(), sender()
    files = [("pier.toml", text(12)), ("far.toml", text(500)), ("x.toml", text('"a"')), ("x.exe", ""), ("x.plan", "{")]
    fenced = text(12) + "[[fences]]\ninclusion = true\npolygon = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]\n"
    asked = [Query(*anna.order("load_mission", MissionFile(name=n, text=t))) for n, t in [*files, ("f.toml", fenced)]]
    good, *bad = desk.ask(*asked)
    assert good.status == "done" and [x.code for x in bad] == ["bad_mission"] * 5
    assert "waypoint 2 lies 470.5 m beyond the fence" in bad[0].text and "x.toml: waypoints[1].north_m" in bad[1].text
    (new,) = desk.app.given
    assert isinstance(new, NewMission) and new.name == "pier" and new.waypoints[1].north_m == 12.0


def test_a_mission_with_a_corner_that_the_boat_cannot_round_is_refused():
    """It was answered with `loaded`, and the pilot did not take it."""
    corner = ((9.0, 9.0), (15.0, 9.0), (15.0, 10.5))
    tight = "".join(f"[[waypoints]]\nnorth_m = {n}\neast_m = {e}\n" for n, e in corner)
    desk = Desk(vessel="rudder")
    (no,) = desk.ask(Query(*sender().order("load_mission", MissionFile(name="t.toml", text=tight))))
    assert no.code == "bad_mission" and "waypoint 2 cannot be rounded" in no.text and not desk.app.given


def test_refusals_are_counted_answered_and_told_at_powers_of_two():
    desk = Desk()
    answers = desk.ask(*[Query(b"rubbish") for _ in range(20)], Query(None), Query(b"x" * 100_000))
    assert [x.code for x in answers] == ["unsigned"] * 20 + ["malformed", "too_long"]
    assert desk.ear.refused == {"unsigned": 20, "malformed": 1, "too_long": 1} and not desk.app.given
    assert len([a for a in desk.alerts if "not signed" in a.text]) == 5


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.tuples(st.binary(max_size=60), st.none() | st.binary(max_size=40)), min_size=1, max_size=20))
def test_strangers_bytes_never_raise_nor_reach_the_app(sent):
    desk = Desk(key=None)
    answers = desk.ask(*[Query(*each) for each in sent])
    assert all(x.status == "refused" for x in answers) and not desk.app.given
    assert desk.ear.refused.total() == len(sent)


def test_answers_are_signed_for_who_has_the_key_and_for_nobody_else():
    desk, anna = Desk(), sender()
    stop, late = anna.order("stop"), sender(run="another").order("stop")
    forged = Query(stop[0], bytes(32))
    queries = [forged, Query(*stop), Query(*late), Query(*anna.order("hello"))]
    told = desk.ask(*queries)
    assert [x.code for x in told] == ["unsigned", "ok", "wrong_run", "ok"] and [x.run for x in told] == ["run"] * 4
    assert forged.seal is None, "who overhears an order gets no answer that its sender would believe"
    for query in queries[1:]:
        assert anna.believe(query.payload, query.reply_bytes, query.seal) is not None
    assert [c.command for c in desk.app.given] == ["stop"] and desk.ear.refused.total() == 2, "a hello does nothing"


def test_strangers_do_not_crowd_out_the_answer_to_a_stop():
    """The answer thread is held up (a bad network) while a thousand strangers ask."""
    desk, anna, gate = Desk(), sender(), threading.Event()
    first, stop = Query(b"rubbish"), Query(*anna.order("stop"))
    first.hold = gate
    desk.ask(first, *[Query(b"rubbish") for _ in range(1000)], stop, patience_s=0.0, after=gate.set)
    assert stop.dropped.wait(5) and stop.answer[1].status == "done"


def test_runs_that_a_sender_heard_under_this_name_are_told_to_the_boat():
    met = []
    desk, anna = Desk(meet=lambda run, where: met.append((run, where))), sender()
    desk.ask(
        Query(*anna.order("hello", heard=("run", "other"))), Query(*sender(key=bytes(32)).order("hello", heard=("x",)))
    )
    assert met == [("run", "by anna, on shore"), ("other", "by anna, on shore")]


def test_missions_that_no_parser_bears_do_not_shut_the_door():
    """An integer of 5000 digits is a ValueError of Python's own: each such order waited for ever."""
    desk, anna = Desk(), sender()
    file = MissionFile(name="m.toml", text=f"x = {'9' * 5000}")
    queries = [*(Query(*anna.order("load_mission", file)) for _ in range(PENDING + 1)), Query(*anna.order("hold"))]

    async def play():
        ear = ShoreCommands(desk.app, setup().pilot, OrderGate("b", "run", KEY), BoatClock(), desk.alerts.append)
        for query in queries:
            ear(query)
            await asyncio.to_thread(query.dropped.wait, 5)
        await asyncio.sleep(0.05)
        ear.close()
        assert not ear.refused["busy"]

    asyncio.run(play())
    assert [c.command for c in desk.app.given] == ["hold"]


def test_a_busy_loop_is_not_flooded_and_a_stop_still_comes_through():
    """The loop is held up while many believed orders come: only some are kept, and the stop is one of them."""
    desk, anna = Desk(), sender()
    queries = [Query(*anna.order("hold")) for _ in range(30)] + [Query(*anna.order("stop"))]

    async def play():
        ear = ShoreCommands(desk.app, setup().pilot, OrderGate("b", "run", KEY), BoatClock(), desk.alerts.append)
        thread = threading.Thread(target=lambda: [ear(q) for q in queries])
        thread.start()
        thread.join(10)  # the loop does nothing meanwhile
        await asyncio.to_thread(lambda: [q.dropped.wait(5) for q in queries])
        ear.close()
        assert ear.refused["busy"] == 30 - PENDING

    asyncio.run(play())
    assert [c.command for c in desk.app.given] == ["hold"] * PENDING + ["stop"]


def test_a_stop_from_shore_goes_through_the_real_app_and_is_in_its_log(tmp_path):
    bench = Bench(tmp_path / "run.mcap")
    asked, alerts = [], []

    async def story(bench):
        ear = ShoreCommands(bench.app, setup().pilot, OrderGate("b", "run", None), bench.clock, alerts.append)
        await bench.drive()
        anna = Sender("b", "session-1", "anna", None, bench.clock.now_ns)
        anna.hear("run", bench.clock.now_ns())
        driven = bench.app.state.helm.mode, bench.overrides[-1][1]
        text = "[[waypoints]]\nnorth_m = 12.0\neast_m = 9.0\n"
        for command in ("load_mission", "stop", "load_mission", "start"):
            mission = MissionFile(name="pier.toml", text=text) if command == "load_mission" else None
            query = Query(*anna.order(command, mission))
            threading.Thread(target=ear, args=(query,)).start()
            begun_ns = bench.clock.now_ns()
            await bench.run(2.0, until=query.dropped.is_set)
            asked.append((command, query.answer[1], (bench.clock.now_ns() - begun_ns) * 1e-9))
            if command == "stop":
                await bench.run(0.2)
                assert neutral(bench.overrides[-1][1]) and not neutral(driven[1]) and driven[0] == "auto"
        ear.close()

    assert bench.scene(story) is None
    assert [(c, x.status, x.mode) for c, x, _ in asked] == [
        ("load_mission", "refused", "auto"), ("stop", "done", "idle"), ("load_mission", "done", "idle"),
        ("start", "done", "starting"),
    ]  # fmt: skip
    assert [c.command for c in bench.of(OperatorCommand)] == ["start", "stop", "start", "stop"]
    assert bench.app.state.mission.name == "pier"
    assert main(["replay", str(tmp_path / "run.mcap")]) == 0
