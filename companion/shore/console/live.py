"""The live console: received samples go into the store and to every browser; orders go to the boats."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections.abc import Callable
from typing import Annotated

import msgspec
from aiohttp import WSMsgType, web

from companion.core.telemetry.order_gate import MAX_BYTES, Command, MissionFile, Sender
from companion.shore.console.fan_out import Watcher
from companion.shore.console.orders import Orders, SentOrder
from companion.shore.console.request_auth import RequestAuth
from companion.shore.console.store import NAME, BoatStore, Sample
from companion.shore.console.web_server import base_app
from companion.shore.console.zenoh_client import ZenohClient

FRAME_S = 0.1
BROWSERS = 32
"""Open pages at a time (assumed)."""
EVENTS = 200
LOOK_S = 2.0
"""Period of looking for a boat's missing key [s]; assumed."""
HOME = "/web/console.html"
_ENCODER = msgspec.json.Encoder()


class BrowserRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST /order."""

    boat: Annotated[str, msgspec.Meta(pattern=NAME)]
    command: Command
    mission: MissionFile | None = None


class BrowserSelection(msgspec.Struct):
    """Message of a page over its WebSocket: the boat that it shows."""

    choose: str


class Browser:
    """One open page: its queue of samples, and an event that is set when there are any."""

    def __init__(self) -> None:
        self.watcher = Watcher()
        self.events: list[bytes] = []
        self.bell = asyncio.Event()

    def tell(self, event: bytes) -> None:
        """Send at once, without waiting for the next frame."""
        if len(self.events) < EVENTS:
            self.events.append(event)
        self.bell.set()


class Keys:
    """Makers of signed orders, by boat. `find`: the boat's key or None, asked again now and then; `sender`: the name
    under which orders are given.
    """

    def __init__(self, find: Callable[[str], bytes | None] | None, sender: str) -> None:
        self._find, self._sender = find, sender
        self._senders: dict[str, Sender] = {}
        self._looked_s: dict[str, float] = {}

    def __bool__(self) -> bool:
        return self._find is not None

    def of(self, boat: str) -> Sender | None:
        """The maker of a boat's orders; None: no key."""
        now_s = time.monotonic()
        if boat in self._senders or self._find is None or now_s - self._looked_s.get(boat, -LOOK_S) < LOOK_S:
            return self._senders.get(boat)
        self._looked_s[boat] = now_s
        if (key := self._find(boat)) is not None:
            self._senders[boat] = Sender(boat, secrets.token_hex(8), self._sender, key, time.monotonic_ns)
        return self._senders.get(boat)


class Console:
    """Connects zenoh client, store, browsers and orders. `run` works until cancelled; `app` is the web server's."""

    def __init__(
        self,
        hearing: ZenohClient,
        guard: RequestAuth,
        keys: Keys,
        *,
        compress: bool,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.store, self.browsers = BoatStore(), set[Browser]()
        self._hearing, self._keys, self._compress = hearing, keys, compress
        self._orders = Orders(keys.of, hearing.ask, self._on_order)
        self.also: list[Callable[[Sample], None]] = []
        """Further consumers of every accepted sample; must not block."""
        self._waiting: set[asyncio.Task] = set()
        self._started, self._say, self._network = secrets.token_hex(4), say, hearing.problem
        self._said: dict[str, int] = {}
        self.app = base_app(guard, HOME)
        self.app.router.add_get("/ws", self._watch)
        self.app.router.add_post("/order", self._order)

    async def run(self) -> None:
        """Receive and distribute samples until cancelled."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._hearing.run())
            while True:
                begun_s = time.monotonic()
                self._pump()
                await asyncio.sleep(max(FRAME_S - (time.monotonic() - begun_s), 0.01))

    def _pump(self) -> None:
        for received in self._hearing.take():
            if received.topic is None:
                self.store.alive(received.boat, received.there)
                continue
            sample = self.store.take(received.boat, received.topic, received.data, received.heard_ns)
            if sample is None:
                continue
            if sender := self._keys.of(received.boat):
                sender.hear(self.store.boats[received.boat].run, sample.t_ns)
            for browser in self.browsers:
                browser.watcher.note(sample)
            for consume in self.also:
                consume(sample)
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

    def _on_order(self, given: SentOrder) -> None:
        event = _ENCODER.encode(given)
        for browser in self.browsers:
            browser.tell(event)

    def _about(self) -> bytes:
        """What a page must know of its console."""
        status = {"started": self._started, "commands": bool(self._keys), "problem": self._hearing.problem}
        return _ENCODER.encode({"type": "console", **status})

    # --- the web -----------------------------------------------------------------------------------

    async def _order(self, request: web.Request) -> web.StreamResponse:
        if request.content_type != "application/json":
            raise web.HTTPUnsupportedMediaType(text="expected application/json")
        try:
            body = msgspec.json.decode(await request.read(), type=BrowserRequest)
        except msgspec.MsgspecError as error:
            raise web.HTTPBadRequest(text=str(error)) from None
        if (body.mission is not None) != (body.command == "load_mission"):
            raise web.HTTPBadRequest(text="`mission` belongs to load_mission, and to nothing else")
        if body.mission and len(body.mission.text) > MAX_BYTES:
            raise web.HTTPBadRequest(text=f"missions are at most {MAX_BYTES} bytes long")
        task = asyncio.create_task(self._orders.give(body.boat, body.command, body.mission))
        self._waiting.add(task)  # a page that goes away does not take its order back
        task.add_done_callback(self._waiting.discard)
        given = await asyncio.shield(task)
        return web.Response(body=_ENCODER.encode(given), content_type="application/json")

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
                    with contextlib.suppress(msgspec.MsgspecError):
                        selection = msgspec.json.decode(message.data, type=BrowserSelection)
                        browser.watcher.choose(self.store.boats, selection.choose)
        finally:
            self.browsers.discard(browser)
            sending.cancel()
        return socket

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
