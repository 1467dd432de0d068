"""A console served in the test's own loop, and boats of zenoh's alone behind it."""

from __future__ import annotations

import asyncio
import contextlib
import time
from types import SimpleNamespace

import aiohttp
import zenoh
from aiohttp import web

from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import OrderGate
from companion.shore.console.keys import Keys
from companion.shore.console.live import Console
from companion.shore.console.request_auth import RequestAuth
from companion.shore.console.zenoh_client import ZenohClient, config_of
from tests.support.console_fixture import answer_as_a_boat, state
from tests.support.zenoh_fixture import config as zenoh_config
from tests.support.zenoh_fixture import free_port

KEY = bytes(range(32))
NAMES = frozenset({"localhost"})


@contextlib.asynccontextmanager
async def serving(*, token=None, keys=True, logs=None):
    """A console on free ports; .url, .zenoh (its port), .console, .http (a client)."""
    port = free_port()
    hearing = ZenohClient(config_of(None, [], [f"tcp/127.0.0.1:{port}"]))
    signers = Keys((lambda _: KEY) if keys else None, "anna")
    console = Console(hearing, RequestAuth(NAMES, token), signers, compress=False, logs=logs)
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
        answer_as_a_boat(query, self.gate, time.monotonic_ns() + self.ahead_ns, self.obeyed)


async def until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "not in time"
        await asyncio.sleep(0.02)


def post(desk, body, **headers):
    told = {"Origin": desk.url} | headers
    return desk.http.post(f"{desk.url}/order", json=body, headers={k: v for k, v in told.items() if v})


def posted(path: str, body: object, **headers: str) -> tuple[int, object]:
    """What a console answers to `body` at `path`: status, and the JSON where it is 200, else the text."""

    async def play():
        async with serving() as desk:
            told = {"Origin": desk.url} | headers
            async with desk.http.post(f"{desk.url}/{path}", json=body, headers=told) as answer:
                return answer.status, await (answer.json() if answer.status == 200 else answer.text())

    return asyncio.run(play())
