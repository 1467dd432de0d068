"""The console's web server over real sockets, a boat behind real zenoh: who is served what, and orders end to end."""

import asyncio
import contextlib
import json
import time
from types import SimpleNamespace

import aiohttp
import pytest
import zenoh
from aiohttp import web

from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import OrderGate
from companion.shore.console.assets import assets
from companion.shore.console.connection_limits import OF_ADDRESS, REQUEST_S
from companion.shore.console.keys import Keys
from companion.shore.console.live import Console
from companion.shore.console.request_auth import RequestAuth
from companion.shore.console.zenoh_client import ZenohClient, config_of
from tests.support.console_fixture import S, answered, state
from tests.support.zenoh_fixture import config as zenoh_config
from tests.support.zenoh_fixture import free_port

KEY = bytes(range(32))
NAMES = frozenset({"localhost"})


@contextlib.asynccontextmanager
async def serving(*, token=None, keys=True):
    """A console on free ports; .url, .zenoh (its port), .console, .http (a client)."""
    port = free_port()
    hearing = ZenohClient(config_of(None, [], [f"tcp/127.0.0.1:{port}"]))
    console = Console(
        hearing, RequestAuth(NAMES, token), Keys((lambda _: KEY) if keys else None, "anna"), compress=False
    )
    runner = web.AppRunner(console.app, access_log=None, shutdown_timeout=0.2)
    await runner.setup()
    server = await console.serve(runner, "127.0.0.1", 0)
    url = "http://127.0.0.1:{1}".format(*server.sockets[0].getsockname())
    working = asyncio.create_task(console.run())
    try:
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as http:
            yield SimpleNamespace(url=url, zenoh=port, console=console, http=http)
    finally:
        working.cancel()
        await asyncio.gather(working, return_exceptions=True)
        server.close()
        await runner.cleanup()


class Boat:
    """A boat of zenoh's alone: publishes states, answers orders through the real gate. `ahead_ns`: of its clock."""

    def __init__(self, port, name="b", run="run1", ahead_ns=0):
        self.session = zenoh.open(zenoh_config("peer", connect=[f"tcp/127.0.0.1:{port}"]))
        self.name, self.gate, self.obeyed, self.ahead_ns = name, OrderGate(name, run, KEY), [], ahead_ns
        self.held = [
            self.session.liveliness().declare_token(shore.alive_key(name)),
            self.session.declare_queryable(shore.command_key(name), self.answer, complete=True),
        ]

    def tell(self, k):
        told = state(k, run=self.gate.run, t_ns=time.monotonic_ns() + self.ahead_ns)
        self.session.put(shore.telemetry_key(self.name, "state"), shore.encode(told))

    def answer(self, query):
        if command := answered(query, self.gate, time.monotonic_ns() + self.ahead_ns):
            self.obeyed.append(command)


async def until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "not in time"
        await asyncio.sleep(0.02)


def post(desk, body, **headers):
    told = {"Origin": desk.url} | headers
    return desk.http.post(f"{desk.url}/order", json=body, headers={k: v for k, v in told.items() if v})


def test_the_page_and_its_libraries_are_served_with_a_strict_policy():
    async def play():
        async with serving() as desk:
            weight = 0
            for path in ("/", *assets()):
                async with desk.http.get(desk.url + path) as answer:
                    data = await answer.read()
                    assert answer.status == 200 and data, path
                    policy = answer.headers["Content-Security-Policy"]
                    assert "default-src 'none'" in policy and "unsafe" not in policy and "http" not in policy
                    assert answer.headers["X-Content-Type-Options"] == "nosniff"
                    weight += int(answer.headers["Content-Length"])
                    tag = answer.headers["ETag"]
                async with desk.http.get(desk.url + path, headers={"If-None-Match": tag}) as again:
                    assert again.status == 304
            assert weight < 300_000, "for all pages, packed"
            for path in ("/nothing", "/web/../store.py", "/vendor/../../x", "/web/%2e%2e/store.py"):
                async with desk.http.get(desk.url + path) as answer:
                    assert answer.status == 404, path

    asyncio.run(play())


def test_nothing_of_the_page_points_elsewhere():
    for path, asset in assets().items():
        if path.startswith("/web/"):
            text = asset.data.decode()
            assert "http://" not in text.replace("http://www.w3.org/", "") and "https://" not in text, path
            assert "<script>" not in text and "style=" not in text and "innerHTML" not in text, path


def test_other_sites_and_names_are_refused():
    async def play():
        async with serving() as desk:
            body = {"boat": "b", "command": "stop"}
            for headers in ({"Origin": "http://evil.example"}, {"Origin": ""}, {"Host": "evil.example"}):
                async with post(desk, body, **headers) as answer:
                    assert answer.status == 403, headers
            async with desk.http.get(desk.url, headers={"Host": "rebound.example"}) as answer:
                assert answer.status == 403
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await desk.http.ws_connect(f"{desk.url}/ws", origin="http://evil.example")
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await desk.http.ws_connect(f"{desk.url}/ws")
            assert not desk.console.browsers

    asyncio.run(play())


def test_from_the_network_only_with_the_token():
    async def play():
        async with serving(token="sesame-123") as desk:
            for path in ("/", "/?token=wrong", "/web/console.js", "/ws"):
                async with desk.http.get(desk.url + path) as answer:
                    assert answer.status == 403, path
            async with post(desk, {"boat": "b", "command": "stop"}) as answer:
                assert answer.status == 403
            async with desk.http.get(f"{desk.url}/?token=sesame-123") as answer:
                assert answer.status == 200 and "token" not in str(answer.url), "it does not stay in the address"
            async with desk.http.get(f"{desk.url}/web/console.js") as answer:
                assert answer.status == 200

    asyncio.run(play())


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (b"{}", 400), (b"rubbish", 400), (b'{"boat":"b","command":"explode"}', 400), (b"\xff", 400),
        (b'{"boat":"a/b","command":"stop"}', 400), (b'{"boat":"b","command":"load_mission"}', 400),
        (b'{"boat":"b","command":"stop","mission":{"name":"x","text":"y"}}', 400), (b"x" * 300_000, 413),
    ],
)  # fmt: skip
def test_malformed_orders_are_refused(data, status):
    async def play():
        async with serving() as desk:
            headers = {"Origin": desk.url, "Content-Type": "application/json"}
            async with desk.http.post(f"{desk.url}/order", data=data, headers=headers) as answer:
                assert answer.status == status
            headers["Content-Type"] = "text/plain"
            stop = b'{"boat":"b","command":"stop"}'
            async with desk.http.post(f"{desk.url}/order", data=stop, headers=headers) as no:
                assert no.status == 415, "what a form can send is not believed"

    asyncio.run(play())


async def heard(socket, enough, seconds=20.0):
    """Messages of a page's WebSocket until `enough` is true of them."""
    told, end = [], time.monotonic() + seconds
    while not enough(told):
        assert time.monotonic() < end, told[-3:]
        told.append(await socket.receive_json(timeout=5))
    return told


def samples(told):
    return [e for message in told if message["type"] == "samples" for e in message["samples"]]


def test_a_boat_reaches_the_page_and_the_pages_order_the_boat():
    async def play():
        async with serving() as desk:
            boat = await asyncio.to_thread(Boat, desk.zenoh)
            try:
                await until(lambda: "b" in desk.console.store.boats and desk.console.store.boats["b"].alive)
                async with desk.http.ws_connect(f"{desk.url}/ws", origin=desk.url) as socket:
                    told = await heard(socket, lambda told: any(m.get("clocks", {}).get("b") for m in told))
                    assert told[0]["type"] == "console" and told[0]["commands"] and told[0]["problem"] == ""
                    await socket.send_str(json.dumps({"choose": "b"}))
                    await socket.send_str("rubbish")
                    for k in range(5):
                        boat.tell(k)
                        await asyncio.sleep(0.05)
                    told = await heard(socket, lambda told: len(samples(told)) >= 5)
                    assert [e["sample"]["north_m"] for e in samples(told)] == [0, 1, 2, 3, 4]
                    async with post(desk, {"boat": "b", "command": "stop"}) as answer:
                        given = await answer.json()
                    assert given["state"] == "answered" and given["outcome"]["text"] == "stop: heard", given
                    assert boat.obeyed == ["stop"]
                    told = await heard(socket, lambda told: any(m.get("state") == "answered" for m in told))
                    assert "sending" in [m.get("state") for m in told], "every page sees what another one ordered"
                    await asyncio.to_thread(boat.session.close)
                    await until(lambda: not desk.console.store.boats["b"].alive)
            finally:
                await asyncio.to_thread(boat.session.close)

    asyncio.run(play())


def test_a_stop_reaches_both_programs_of_a_name_and_a_start_neither():
    async def play():
        async with serving() as desk:
            left = await asyncio.to_thread(Boat, desk.zenoh, run="run0", ahead_ns=-3600 * S)
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
        async with serving() as desk:
            boat = await asyncio.to_thread(Boat, desk.zenoh)
            await until(lambda: "b" in desk.console.store.boats)
            forged = [state(0, run="forged", t_ns=10), state(0, run="run1", t_ns=time.monotonic_ns() + 3600 * S)]
            for k, sample in enumerate(forged):
                boat.tell(k)
                boat.session.put(shore.telemetry_key("b", "state"), shore.encode(sample))
                await asyncio.sleep(0.3)
                async with post(desk, {"boat": "b", "command": "stop"}) as answer:
                    given = await answer.json()
                assert given["outcome"]["status"] == "done" and given["after_ms"] < 900, given
            await asyncio.to_thread(boat.session.close)
            assert boat.obeyed == ["stop", "stop"]

    asyncio.run(play())


def test_stop_all_goes_to_each_at_once_whoever_of_them_is_dead():
    async def play():
        async with serving() as desk:
            boat = await asyncio.to_thread(Boat, desk.zenoh)
            await until(lambda: "b" in desk.console.store.boats)
            names = [f"dead-{k}" for k in range(60)]
            begun = time.monotonic()
            headers = {"Origin": desk.url}
            async with desk.http.post(f"{desk.url}/stop", json={"boats": [*names, "b"]}, headers=headers) as answer:
                given = await answer.json()
            assert [each["boat"] for each in given] == [*names, "b"] and {e["state"] for e in given} == {"sending"}
            await until(lambda: boat.obeyed, 1.0)
            assert time.monotonic() - begun < 1.0
            await asyncio.to_thread(boat.session.close)

    asyncio.run(play())


def test_half_sent_requests_end_and_a_stop_goes_through_meanwhile():
    """A thousand of them used up the console's sockets: there was no limit, and no time-out."""

    async def play():
        async with serving() as desk:
            boat = await asyncio.to_thread(Boat, desk.zenoh)
            await until(lambda: "b" in desk.console.store.boats)
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
            await asyncio.to_thread(boat.session.close)

    asyncio.run(play())


def test_a_flood_of_samples_keeps_no_stop_waiting():
    async def play():
        async with serving() as desk:
            boat = await asyncio.to_thread(Boat, desk.zenoh)
            await until(lambda: "b" in desk.console.store.boats)
            data = shore.encode(state(1, run="flood"))

            def flood():
                for k in range(40_000):
                    boat.session.put(shore.telemetry_key(f"spoof-{k % 500}", "state"), data)

            flooding = asyncio.create_task(asyncio.to_thread(flood))
            await asyncio.sleep(0.3)
            async with post(desk, {"boat": "b", "command": "stop"}) as answer:
                given = await answer.json()
            await flooding
            await asyncio.to_thread(boat.session.close)
            assert given["outcome"]["status"] == "done" and given["after_ms"] < 900, given

    asyncio.run(play())


def test_a_console_without_a_key_orders_nothing():
    async def play():
        async with serving(keys=False) as desk:
            boat = await asyncio.to_thread(Boat, desk.zenoh)
            await until(lambda: "b" in desk.console.store.boats)
            boat.tell(0)
            async with post(desk, {"boat": "b", "command": "stop"}) as answer:
                given = await answer.json()
            await asyncio.to_thread(boat.session.close)
            assert given["state"] == "not_sent" and not boat.obeyed

    asyncio.run(play())
