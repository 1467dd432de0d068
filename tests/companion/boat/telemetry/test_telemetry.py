"""Telemetry through real zenoh sessions: nobody there, late joiners, outages."""

import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from companion.boat.uplink.telemetry import QUEUE, Telemetry, config_of
from companion.core.messages import Alert, LoopTiming, StateEstimate
from companion.core.preflight.rows import Row
from companion.core.telemetry import structs as shore
from companion.core.telemetry.view import TelemetryView, Who
from tests.companion.boat.telemetry.telemetry_fixture import link_to
from tests.support.drive_fixture import setup
from tests.support.zenoh_fixture import console, free_port, router, wait_for

ROW = Row(area="autopilot", name="FS_ACTION", level="ok", found="2", needed="2", why="w")


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


@pytest.mark.long
def test_without_a_router_the_boat_is_told_once_and_waits_for_nothing(monkeypatch):
    threads, encode = [], shore.encode

    def noted(message):
        threads.append(threading.current_thread().name)
        return encode(message)

    monkeypatch.setattr(shore, "encode", noted)
    with telemetry(free_port(), rate_Hz=20.0) as (boat, told):
        ticks(boat, range(60))
        wait_for(lambda: boat.published > 60)
    assert len(threads) > 60 and set(threads) == {"telemetry"}, "the loop's thread leaves messages in the queue"
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


@pytest.mark.long
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
@pytest.mark.real_time
def test_a_router_that_comes_late_has_the_boat_within_two_seconds():
    """Zenoh's own pause between attempts has grown to 4 s by then."""
    port = free_port()
    with telemetry(port) as (_, told):
        wait_for(lambda: told)
        time.sleep(6.0)
        with router(port):
            wait_for(lambda: any("is connected" in a.text for a in told), 2.0)


@pytest.mark.long
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
