"""Consoles in tests: samples made by hand, a server in a process of its own, Debian's Chromium."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shutil
import subprocess
import threading
import time
from pathlib import Path

import msgspec
import pytest

from companion.boat.uplink.telemetry import Telemetry, config_of
from companion.core.configuration.run_file import TelemetryLink
from companion.core.preflight.rows import Row
from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import OrderGate, OrderOutcome, OrderRefused, Repeated
from companion.core.telemetry.sticks import StickGate
from companion.core.telemetry.view import TelemetryView, Who
from companion.python_child import aritra
from tests.support.drive_fixture import by_tick, driving, setup, voyage

S = 1_000_000_000
KEY = bytes(range(32))
PATIENCE_S = float(os.environ.get("ARITRA_TEST_PATIENCE_S", "60"))
"""How long a page may take: a machine that does other things as well takes long."""
ROWS = (
    Row(area="autopilot", name="FS_ACTION", level="ok", found="2", needed="2", why="stays until a person acts"),
    Row(area="boat", name="battery", level="warning", found="14.1 V", needed="14.5 V", why="low", fix="Charge it."),
)
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]


def state(k, *, run="run1", t_ns=None, **more):
    """The k-th state, 0.1 s after the one before: one metre north each."""
    values = {
        "north_m": float(k), "east_m": 2.0, "psi_rad": 0.5, "u_m_s": 0.1, "v_m_s": 0.0, "r_rad_s": 0.0,
        "covariance": (0.01,) * 21, "disturbance_n": (0.0, 0.0, 0.0), "health": "healthy", "reason": "",
    } | more  # fmt: skip
    return shore.StateNow(run=run, t_ns=10 * S + k * S // 10 if t_ns is None else t_ns, **values)


def alert(k, text, *, run="run1"):
    return shore.AlertTold(run=run, t_ns=10 * S + k * S // 10, level="info", text=text)


def mode(k, name="auto", *, run="run1"):
    told = {"why": "because", "driving": name == "auto", "armed": True, "autopilot_mode": 0}
    return shore.ModeNow(run=run, t_ns=10 * S + k * S // 10, mode=name, **told)


@functools.cache
def ticks_of_a_voyage():
    """Messages of 8 s under way (seed 11), one list a tick, as the shell's `watch` sees them."""
    run = voyage(11)
    assert run.run(driving, 60.0)
    begun = len(run.messages)
    run.run(lambda r: False, 8.0)
    return by_tick(run.messages[begun:])


def answer_as_a_boat(query, gate, now_ns, obeyed, taken=lambda order: None):
    """Answer a query as a boat does that obeys every order. `obeyed`: list that has it before the answer goes;
    `taken(order)`: told of it, too.
    """
    payload, attachment = bytes(query.payload), bytes(query.attachment or b"")
    with query:
        try:
            order = gate.judge(payload, attachment, now_ns)
            told = {"status": "done", "code": "ok", "text": f"{order.command}: heard"}
            told |= {"mode": "idle", "why": "told so"}
            if order.command != "hello":
                obeyed.append(order.command)
                taken(order)
        except OrderRefused as no:
            told = {"status": "refused", "code": no.code, "text": str(no)}
        except Repeated:
            told = {"status": "done", "code": "ok", "text": "heard before", "repeated": True}
        data = msgspec.json.encode(OrderOutcome(run=gate.run, t_ns=now_ns, **told))
        sealed = gate.answer_seal(payload, data) if gate.proves(payload, attachment) else None
        query.reply(shore.command_key(gate.boat), data, attachment=sealed)


CHOSEN = "decodeURIComponent(location.hash.slice(1))"
"""The boat that a page looks at closely: of several that appear at once, whichever it heard of first."""


class TapedBoat:
    """A boat whose telemetry plays a voyage again and again, ten ticks a second, and that obeys signed orders in words.

    `still`: it says nothing more, but can be reached; `obeyed`: the orders that it believed; `moved`: the sticks.
    """

    def __init__(self, port, name="taped", *, deaf=False):
        ticks_of_a_voyage()
        self.name, self.still, self.obeyed, self.ended = name, False, [], False
        link = TelemetryLink(connect=(f"tcp/127.0.0.1:{port}",), commands=True)
        view = TelemetryView(setup().pilot, Who("run", "digest", "aritra 0", 5 * S, commands=True), link.rate_Hz)
        self.gate, self.sticks, self.moved = OrderGate(name, "run", KEY), StickGate(name, "run", KEY), []
        self.telemetry = Telemetry(name, link, config_of(link, Path(), where="bench"), view)
        self.telemetry.start(lambda _: None, lambda: ROWS, None if deaf else self.answer, steer=self.steer)
        self.thread = threading.Thread(target=self.play, daemon=True)
        self.thread.start()

    def play(self):
        ticks, begun, k = ticks_of_a_voyage(), time.monotonic(), 0
        while not self.ended:
            tick = ticks[k % len(ticks)]
            later_ns = self.now_ns() - tick[-1].t_ns
            for message in tick if not self.still else ():
                self.telemetry.see(msgspec.structs.replace(message, t_ns=message.t_ns + later_ns))
            k += 1
            time.sleep(max(0.0, begun + k * 0.1 - time.monotonic()))

    @staticmethod
    def now_ns():
        """The boat's clock: another than the console's."""
        return time.monotonic_ns() + 12_345 * S

    def answer(self, query):
        answer_as_a_boat(query, self.gate, self.now_ns(), self.obeyed, self.sticks.take)

    def steer(self, sample):
        with contextlib.suppress(OrderRefused):
            self.moved.append(self.sticks.judge(bytes(sample.payload), bytes(sample.attachment), self.now_ns()))

    def close(self):
        self.ended = True
        self.thread.join(5)
        self.telemetry.close()


def free_environment():
    """Without a proxy, which a page on this machine needs none of."""
    return {name: value for name, value in os.environ.items() if not name.lower().endswith("_proxy")}


@contextlib.contextmanager
def served(log, *arguments):
    """`aritra shore` on a free port (or `--port` among the arguments); its address, and the process."""
    command = aritra("shore", *arguments)
    if "--port" not in arguments:
        command += ["--port", "0"]
    with log.open("w") as out:
        child = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, env=free_environment())
    try:
        end = time.monotonic() + PATIENCE_S
        while not (found := re.search(r"console: (http\S+)", log.read_text())):
            assert child.poll() is None and time.monotonic() < end, log.read_text()
            time.sleep(0.05)
        yield found.group(1), child
    finally:
        if child.poll() is None:
            child.terminate()
        assert child.wait(15) in (0, -9), log.read_text()


@contextlib.contextmanager
def chromium():
    """A headless browser; the test is skipped where there is none."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install 'aritra[dev]'")
    with api.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS, timeout=1e3 * PATIENCE_S)
        try:
            yield browser
        finally:
            browser.close()


class Page:
    """A page that notes every error of its scripts; `expected`: patterns of those that a test brings about."""

    def __init__(self, browser, address, *, width=1440, height=900, **more):
        self.errors, self.context = [], browser.new_context(viewport={"width": width, "height": height}, **more)
        self.context.set_default_timeout(1e3 * PATIENCE_S)
        self.page = self.context.new_page()
        self.page.on("console", lambda m: self.errors.append(m.text) if m.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(address)

    def text(self, selector):
        return self.page.locator(selector).inner_text()

    def wait(self, script, seconds=PATIENCE_S):
        """Until a JavaScript expression is true; its value."""
        end = time.monotonic() + seconds
        while not (value := self.page.evaluate(script)):  # the page's policy forbids playwright's own wait
            assert time.monotonic() < end, f"not within {seconds:g} s: {script}"
            self.page.wait_for_timeout(50)
        return value

    def newest(self, topic, boat):
        return self.page.evaluate("([b, t]) => aritra.history.last(b, t)", [boat, topic])

    def unexpected(self, *expected):
        return [e for e in self.errors if not any(re.search(pattern, e) for pattern in expected)]
