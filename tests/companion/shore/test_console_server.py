"""The console's web server over real sockets, a boat behind real zenoh: who is served what, and orders end to end."""

import asyncio
import json
import time

import aiohttp
import pytest

from companion.shore.console.assets import assets
from tests.support.console_server_fixture import Boat, post, serving, until


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
            outside = ("/web/../store.py", "/web/vendor/../../x", "/web/vendor/vendor.toml", "/web/%2e%2e/store.py")
            for path in ("/nothing", *outside):
                async with desk.http.get(desk.url + path) as answer:
                    assert answer.status == 404, path

    asyncio.run(play())


def test_nothing_of_the_page_points_elsewhere():
    for path, asset in assets().items():
        if not path.startswith("/web/vendor/"):  # comments there name their makers; see test_vendored.py
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


def test_a_second_console_of_this_machine_does_not_shut_out_the_first():
    """Browsers keep one jar of cookies for all ports of a host."""

    async def play():
        async with serving(token="sesame-123") as first, serving(token="barley-456") as second:
            for desk, token in ((first, "sesame-123"), (second, "barley-456")):
                async with first.http.get(f"{desk.url}/?token={token}") as answer:
                    assert answer.status == 200
            for desk in (first, second):
                async with first.http.get(f"{desk.url}/web/console.js") as answer:
                    assert answer.status == 200

    asyncio.run(play())


@pytest.mark.parametrize(
    ("path", "order", "status"),
    [
        ("/order", {"command": "start"}, 408), ("/order", {"command": "hold"}, 408),
        ("/order", {"command": "stop"}, 200),
        ("/drive_there", {"mission": {"name": "x", "text": "y"}, "leave": False}, 408),
    ],
)  # fmt: skip
def test_an_order_that_the_network_held_up_moves_nothing_and_a_stop_is_never_late(path, order, status):
    async def play():
        async with serving() as desk:
            for late_s, expected in ((30.0, status), (1.0, 200)):
                body = {"boat": "b", "given_ms": (time.monotonic() - late_s) * 1e3} | order
                async with desk.http.post(desk.url + path, json=body, headers={"Origin": desk.url}) as answer:
                    assert answer.status == expected
                    assert expected == 200 or "30 s ago" in await answer.text()

    asyncio.run(play())


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (b"{}", 400), (b"rubbish", 400), (b'{"boat":"b","command":"explode"}', 400), (b"\xff", 400),
        (b'{"boat":"\xff"}', 400),
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
