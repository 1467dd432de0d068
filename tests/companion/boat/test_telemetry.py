"""Telemetry through real zenoh sessions: nobody there, late joiners, outages; and orders through the real App."""

import asyncio
import re
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.__main__ import main
from companion.boat.clock import BoatClock
from companion.boat.load_run import EXAMPLES
from companion.boat.uplink.orders import PENDING, ShoreCommands
from companion.boat.uplink.telemetry import QUEUE, Telemetry, boat_name, config_of
from companion.core.configuration.run_file import TelemetryLink, load_run
from companion.core.configuration.tables import ConfigError
from companion.core.messages import Alert, LoopTiming, NewMission, OperatorCommand, StateEstimate
from companion.core.pilot.modes import ModeState
from companion.core.preflight.rows import Row
from companion.core.telemetry import structs as shore
from companion.core.telemetry.orders import MissionFile, OrderGate, Sender, read_outcome
from companion.core.telemetry.view import TelemetryView, Who
from tests.companion.boat.app_fixture import Bench, neutral
from tests.support.drive_fixture import setup
from tests.support.zenoh_fixture import console, free_port, router, wait_for

KEY = bytes(range(1, 33))
ROW = Row(area="autopilot", name="FS_ACTION", level="ok", found="2", needed="2", why="w")


def link_to(port, **more):
    return TelemetryLink(connect=(f"tcp/127.0.0.1:{port}",), **more)


@contextmanager
def telemetry(port, **more):
    """A boat's telemetry, started; `told`: its alerts."""
    link, told = link_to(port, **more), []
    view = TelemetryView(setup().pilot, Who("run", "digest", "aritra 0", 0, False), link.rate_Hz)
    made = Telemetry("b", link, config_of(link, Path(), where="run.toml"), view)
    made.start(told.append, lambda: ROWS)
    try:
        yield made, told
    finally:
        made.close()
    assert "telemetry" not in [thread.name for thread in threading.enumerate()]


ROWS = [ROW]


def tick(boat, k):
    """One tick; the estimate's north is its number."""
    t_ns = time.monotonic_ns()
    boat.see(
        StateEstimate(
            t_ns=t_ns, north_m=float(k), east_m=0.0, psi_rad=0.0, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0,
            covariance=(0.0,) * 36, accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={},
            disturbance_n=(0.0, 0.0, 0.0), health="healthy", reason="",
        )
    )  # fmt: skip
    boat.see(LoopTiming(t_ns=t_ns, index=k, lateness_ms=0.1, imu_to_override_ms=5.0))


def ticks(boat, numbers):
    for k in numbers:
        tick(boat, k)
        time.sleep(0.05)


def alert(text):
    return Alert(t_ns=time.monotonic_ns(), level="info", text=text)


# --- telemetry --------------------------------------------------------------------------------------


def test_without_a_router_the_boat_is_told_once_and_waits_for_nothing():
    with telemetry(free_port(), rate_Hz=20.0) as (boat, told):
        spent = []
        for k in range(60):
            begun = time.thread_time()
            tick(boat, k)
            spent.append(time.thread_time() - begun)
            time.sleep(0.05)
        wait_for(lambda: boat.published > 60)
    assert sorted(spent)[len(spent) // 2] < 0.5e-3, "what the loop's thread pays"
    (said,) = told
    assert said.level == "info" and "nobody at tcp/127.0.0.1" in said.text and boat.dropped == 0


def test_a_thread_that_cannot_keep_up_costs_messages_not_memory():
    link = link_to(free_port())
    view = TelemetryView(setup().pilot, Who("run", "digest", "aritra 0", 0, False), 10.0)
    boat = Telemetry("b", link, config_of(link, Path(), where="run.toml"), view)
    for k in range(QUEUE):
        tick(boat, k)
    assert boat.dropped == QUEUE, "of two messages a tick"
    boat.close()


def test_a_late_joiner_gets_history_last_values_and_the_checks():
    port = free_port()
    with router(port), telemetry(port, rate_Hz=20.0, history_s=1.0) as (boat, told):
        wait_for(lambda: told)
        ticks(boat, range(30))
        boat.see(alert("before anybody listened"))
        wait_for(lambda: boat.published > 30)
        with console(port) as shore_side:
            wait_for(lambda: shore_side.of("alert") and shore_side.of("checks") and len(shore_side.of("state")) >= 20)
            assert [s.north_m for s in shore_side.of("state")] == list(range(10, 30)), "a second's worth, bounded"
            assert shore_side.of("alert")[0].text == "before anybody listened"
            assert shore_side.of("checks")[0].rows == (ROW,)
            assert shore_side.of("about")[0].vessel == "aritra" and shore_side.of("path")[0].name == "test"
            last = shore_side.last_values()
            assert shore.decode("state", last["state"]).north_m == 29.0 and "about" in last
            assert shore_side.alive() == {"aritra/b/alive"}
            ticks(boat, range(30, 33))
            wait_for(lambda: shore_side.of("state")[-1].north_m == 32.0)
    assert len(told) == 1 and "is connected" in told[0].text


@pytest.mark.long
@pytest.mark.alone
def test_a_router_that_comes_late_has_the_boat_within_two_seconds():
    """Zenoh's own pause between attempts has grown to 4 s by then."""
    port = free_port()
    with telemetry(port) as (_, told):
        wait_for(lambda: told)
        time.sleep(6.0)
        with router(port):
            wait_for(lambda: any("is connected" in a.text for a in told), 2.0)


def test_what_happened_during_an_outage_is_told_afterwards():
    port = free_port()
    with telemetry(port, rate_Hz=20.0) as (boat, told):
        first = router(port)
        wait_for(lambda: any("connected" in a.text for a in told))
        with console(port) as shore_side:
            ticks(boat, range(5))
            boat.see(alert("before"))
            wait_for(lambda: shore_side.of("alert") and len(shore_side.of("state")) >= 5)
            first.close()
            wait_for(lambda: any("lost" in a.text for a in told))
            ticks(boat, range(5, 15))
            boat.see(alert("during"))
            with router(port):
                k = 15
                while not {"during"} <= {a.text for a in shore_side.of("alert")} and k < 400:
                    ticks(boat, [k])
                    k += 1
                wait_for(lambda: {float(n) for n in range(15)} <= {s.north_m for s in shore_side.of("state")})
    texts = [a.text for a in told]
    assert len(texts) == len(set(texts)) <= 3, texts


def test_the_boat_listens_nowhere_and_scouts_nothing_unless_told(tmp_path):
    (tmp_path / "zenoh.json5").write_text(
        '{listen: {endpoints: ["tcp/[::]:7447"]}, scouting: {multicast: {enabled: true}}}'
    )
    for file in (None, "zenoh.json5"):
        made = config_of(link_to(7447, config=file), tmp_path, where="run.toml")
        assert made.get_json("listen/endpoints") == "[]" and made.get_json("mode") == '"peer"'
        assert made.get_json("scouting/multicast/enabled") == "false" == made.get_json("scouting/gossip/enabled")
        assert made.get_json("connect/endpoints") == '["tcp/127.0.0.1:7447"]'
        assert made.get_json("transport/link/rx/max_message_size") == "1000000"
        assert made.get_json("transport/shared_memory/enabled") == "false"


def test_bad_configuration_names_file_and_key(tmp_path):
    with pytest.raises(ConfigError, match=r"run.toml: telemetry.config: .*missing.json5"):
        config_of(link_to(1, config="missing.json5"), tmp_path, where="run.toml")
    with pytest.raises(ConfigError, match=r"run.toml: telemetry.connect: .*somewhere"):
        config_of(TelemetryLink(connect=("somewhere",)), tmp_path, where="run.toml")


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ("", "telemetry: connect: expected a zenoh endpoint"),
        ('connect = ["tcp/h:1"]\ncommand_key = "k"', "command_key: without commands"),
        ('listen = ["tcp/h:1"]\nmode = "client"', "connect: a client needs a router"),
        ('connect = ["tcp/h:1"]\nboat = "a/b"', "telemetry.boat"),
        ('connect = ["tcp/h:1"]\nrate_Hz = 0', "telemetry.rate_Hz"),
        ('connect = ["tcp/h:1"]\nhistory_s = 1e9', "telemetry.history_s"),
        ('connects = ["tcp/h:1"]', "telemetry.connects: unknown key"),
    ],
)
def test_a_bad_table_in_the_run_file_names_its_key(table, key):
    text = (EXAMPLES / "aritra.toml").read_text() + f"\n[telemetry]\n{table}\n"
    with pytest.raises(ConfigError, match=re.escape(key)) as told:
        load_run(text, name="run.toml")
    assert str(told.value).startswith("run.toml: ")


def test_the_boats_name_in_keys():
    assert boat_name(link_to(1), "My boat / 2") == "My-boat-2"
    assert boat_name(link_to(1, boat="hull-7"), "x") == "hull-7" and boat_name(link_to(1), "***") == "boat"


# --- orders -----------------------------------------------------------------------------------------


class Query:
    """What zenoh hands over, with its answer."""

    def __init__(self, payload, attachment=None):
        self.payload, self.attachment, self.answer, self.dropped = payload, attachment, None, threading.Event()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.drop()

    def reply(self, key, payload, *, encoding):
        assert str(encoding) == "application/json" and self.answer is None
        self.answer = key, read_outcome(payload)

    def drop(self):
        self.dropped.set()


def sender(key=KEY):
    made = Sender("b", "session-1", "anna", key, time.monotonic_ns)
    made.hear("run", time.monotonic_ns())
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

    def __init__(self, key=KEY):
        self.app, self.alerts, self.key = FakeApp(), [], key

    def ask(self, *queries, before=lambda: None):
        """The queries from a thread of zenoh's, in order; their outcomes."""

        async def play():
            self.ear = ShoreCommands(
                self.app, setup().pilot, OrderGate("b", "run", self.key), BoatClock(), self.alerts.append
            )
            before()
            await asyncio.to_thread(lambda: [(self.ear(q), q.dropped.wait(5)) for q in queries])
            await asyncio.sleep(0)
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
    assert "waypoint 1 lies 470.5 m beyond the fence" in bad[0].text and "x.toml: waypoints[1].north_m" in bad[1].text
    (new,) = desk.app.given
    assert isinstance(new, NewMission) and new.name == "pier" and new.waypoints[1].north_m == 12.0


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
