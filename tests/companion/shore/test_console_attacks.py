"""What once kept a STOP from a boat, at a console with real sockets and a boat behind real zenoh."""

import asyncio
import time
from contextlib import asynccontextmanager
from itertools import count
from threading import Event

import aiohttp
import pytest

from companion.core.telemetry import structs as shore
from companion.shore.console.connection_limits import OF_ADDRESS, REQUEST_S
from tests.support.console_fixture import S, state
from tests.support.console_server_fixture import Boat, post, serving, until


@asynccontextmanager
async def serving_a_boat():
    """A console that hears one boat."""
    async with serving() as desk:
        boat = await asyncio.to_thread(Boat, desk.zenoh)
        await until(lambda: "b" in desk.console.store.boats)
        try:
            yield desk, boat
        finally:
            await asyncio.to_thread(boat.session.close)


def test_a_stop_reaches_both_programs_of_a_name_and_a_start_neither():
    async def play():
        async with serving() as desk:
            left = await asyncio.to_thread(Boat, desk.zenoh, run="run0", ahead_ns=3600 * S)
            boat = await asyncio.to_thread(Boat, desk.zenoh)
            await until(lambda: "b" in desk.console.store.boats)
            await asyncio.sleep(0.5)
            boat.tell(0)
            async with post(desk, {"boat": "b", "command": "start"}) as answer:
                given = await answer.json()
            assert given["state"] == "not_sent" and "several programs call themselves b" in given["why"], given
            for k in range(5):
                async with post(desk, {"boat": "b", "command": "stop"}) as answer:
                    assert (await answer.json())["outcome"]["status"] == "done"
                await until(lambda k=k: len(boat.obeyed) == len(left.obeyed) == k + 1)
            for each in (left, boat):
                await asyncio.to_thread(each.session.close)
            assert boat.obeyed == left.obeyed == ["stop"] * 5

    asyncio.run(play())


@pytest.mark.long
def test_after_a_second_program_came_and_went_stop_and_start_still_go_to_the_first():
    """It was refused as `wrong_run` for good."""

    async def play():
        async with serving() as desk:
            boat = await asyncio.to_thread(Boat, desk.zenoh)
            second = await asyncio.to_thread(Boat, desk.zenoh, run="run2", ahead_ns=3600 * S)
            await until(lambda: "b" in desk.console.store.boats)
            record = desk.console.store.boats["b"]
            for k in range(30):
                boat.tell(k)
                second.tell(k)
                await asyncio.sleep(0.1)
            assert len(record.runs(time.monotonic_ns())) == 2
            await asyncio.to_thread(second.session.close)
            for k in range(40):
                boat.tell(k)
                await asyncio.sleep(0.1)
            assert record.runs(time.monotonic_ns()) == ("run1",)
            for command in ("stop", "start"):
                async with post(desk, {"boat": "b", "command": command}) as answer:
                    assert (await answer.json())["outcome"]["status"] == "done"
            await asyncio.to_thread(boat.session.close)
            assert boat.obeyed == ["stop", "start"] and not second.obeyed

    asyncio.run(play())


def test_one_unsigned_sample_of_another_run_or_an_hour_ahead_refuses_no_stop():
    async def play():
        async with serving_a_boat() as (desk, boat):
            forged = [state(0, run="forged", t_ns=10), state(0, run="run1", t_ns=time.monotonic_ns() + 3600 * S)]
            for k, sample in enumerate(forged):
                boat.tell(k)
                boat.session.put(shore.telemetry_key("b", "state"), shore.encode(sample))
                await asyncio.sleep(0.3)
                async with post(desk, {"boat": "b", "command": "stop"}) as answer:
                    given = await answer.json()
                assert given["outcome"]["status"] == "done" and given["after_ms"] < 900, given
            assert boat.obeyed == ["stop", "stop"]

    asyncio.run(play())


def test_stop_all_goes_to_each_at_once_whoever_of_them_is_dead():
    async def play():
        async with serving_a_boat() as (desk, boat):
            names = [f"dead-{k}" for k in range(60)]
            headers = {"Origin": desk.url}
            async with desk.http.post(f"{desk.url}/stop", json={"boats": [*names, "b"]}, headers=headers) as answer:
                given = await answer.json()
            assert [each["boat"] for each in given] == [*names, "b"] and {e["state"] for e in given} == {"sending"}
            await until(lambda: boat.obeyed, 5.0)  # one after the other would take the patience of sixty

    asyncio.run(play())


@pytest.mark.long
def test_half_sent_requests_end_and_a_stop_goes_through_meanwhile():
    """A thousand of them used up the console's sockets: there was no limit, and no time-out."""

    async def play():
        async with serving_a_boat() as (desk, _):
            _, host, port = desk.url.replace("/", "").split(":")
            writers = []
            for _ in range(300):
                _, writer = await asyncio.open_connection(host, int(port))
                writer.write(b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ")
                writers.append(writer)
            limits = desk.console.limits
            await until(lambda: limits.ended >= 300 - OF_ADDRESS)
            async with aiohttp.ClientSession() as fresh:
                stop = {"boat": "b", "command": "stop"}
                async with fresh.post(f"{desk.url}/order", json=stop, headers={"Origin": desk.url}) as answer:
                    assert (await answer.json())["outcome"]["status"] == "done"
                await until(lambda: limits.ended >= 300, REQUEST_S + 5.0)
                async with fresh.post(f"{desk.url}/order", json=stop, headers={"Origin": desk.url}) as answer:
                    assert answer.status == 200, "one that has asked stays"
            for writer in writers:
                writer.close()

    asyncio.run(play())


@pytest.mark.real_time
def test_a_flood_of_samples_keeps_no_stop_waiting():
    """The flood goes on until the STOP is answered; a busy machine may want a second order, as a person would give."""

    async def play():
        async with serving_a_boat() as (desk, boat):
            data, over = shore.encode(state(1, run="flood")), Event()

            def flood():
                for k in count():
                    boat.session.put(shore.telemetry_key(f"spoof-{k % 500}", "state"), data)
                    if over.is_set():
                        return

            flooding = asyncio.create_task(asyncio.to_thread(flood))
            try:
                await asyncio.sleep(0.3)
                for _ in range(5):
                    async with post(desk, {"boat": "b", "command": "stop"}) as answer:
                        given = await answer.json()
                    if given["outcome"]:
                        break
            finally:
                over.set()
                await flooding
            assert given["outcome"]["status"] == "done" and "stop" in boat.obeyed, given

    asyncio.run(play())
