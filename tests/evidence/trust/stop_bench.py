"""STOP at a console in this process, with real sockets and zenoh; router, boat and attackers around it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable

import aiohttp
from aiohttp import web

from companion.python_child import python
from companion.shore.console.keys import Keys
from companion.shore.console.live import Console
from companion.shore.console.request_auth import RequestAuth
from companion.shore.console.zenoh_client import ZenohClient, config_of
from tests.evidence.main_job.parts import ROOT
from tests.evidence.trust.stop_attacks import BOAT, KEY, RUN
from tests.support.zenoh_fixture import free_port, router

PATIENCE_S = 12.0
STAYS_S = 0.15
"""So long neutral must last to count: a tick and a half."""


class Program:
    """A program of this folder that is talked with by lines."""

    def __init__(self, name: str, *words: object) -> None:
        command = python("-m", f"tests.evidence.trust.{name}", *words)
        env = os.environ | {"PYTHONPATH": str(ROOT)}
        pipe = subprocess.PIPE
        self._child = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=env, cwd="/")

    def say(self, word: str) -> None:
        """One line to it."""
        assert self._child.stdin
        self._child.stdin.write(f"{word}\n")
        self._child.stdin.flush()

    def hear(self) -> str:
        """One line from it; empty: it has ended."""
        assert self._child.stdout
        return self._child.stdout.readline().strip()

    def close(self) -> None:
        """End it."""
        self._child.kill()
        self._child.wait()


class Attackers(Program):
    """The program of `stop_attacks`."""

    def __init__(self, port: int, web_port: int, run: str = RUN) -> None:
        super().__init__("stop_attacks", port, web_port, run)
        assert self.hear() == "ready"

    def ask(self, word: str) -> str:
        """Say a word; what is answered."""
        self.say(word)
        line = self.hear()
        assert line, "the attackers' program ended"
        return line

    async def begin(self, *names: str) -> None:
        """Attacks, until `end`."""
        assert await asyncio.to_thread(self.ask, ",".join(names)) == "ready"

    async def end(self) -> tuple[int, int, int]:
        """Stops and other orders that twins obeyed, and how many twins there were."""
        stops, others, twins = map(int, (await asyncio.to_thread(self.ask, "end")).split())
        return stops, others, twins


class Boat(Program):
    """The program of `stop_boat`. `still`: whether neutral is on its wire; `since_ns`: since when."""

    def __init__(self, port: int) -> None:
        super().__init__("stop_boat", port)
        self.still, self.since_ns, self.counts = True, 0, (0, 0)
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        while line := self.hear():
            word, *numbers = line.split()
            if word == "counts":
                self.counts = int(numbers[0]), int(numbers[1])
            elif word in ("still", "moving"):
                self.still, self.since_ns = word == "still", int(numbers[0])


class Water:
    """`boat`, `attackers`; `console` and its page at `url`, `http`: a page's lines."""

    def __init__(
        self, boat: Boat, attackers: Attackers, console: Console, http: aiohttp.ClientSession, url: str
    ) -> None:
        self.boat, self.attackers, self.console, self.http, self.url = boat, attackers, console, http, url

    async def drive(self) -> None:
        """The mission from its beginning, until thrusters turn."""
        self.boat.say("drive")
        await until(lambda: not self.boat.still, 30.0)

    async def post(self, path: str, body: object, http: aiohttp.ClientSession | None = None):
        """What the console makes of an order."""
        headers = {"Origin": self.url}
        async with (http or self.http).post(f"{self.url}{path}", json=body, headers=headers) as answer:
            return await answer.json()

    async def stop_s(self, boats: list[str]) -> float:
        """From a page's STOP, over a line of its own, to neutral that lasts [s]; infinite: it did not come."""
        begun_ns = time.monotonic_ns()
        async with aiohttp.ClientSession() as fresh:
            await self.post("/stop", {"boats": boats}, fresh)
        while (now_ns := time.monotonic_ns()) - begun_ns < PATIENCE_S * 1e9:
            if self.boat.still and now_ns - self.boat.since_ns > STAYS_S * 1e9:
                return max(self.boat.since_ns - begun_ns, 0) * 1e-9
            await asyncio.sleep(0.005)
        return float("inf")


async def counts(water: Water) -> tuple[int, int]:
    """Orders that the boat refused as unsigned, and its alerts of a shared name."""
    water.boat.counts = (-1, -1)
    water.boat.say("counts")
    await until(lambda: water.boat.counts[0] >= 0, 10.0)
    return water.boat.counts


async def until(condition: Callable[[], object], seconds: float) -> None:
    """Until it is true. Raises AssertionError when it was not in time."""
    end_s = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end_s, f"not within {seconds:g} s"
        await asyncio.sleep(0.005)


@contextlib.asynccontextmanager
async def shore(port: int, find: Callable[[str], bytes | None] = lambda _: KEY) -> AsyncIterator[tuple[Console, int]]:
    """A console that is a client of the router at `port`; and the port of its page."""
    config = config_of(None, [f"tcp/127.0.0.1:{port}"], [])
    keys = Keys(find, "anna")
    console = Console(ZenohClient(config), RequestAuth(frozenset(), None), keys, compress=False)
    runner = web.AppRunner(console.app, access_log=None, shutdown_timeout=0.2)
    await runner.setup()
    server = await console.serve(runner, "127.0.0.1", 0)
    working = asyncio.create_task(console.run())
    try:
        yield console, server.sockets[0].getsockname()[1]
    finally:
        working.cancel()
        await asyncio.gather(working, return_exceptions=True)
        server.close()
        await runner.cleanup()


def at_sea(story: Callable[[Water], Awaitable[None]]) -> None:
    """Play a story at a boat and its console."""
    port = free_port()

    async def play() -> None:
        async with shore(port) as (console, web_port), aiohttp.ClientSession() as http:
            with contextlib.closing(Boat(port)) as boat:
                await until(lambda: console.known.runs(BOAT), 60.0)
                with contextlib.closing(Attackers(port, web_port)) as attackers:
                    water = Water(boat, attackers, console, http, f"http://127.0.0.1:{web_port}")
                    await water.drive()  # once, so that all is compiled
                    await water.stop_s([BOAT])
                    await story(water)

    with router(port):
        asyncio.run(play())
