"""A boat that drives, its console, and a router between them: the real App, uplink, gate, console and zenoh.

All in one loop. The App stands on the stepped clock, which is moved on as real time passes, the simulated world at the
far end of its cables. Attackers are another process (`stop_attacks`).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import aiohttp
from aiohttp import web

from companion.boat.uplink.name_collision import NameCollisions
from companion.boat.uplink.order_receiver import ShoreCommands
from companion.boat.uplink.telemetry import Telemetry, config_of
from companion.cli.boat.run import GIL_S
from companion.core.configuration.run_file import TelemetryLink
from companion.core.messages import Alert, NewMission, OperatorCommand
from companion.core.telemetry.order_gate import OrderGate
from companion.core.telemetry.topics import points_of
from companion.core.telemetry.view import TelemetryView, Who
from companion.python_child import python
from companion.shore.console.keys import Keys
from companion.shore.console.live import Console
from companion.shore.console.request_auth import RequestAuth
from companion.shore.console.zenoh_client import ZenohClient
from companion.shore.console.zenoh_client import config_of as console_config
from sim.world.world import STEP_NS
from tests.companion.boat.app_fixture import Bench, neutral
from tests.evidence.main_job.parts import ROOT
from tests.evidence.trust.stop_attacks import BOAT
from tests.support.drive_fixture import setup
from tests.support.zenoh_fixture import free_port, router

KEY = bytes(range(7, 39))
RUN = "0123456789ab"
PATIENCE_S = 12.0
STAYS_S = 0.12
"""So long neutral must last to count: a tick and a bit."""


class Water:
    """`bench`: the boat; `ear`: its receiver of orders; `console`, `http`, `url`: the shore; `alerts`: the boat's."""

    def __init__(self, bench: Bench, console: Console, http: aiohttp.ClientSession, port: int, web_port: int) -> None:
        self.bench, self.console, self.http, self.port, self.web_port = bench, console, http, port, web_port
        self.url = f"http://127.0.0.1:{web_port}"
        self.alerts: list[Alert] = []
        self.ear: ShoreCommands

    @property
    def still(self) -> bool:
        """Whether the newest override on the wire is neutral."""
        m = next(m for _, m in reversed(self.bench.sent) if m.get_type() == "RC_CHANNELS_OVERRIDE")
        return neutral(tuple(getattr(m, f"chan{n}_raw") for n in range(1, 13)))

    async def drive(self) -> None:
        """The mission from its beginning, until thrusters turn."""
        now, mission = self.bench.clock.now_ns(), setup().pilot.mission
        self.bench.app.load(NewMission(t_ns=now, name="square", waypoints=points_of(mission), end_heading_rad=None))
        self.bench.app.command(OperatorCommand(t_ns=now, command="start"))
        await until(lambda: self.bench.mode == "auto" and not self.still, 20.0)

    async def post(self, path: str, body: object, http: aiohttp.ClientSession | None = None):
        """What the console makes of an order."""
        headers = {"Origin": self.url}
        async with (http or self.http).post(f"{self.url}{path}", json=body, headers=headers) as answer:
            return await answer.json()

    async def stop_s(self, boats: list[str]) -> float:
        """From a page's STOP, over a line of its own, to neutral that lasts [s]; infinite: it did not come."""
        begun_s = time.monotonic()
        async with aiohttp.ClientSession() as fresh:
            await self.post("/stop", {"boats": boats}, fresh)
        while (now_s := time.monotonic()) - begun_s < PATIENCE_S:
            if self.still:
                await asyncio.sleep(STAYS_S)
                if self.still and self.bench.mode == "idle":
                    return now_s - begun_s
            await asyncio.sleep(0.002)
        return float("inf")


async def until(condition: Callable[[], object], seconds: float) -> None:
    """Until it is true. Raises AssertionError when it was not in time."""
    end_s = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end_s, f"not within {seconds:g} s"
        await asyncio.sleep(0.005)


@contextlib.asynccontextmanager
async def shore(port: int, find: Callable[[str], bytes | None] = lambda _: KEY) -> AsyncIterator[tuple[Console, int]]:
    """A console that is a client of the router at `port`; and the port of its page."""
    config = console_config(None, [f"tcp/127.0.0.1:{port}"], [])
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

    async def play(bench: Bench) -> None:
        link = TelemetryLink(connect=(f"tcp/127.0.0.1:{port}",), commands=True)
        view = TelemetryView(setup().pilot, Who(RUN, "digest", "aritra 0", 0, commands=True), link.rate_Hz)
        telemetry = Telemetry(BOAT, link, config_of(link, Path(), where="evidence"), view)
        async with shore(port) as (console, web_port), aiohttp.ClientSession() as http:
            water = Water(bench, console, http, port, web_port)
            names = NameCollisions(BOAT, RUN, bench.clock.now_ns, water.alerts.append)
            gate = OrderGate(BOAT, RUN, KEY)
            ear = water.ear = ShoreCommands(
                bench.app, setup().pilot, gate, bench.clock, water.alerts.append, names.meet
            )
            telemetry.start(water.alerts.append, tuple, ear, names.hear)
            bench.on_watch = telemetry.see
            pacing = asyncio.create_task(_pace(bench))
            try:
                await until(lambda: console.runs(BOAT) and _behind_ns(bench) < 2 * STEP_NS, 60.0)
                await story(water)
            finally:
                pacing.cancel()
                await asyncio.gather(pacing, return_exceptions=True)
                bench.on_watch = None
                telemetry.close()
                ear.close()

    before_s = sys.getswitchinterval()
    with tempfile.TemporaryDirectory() as folder, router(port), contextlib.ExitStack() as held:
        sys.setswitchinterval(GIL_S)  # as a run has it
        held.callback(sys.setswitchinterval, before_s)
        ended = Bench(Path(folder) / "run.mcap", begin_ns=time.monotonic_ns()).scene(play)
    assert ended is None, ended


def _behind_ns(bench: Bench) -> int:
    return time.monotonic_ns() - bench.clock.now_ns()


async def _pace(bench: Bench) -> None:
    """The stepped clock goes as the real one does."""
    while True:
        if _behind_ns(bench) > STEP_NS:
            await bench.run(STEP_NS * 1e-9)
        else:
            await asyncio.sleep(0.001)


class Attackers:
    """The other process."""

    def __init__(self, port: int, web_port: int, run: str = RUN) -> None:
        words = ("-m", "tests.evidence.trust.stop_attacks", port, web_port, KEY.hex(), run)
        env = os.environ | {"PYTHONPATH": str(ROOT)}
        self._child = subprocess.Popen(
            python(*words), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env, cwd="/"
        )
        self.ask("")

    def ask(self, word: str) -> str:
        """Say a word; what is answered."""
        assert self._child.stdin and self._child.stdout
        if word:
            self._child.stdin.write(f"{word}\n")
            self._child.stdin.flush()
        line = self._child.stdout.readline()
        assert line, "the attackers' program ended"
        return line.strip()

    async def begin(self, *names: str) -> None:
        """Attacks, until `end`."""
        assert await asyncio.to_thread(self.ask, ",".join(names)) == "ready"

    async def end(self) -> tuple[int, int, int]:
        """Stops and other orders that twins obeyed, and how many twins there were."""
        stops, others, twins = map(int, (await asyncio.to_thread(self.ask, "end")).split())
        return stops, others, twins

    def close(self) -> None:
        """End the process."""
        self._child.kill()
        self._child.communicate()
