"""Evidence for the console: a real browser drives it against a running boat, and fifty boats at once."""

from __future__ import annotations

import contextlib
import math
import re
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import psutil
from axe_playwright_python.sync_playwright import Axe

from companion.python_child import python
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.main_job.parts import ROOT
from tests.processes.test_loopback import GroundStation, free_port, process, wait_for
from tests.processes.test_telemetry_process import run_file
from tests.support.console_fixture import KEY, Page, chromium, served
from tests.support.zenoh_fixture import free_port as tcp_port

STOPS = 20
STOP_GOAL_MS = 300.0
NEUTRAL = (1500,) * 4
BOATS, SECONDS, FRAMES_GOAL = 50, 20.0, 5.0
LIVE = "document.querySelector('#link').dataset.kind === 'live'"
REFUSED = ("ERR_CONNECTION_REFUSED", "WebSocket connection")
FLEET = """
import sys, time
from tests.support.console_fixture import TapedBoat
port, names = int(sys.argv[1]), sys.argv[2].split(",")
boats = []
for name in names:
    boats.append(TapedBoat(port, name))
    time.sleep(0.1)
print("telling", flush=True)
sys.stdin.read()
print("dropped", sum(b.telemetry.dropped for b in boats), flush=True)
for boat in boats:
    boat.close()
"""


@contextlib.contextmanager
def running_boat(*, start: bool = True) -> Iterator[SimpleNamespace]:
    """Simulator and companion (`start`: that drives): .given (arguments of a console for it), .station, .folder."""
    with tempfile.TemporaryDirectory() as name:
        folder, udp, tcp = Path(name), free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
        port, tag = tcp_port(), folder / "tag"
        config = run_file(folder, port)
        sim = ["sim", "--udp-to", f"127.0.0.1:{udp}", "--tcp", f"127.0.0.1:{tcp}", "--uwb", str(tag), "--seed", "5"]
        boat = ["run", "--config", str(config), "--mavlink", f"udpin:127.0.0.1:{udp}", "--uwb", f"serial:{tag}:115200"]
        boat += ["--log", str(folder / "run.mcap"), *(["--start"] if start else [])]
        given = ["--listen", f"tcp/127.0.0.1:{port}", "--command-key", folder / "boat.key", "--port", str(tcp_port())]
        told = folder / "sim.txt"
        with process(sim, told):
            wait_for(lambda: "simulator: MAVLink" in told.read_text(), 60.0, told.read_text)
            station = GroundStation(tcp)
            with process(boat, folder / "out.txt"):
                yield SimpleNamespace(folder=folder, station=station, given=given)
            station.close()


def _stop_ms(page: Page, station: GroundStation) -> float:
    """One STOP of a boat that drives: from the click (the browser's own stamp) to the last output off neutral [ms]."""
    page.wait("aritra.history.last('aritra', 'mode')?.driving === true")
    wait_for(lambda: all(p != NEUTRAL for _, p in station.outputs[-5:]), 60.0, lambda: "thrusters stay neutral")
    page.page.click("#stop")
    page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
    wait_for(lambda: all(p == NEUTRAL for _, p in station.outputs[-10:]), 30.0, lambda: "outputs off neutral")
    clicked_ns = round(page.page.evaluate("window.clicked_ms") * 1e6) - (time.time_ns() - time.monotonic_ns())
    first_ns = next(t_ns for t_ns, p in station.outputs if t_ns > clicked_ns and p == NEUTRAL)
    after = [t_ns for t_ns, p in station.outputs if t_ns > clicked_ns and p != NEUTRAL]
    return (max([first_ns, *after]) - clicked_ns) * 1e-6


def chromium_drives_the_console(full: bool) -> Iterator[Line]:
    """A headless Chromium at the console of a running boat: 20 STOPs, a reload, a killed server, axe-core"""
    with running_boat() as run, chromium() as browser:
        with served(run.folder / "shore.txt", *run.given) as (address, child):
            page = Page(browser, address)
            page.wait(f"{LIVE} && aritra.history.last('aritra', 'mode')?.driving === true")
            page.page.evaluate(
                "document.querySelector('#stop').addEventListener('click', (e) => "
                "{ window.clicked_ms = performance.timeOrigin + e.timeStamp; }, true)"
            )
            page.wait("aritra.history.list('aritra', 'timing').length > 8")
            first = page.newest("state", "aritra")
            page.page.wait_for_timeout(5000)
            last = page.newest("state", "aritra")
            moved_m = math.hypot(last["north_m"] - first["north_m"], last["east_m"] - first["east_m"])
            yield at_least("the boat moves on the map, in 5 s", moved_m, 0.5, "m")
            filled = page.page.evaluate(
                "[...document.querySelectorAll('#plots canvas')].filter((c) => { const d = c.getContext('2d')"
                ".getImageData(0, 0, c.width, c.height).data; let n = 0; for (let i = 0; i < d.length; i += 4)"
                " n += d[i + 3] > 200 && Math.abs(d[i] - d[i + 2]) > 60; return n > 20; }).length"
            )
            yield exactly("plots that are drawn", filled, 8)
            found = Axe().run(page.page).response["violations"]
            yield exactly(
                "axe-core: serious or critical", sum(v["impact"] in ("serious", "critical") for v in found), 0
            )
            took = []
            for _ in range(STOPS):
                took.append(_stop_ms(page, run.station))
                page.page.click("#start")
                page.page.click("#question .yes")
                page.wait("document.querySelector('#answers li')?.dataset.command === 'start'")
            took.sort()
            note = f"median {took[len(took) // 2]:.0f}, largest {took[-1]:.0f}; outputs are told every 20 ms"
            yield at_most(f"click to neutral at the ESC, p95 of {STOPS}", took[-2], STOP_GOAL_MS, "ms", note)
            begun = time.monotonic()
            page.page.reload()
            page.wait(f"{LIVE} && aritra.history.list('aritra', 'state').length > 100")
            yield information("reload: live, with its history, after", time.monotonic() - begun, "s")
            yield exactly("errors on the browser's console so far", len(page.unexpected()), 0, "", str(page.errors[:1]))
            child.send_signal(signal.SIGKILL)
            child.wait(5)
        page.wait("document.querySelector('#link').dataset.kind === 'lost'")
        time.sleep(2.0)
        with served(run.folder / "again.txt", *run.given):
            begun = time.monotonic()
            page.wait(LIVE)
            yield information("killed server: live again, after its new start", time.monotonic() - begun, "s")
            gap_s = "Math.max(...(t => t.slice(1).map((x, k) => x - t[k]))(aritra.history.list('aritra', 'state')"
            gap_s += ".map(s => s.t_ns * 1e-9)))"
            page.wait(f"{gap_s} < 1.0")
            yield at_most("longest gap in the states afterwards", page.page.evaluate(gap_s), 1.0, "s")
            yield exactly("errors other than the refused line", len(page.unexpected(*REFUSED)), 0)
            page.context.close()


@contextlib.contextmanager
def _fleet(port: int, names: list[str]) -> Iterator[subprocess.Popen]:
    """Boats that play a voyage, in a process of their own."""
    env = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"}
    command = python("-c", FLEET, str(port), ",".join(names))
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env)
    try:
        assert child.stdout and child.stdout.readline() == "telling\n"
        yield child
    finally:
        child.kill()
        child.wait()


def _watched(browser, address: str, boats: int) -> tuple[float, float]:
    """Least and mean frames a second of the boats on a page, over SECONDS."""
    page = Page(browser, address)
    page.wait(f"aritra.history.boats().length === {boats}")
    page.page.wait_for_timeout(2000)
    count = "Object.fromEntries(aritra.drawn)"
    before, begun = page.page.evaluate(count), time.monotonic()
    page.page.wait_for_timeout(SECONDS * 1e3)
    after, seconds = page.page.evaluate(count), time.monotonic() - begun
    rates = [(after[name] - before.get(name, 0)) / seconds for name in after]
    page.context.close()
    return min(rates), sum(rates) / len(rates)


def fifty_boats(full: bool) -> Iterator[Line]:
    """Fifty boats at 10 Hz on one console with one page open, all on this machine; and what one boat pays for that"""
    cost = {}
    with tempfile.TemporaryDirectory() as name, chromium() as browser:
        folder = Path(name)
        (folder / "key").write_bytes(KEY)
        (folder / "key").chmod(0o600)
        for others in (0, BOATS - 1):
            port = tcp_port()
            listen = f"tcp/127.0.0.1:{port}"
            given = ["--listen", listen, "--command-key", folder / "key"]
            with served(folder / f"{others}.txt", *given) as (address, child), contextlib.ExitStack() as held:
                if others:
                    held.enter_context(_fleet(port, [f"boat-{k}" for k in range(others)]))
                one = held.enter_context(_fleet(port, ["the-one"]))
                boat, console = psutil.Process(one.pid), psutil.Process(child.pid)
                used = sum(boat.cpu_times()[:2]), sum(console.cpu_times()[:2])
                begun = time.monotonic()
                least, mean = _watched(browser, address, others + 1)
                seconds = time.monotonic() - begun
                cost[others] = 100 * (sum(boat.cpu_times()[:2]) - used[0]) / seconds
                if others:
                    yield at_least(
                        f"frames a second of the slowest of {BOATS} boats",
                        least,
                        FRAMES_GOAL,
                        "1/s",
                        f"mean {mean:.1f}",
                    )
                    share = 100 * (sum(console.cpu_times()[:2]) - used[1]) / seconds
                    note = f"of one core; {console.memory_info().rss * 1e-6:.0f} MB"
                    yield information("processor of the console", share, "%", note)
                    told, _ = one.communicate("", timeout=30)
                    dropped = re.search(r"dropped (\d+)", told)
                    yield exactly("messages that one boat dropped", int(dropped.group(1)) if dropped else math.nan, 0)
    more = cost[BOATS - 1] - cost[0]
    note = f"{cost[0]:.1f} alone, {cost[BOATS - 1]:.1f} among {BOATS}, of one core, its tape included"
    yield at_most("more processor for one boat among fifty", more, 1.0, "%", note)


PARTS = (chromium_drives_the_console, fifty_boats)
