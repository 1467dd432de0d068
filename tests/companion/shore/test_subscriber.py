"""Shore's ear: what boats publish and what they kept, whenever it is opened."""

import asyncio
import threading
import time
from contextlib import contextmanager

import pytest
import zenoh

from companion.core.telemetry import structs as shore
from companion.shore.console.zenoh_client import ZenohClient, config_of
from companion.shore.subscriber import listen
from tests.companion.boat.telemetry.test_telemetry import telemetry, tick
from tests.support.zenoh_fixture import config, free_port, router, wait_for


@contextmanager
def running(boat):
    """The boat's ticks, at 20 Hz."""
    ended = threading.Event()

    def play():
        k = 0
        while not ended.wait(0.05):
            tick(boat, k)
            k += 1

    thread = threading.Thread(target=play)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextmanager
def ear(port, **which):
    """Numbers of the states heard, as they came."""
    heard = []

    def note(sample):
        if str(sample.key_expr).endswith("/state"):
            heard.append(shore.decode("state", bytes(sample.payload)).north_m)

    with zenoh.open(config("client", connect=[f"tcp/127.0.0.1:{port}"])) as session:
        held = listen(session, note, **which)
        yield heard
        del held


def whole(heard):
    """Everything from the first on."""
    return bool(heard) and set(heard) >= set(map(float, range(int(max(heard)))))


@pytest.mark.long
def test_whenever_it_is_opened_history_is_whole():
    """A live sample often comes before the kept ones: it must not make them out of date."""
    port = free_port()
    with router(port), telemetry(port, rate_Hz=20.0) as (boat, told):
        wait_for(lambda: told)
        with running(boat):
            time.sleep(1.0)
            for _ in range(15):
                with ear(port) as heard:
                    wait_for(lambda h=heard: whole(h), 5.0, lambda h=heard: sorted(h)[:5])


@pytest.mark.long
def test_a_boat_that_comes_later_is_heard_with_what_it_kept():
    port = free_port()
    with telemetry(port, rate_Hz=20.0) as (boat, told), running(boat):
        time.sleep(1.0)
        with router(port), ear(port) as heard:
            wait_for(lambda: whole(heard) and max(heard) > 20, 20.0, lambda: sorted(heard)[:5])
    assert any("nobody at" in a.text for a in told)


@pytest.mark.parametrize(("which", "hears"), [({"boat": "b", "topic": "state"}, True), ({"boat": "c"}, False)])
@pytest.mark.long
def test_one_boat_or_topic_alone(which, hears):
    port = free_port()
    with router(port), telemetry(port, rate_Hz=20.0) as (boat, told):
        wait_for(lambda: told)
        with running(boat), ear(port, **which) as heard:
            time.sleep(1.0)
            assert bool(heard) == hears


@pytest.mark.long
def test_the_console_hears_through_a_router():
    """It is a client then: a peer would be connected and hear nothing."""
    port = free_port()

    async def heard_of(hearing):
        running = asyncio.create_task(hearing.run())
        try:
            async with asyncio.timeout(20.0):
                while "state" not in {h.topic for h in hearing.take()}:
                    await asyncio.sleep(0.05)
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    with router(port), telemetry(port, rate_Hz=20.0) as (boat, told):
        wait_for(lambda: told)
        with running(boat):
            asyncio.run(heard_of(ZenohClient(config_of(None, [f"tcp/127.0.0.1:{port}"], []))))
