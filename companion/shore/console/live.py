"""The live console: received samples go into the store and to every browser; orders go to the boats."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections.abc import Callable, Coroutine
from typing import Any

import msgspec
from aiohttp import WSMsgType, web

from companion.core.telemetry.order_gate import WINDOW_S
from companion.core.telemetry.order_sender import Sender
from companion.core.telemetry.structs import About
from companion.shore.console.connection_limits import ConnectionLimits
from companion.shore.console.drive_there import LEAVING, drive_there
from companion.shore.console.driving.sticks import SticksDesk
from companion.shore.console.fan_out import Watcher
from companion.shore.console.files.logs import ServedLogs
from companion.shore.console.files.missions import add_missions, check_length
from companion.shore.console.files.sites import read_site
from companion.shore.console.keys import Keys
from companion.shore.console.known_boats import KnownBoats
from companion.shore.console.orders import Orders, SentOrder, shared
from companion.shore.console.request_auth import RequestAuth
from companion.shore.console.requests import BrowserRequest, BrowserWord, DriveThereRequest, StopRequest
from companion.shore.console.store import BoatRecord, BoatStore, Sample
from companion.shore.console.web_server import base_app, read_body
from companion.shore.console.zenoh_client import ZenohClient, ZenohSample

FRAME_S = 0.1
BROWSERS = 32
"""Open pages at a time (assumed)."""
EVENTS = 200
WORK_S = 0.01
"""Samples are taken for so long at a time, and then not for as long: a flood of them must not keep an order waiting
(assumed)."""
WARN_S = 10.0
"""Between words to the programs of a shared name (assumed)."""
QUICK_S = 1.0
"""How long the answer to a request waits for the boat's; the rest comes by WebSocket, for a browser has six connections
to us, and a boat that is dead must not keep the order to another (assumed)."""
HOME = "/web/console.html"
_ENCODER = msgspec.json.Encoder()


class Browser:
    """One open page: its queue of samples, and an event that is set when there are any."""

    def __init__(self) -> None:
        self.watcher = Watcher()
        self.drives: tuple[str, str] | None = None
        """Page and boat of the sticks that it sent last."""
        self.events: list[bytes] = []
        self.bell = asyncio.Event()

    def tell(self, event: bytes) -> None:
        """Send at once, without waiting for the next frame."""
        if len(self.events) < EVENTS:
            self.events.append(event)
        self.bell.set()


class Console:
    """Connects zenoh client, store, browsers and orders. `run` works until cancelled; `app` is the web server's."""

    def __init__(
        self,
        hearing: ZenohClient,
        guard: RequestAuth,
        keys: Keys,
        *,
        compress: bool,
        logs: ServedLogs | None = None,
        say: Callable[[str], object] = lambda _: None,
    ) -> None:
        self.store, self.browsers = BoatStore(), set[Browser]()
        self._hearing, self._keys, self._compress = hearing, keys, compress
        self.known = KnownBoats(self.store, keys)
        """What orders are made out by."""
        self._orders = Orders(self.known, hearing.ask, self._on_order)
        self.also: list[Callable[[Sample], None]] = []
        """Further consumers of every accepted sample; must not block."""
        self._waiting: set[asyncio.Task] = set()
        self.limits: ConnectionLimits | None = None
        self._started, self._say, self._network = secrets.token_hex(4), say, hearing.problem
        self._said: dict[str, int] = {}
        self._settled: dict[int, asyncio.Event] = {}
        self._pages: dict[int, str | None] = {}
        self._sticks = SticksDesk(self.known)
        self._warned_s: dict[str, float] = {}
        self.app = base_app(guard, HOME, lambda transport: self.limits and self.limits.prove(transport))
        self.app.router.add_get("/ws", self._watch)
        self.app.router.add_post("/order", self._order)
        self.app.router.add_post("/stop", self._stop)
        self.app.router.add_post("/drive_there", self._drive_there)
        add_missions(self.app, self._about_boat)
        self.app.router.add_post("/site", read_site)
        self._logs = logs
        if logs:
            logs.add_to(self.app)

    async def serve(self, runner: web.AppRunner, host: str, port: int) -> asyncio.Server:
        """The web server of `app`, set up in `runner`, listening. Raises OSError, OverflowError."""
        assert runner.server is not None, "set up"
        self.limits = ConnectionLimits(runner.server)
        return await asyncio.get_running_loop().create_server(self.limits, host, port, backlog=1024)

    async def run(self) -> None:
        """Receive and distribute samples until cancelled."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._hearing.run())
            while True:
                self._look()
                frame_s = time.monotonic() + FRAME_S
                while (left_s := frame_s - time.monotonic()) > 0:
                    await asyncio.sleep(WORK_S if self._pump(time.monotonic() + WORK_S) else left_s)

    # --- from the boats ------------------------------------------------------------------------------

    def _about_boat(self, boat: str) -> About | None:
        """What a boat has reported of itself."""
        known = self.store.boats.get(boat)
        told = known.newest("about") if known else None
        return msgspec.json.decode(told.data, type=About) if told else None

    def _pump(self, end_s: float) -> bool:
        """Take samples until `end_s`; whether there are more."""
        for received in self._hearing.take():
            try:
                self._hear(received)
            except Exception as error:  # one sample is not worth the others, nor the orders
                self.store.refused[f"{type(error).__name__}: {error}"[:200]] += 1
            if time.monotonic() > end_s:
                return True
        return False

    def _look(self) -> None:
        """Once a frame: what is to be told, to boats, browsers and the terminal."""
        for name, boat in self.store.boats.items():
            self._look_after(name, boat)
        if (network := self._hearing.problem) != self._network:
            self._network = network
            self._say(f"zenoh: {network or 'ready'}")
            for browser in self.browsers:
                browser.tell(self._about())
        for why, count in self.store.refused.items():
            if count >= 2 * self._said.get(why, 0.5):
                self._said[why] = count
                self._say(f"telemetry left out: {why} ({count} so far)")
        for browser in self.browsers:
            browser.bell.set()

    def _hear(self, received: ZenohSample) -> None:
        if received.topic is None:
            return self.store.alive(received.boat, received.there, received.heard_ns)
        before = self.store.boats.get(received.boat)
        run = before.run if before else ""
        sample = self.store.take(received.boat, received.topic, received.data, received.heard_ns)
        if sample is None:
            return
        boat = self.store.boats[received.boat]
        for browser in self.browsers:
            if run and boat.run != run:
                browser.watcher.turn(boat)
            else:
                browser.watcher.note(sample)
        for consume in self.also:
            consume(sample)

    def _look_after(self, name: str, boat: BoatRecord) -> None:
        """A key that cannot be used, and a name that is shared, are told, each to those whom it concerns."""
        if self._keys and (problem := self._keys.problem(name)) != boat.problem:
            boat.problem = problem
            self._say(problem or f"{name}: its command key is there now")
        boat.no_orders = "" if not self._keys or isinstance(why := self._keys.of(name), Sender) else why
        now_s = time.monotonic()
        if len(boat.runs(time.monotonic_ns())) > 1 and now_s - self._warned_s.get(name, -WARN_S) >= WARN_S:
            self._warned_s = {b: s for b, s in self._warned_s.items() if now_s - s < WARN_S} | {name: now_s}
            self._say(shared(name, boat.runs(time.monotonic_ns())))
            self._keep(asyncio.create_task(self._orders.warn(name)))

    def _keep(self, task: asyncio.Task[None]) -> None:
        """A page that goes away does not take its order back."""
        self._waiting.add(task)
        task.add_done_callback(self._waiting.discard)

    def _on_order(self, given: SentOrder) -> None:
        if given.state != "sending" and (settled := self._settled.get(given.number)):
            settled.set()
        settled = given.state != "sending"
        self._sticks.note(given, self._pages.pop(given.number, None) if settled else None)
        event = _ENCODER.encode(given)
        for browser in self.browsers:
            browser.tell(event)

    def _about(self) -> bytes:
        """What a page must know of its console."""
        status = {"started": self._started, "commands": bool(self._keys), "problem": self._hearing.problem}
        status["logs"] = self._logs is not None
        return _ENCODER.encode({"type": "console", "where": self._hearing.where, **status})

    # --- the web -----------------------------------------------------------------------------------

    async def _order(self, request: web.Request) -> web.StreamResponse:
        body = await read_body(request, BrowserRequest)
        if (body.mission is not None) != (body.command == "load_mission"):
            raise web.HTTPBadRequest(text="`mission` belongs to load_mission, and to nothing else")
        check_length(body.mission)
        if body.command != "stop":
            _refuse_late(body.given_ms)
        order = self._orders.begin(body.boat, body.command)
        self._pages[order.number] = body.page
        return await self._given(order, self._orders.send(order, body.mission))

    async def _drive_there(self, request: web.Request) -> web.StreamResponse:
        body = await read_body(request, DriveThereRequest)
        commands = LEAVING[0 if body.leave else 1 :]
        check_length(body.mission)
        _refuse_late(body.given_ms)
        order = self._orders.begin(body.boat, commands[0])
        return await self._given(order, drive_there(self._orders, order, body.mission, commands))

    async def _given(self, order: SentOrder, work: Coroutine[Any, Any, None]) -> web.StreamResponse:
        """What came of an order within `QUICK_S`; `work` goes on."""
        settled = self._settled[order.number] = asyncio.Event()
        self._keep(asyncio.create_task(work))
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(settled.wait(), QUICK_S)
        del self._settled[order.number]
        return web.Response(body=_ENCODER.encode(order), content_type="application/json")

    async def _stop(self, request: web.Request) -> web.StreamResponse:
        body = await read_body(request, StopRequest)
        orders = [self._orders.begin(boat, "stop") for boat in dict.fromkeys(body.boats)]
        for order in orders:
            self._keep(asyncio.create_task(self._orders.send(order)))
        return web.Response(body=_ENCODER.encode(orders), content_type="application/json")

    async def _watch(self, request: web.Request) -> web.StreamResponse:
        if len(self.browsers) >= BROWSERS:
            raise web.HTTPServiceUnavailable(text=f"{BROWSERS} pages are open already")
        socket = web.WebSocketResponse(heartbeat=5.0, compress=self._compress, max_msg_size=4096)
        await socket.prepare(request)
        browser = Browser()
        browser.watcher.begin(self.store.boats.values())
        browser.tell(self._about())
        for given in self._orders.last.values():
            browser.tell(_ENCODER.encode(given))
        self.browsers.add(browser)
        sending = asyncio.create_task(self._send(socket, browser))
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    self._hear_browser(browser, message.data)
        finally:
            if browser.drives and (sample := self._sticks.let_go(*browser.drives)):
                self._hearing.tell_sticks(browser.drives[1], sample)
            self.browsers.discard(browser)
            sending.cancel()
        return socket

    def _hear_browser(self, browser: Browser, data: str) -> None:
        try:
            word = msgspec.json.decode(data, type=BrowserWord)
        except msgspec.MsgspecError:
            return
        if word.choose is not None:
            browser.watcher.choose(self.store.boats, word.choose)
        if word.sticks and (sample := self._sticks.sealed(word.sticks, time.monotonic() * 1e3)):
            browser.drives = word.sticks.page, word.sticks.boat
            self._hearing.tell_sticks(word.sticks.boat, sample)

    async def _send(self, socket: web.WebSocketResponse, browser: Browser) -> None:
        with contextlib.suppress(ConnectionError, RuntimeError):
            while True:
                await browser.bell.wait()
                browser.bell.clear()
                events, browser.events = browser.events, []
                for event in events:
                    await socket.send_str(event.decode())
                if frame := browser.watcher.frame(self.store.boats, time.monotonic() * 1e3):
                    await socket.send_str(frame.decode())


def _refuse_late(given_ms: float | None) -> None:
    """Raise the answer to an order that may move the boat and that the network held up."""
    late_s = 0.0 if given_ms is None else time.monotonic() - given_ms * 1e-3
    if late_s > WINDOW_S:  # the boat would not take it either, had the console not sealed it anew
        raise web.HTTPRequestTimeout(text=f"it was given {late_s:.0f} s ago: give it again if it is still wanted")
