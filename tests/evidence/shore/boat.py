"""Evidence for telemetry and orders: what they cost the boat, and that a router that stalls costs the loop nothing."""

from __future__ import annotations

import json
import resource
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from companion.boat.uplink.telemetry import Telemetry, config_of
from companion.core.configuration.run_file import TelemetryLink
from companion.core.messages import Message
from companion.core.telemetry.view import TelemetryView, Who
from companion.python_child import python
from sim.world.stepped import SteppedRun
from tests.evidence.line import Line, at_most, exactly
from tests.evidence.main_job.parts import ROOT, reference_boat, world_of
from tests.support.drive_fixture import by_tick

SECONDS = 30.0
CONSOLE = """
import json, sys, zenoh
from companion.shore.subscriber import listen
c = zenoh.Config()
for key, value in json.loads(sys.argv[1]).items():
    c.insert_json5(key, json.dumps(value))
with zenoh.open(c) as s:
    held = listen(s, lambda sample: None)
    print("listening", flush=True)
    sys.stdin.read()
"""


def messages_of_a_drive() -> list[list[Message]]:
    """Messages of SECONDS under way (seed 1, calm), one list a tick, the shell's LoopTiming at its end."""
    _, pilot, nmpc = reference_boat()
    run = SteppedRun(world_of(1, False), pilot, nmpc.solve)
    run.run(lambda r: r.state.helm.mode == "auto", 60.0)
    begun = len(run.messages)
    run.run(lambda r: False, SECONDS)
    return by_tick(run.messages[begun:])


def cpu_s() -> float:
    """Processor time of this process, all threads."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def play(ticks: list[list[Message]], see) -> float:
    """Give the messages to `see` at 10 Hz; share of a core used meanwhile [%]."""
    begun, used = time.monotonic(), cpu_s()
    for k, tick in enumerate(ticks):
        for message in tick:
            see(message)
        time.sleep(max(0.0, begun + (k + 1) * 0.1 - time.monotonic()))
    return 100.0 * (cpu_s() - used) / (time.monotonic() - begun)


class Counting:
    """A TCP relay to `port` that counts what comes from the boat; `port` of its own."""

    def __init__(self, port: int) -> None:
        self.bytes = 0
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port, self._to = self._server.getsockname()[1], port
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            boat, _ = self._server.accept()
            router = socket.create_connection(("127.0.0.1", self._to))
            threading.Thread(target=self._pass, args=(boat, router, True), daemon=True).start()
            threading.Thread(target=self._pass, args=(router, boat, False), daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket, counted: bool) -> None:
        while data := source.recv(65536):
            self.bytes += len(data) if counted else 0
            sink.sendall(data)


def _quiet(mode: str, connect: list[str], listen: list[str]) -> dict[str, object]:
    scouting = {"scouting/multicast/enabled": False, "scouting/gossip/enabled": False}
    return {"mode": mode, "connect/endpoints": connect, "listen/endpoints": listen, **scouting}


def _telemetry(port: int) -> Telemetry:
    setup, _, _ = reference_boat()
    link = TelemetryLink(connect=(f"tcp/127.0.0.1:{port}",))
    view = TelemetryView(setup, Who("run", "digest", "aritra", 0, False), link.rate_Hz)
    made = Telemetry("aritra", link, config_of(link, Path(), where="evidence"), view)
    made.start(lambda alert: None, tuple)
    return made


def cost(full: bool) -> Iterator[Line]:
    """Cost at 10 Hz with one console behind a router: processor (that of the relay which counts included), bytes"""
    ticks = messages_of_a_drive()
    with tempfile.TemporaryDirectory() as folder, socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
        probe.close()
        file = Path(folder) / "router.json5"
        told = {"listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}, "scouting": {"multicast": {"enabled": False}}}
        file.write_text(json.dumps(told))
        router = subprocess.Popen([sys.executable, ROOT / "deploy/zenoh/router.py", file], stdout=subprocess.PIPE)
        assert router.stdout and router.stdout.readline()
        wants = json.dumps(_quiet("client", [f"tcp/127.0.0.1:{port}"], []))
        console = subprocess.Popen(python("-c", CONSOLE, wants), stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert console.stdout and console.stdout.readline()
        idle = play(ticks, lambda message: None)
        alone = _telemetry(closed_port())
        time.sleep(2.0)
        nobody = play(ticks, alone.see)
        alone.close()
        relay = Counting(port)
        boat = _telemetry(relay.port)
        time.sleep(3.0)
        sent, wire, payload = boat.published, relay.bytes, boat.published_bytes
        used = play(ticks, boat.see)
        seconds = len(ticks) * 0.1
        yield at_most(
            "processor with a console", used - idle, 3.0, "%", f"of one core; nobody there {nobody - idle:.2f}"
        )
        rate = (relay.bytes - wire) / seconds * 1e-3
        inside = (boat.published_bytes - payload) / seconds * 1e-3
        note = f"payload {inside:.1f} kB/s, {(boat.published - sent) / seconds:.0f} samples a second"
        yield at_most("bytes sent over TCP", rate, 20.0, "kB/s", note)
        yield exactly("messages dropped", boat.dropped, 0)
        boat.close()
        console.terminate()
        router.terminate()
        console.wait()
        router.wait()


def closed_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


def outage(full: bool) -> Iterator[Line]:
    """Three programs: signed orders from shore, and a router that stops for 3 s while the boat drives"""
    test = "tests/processes/test_telemetry_process.py"
    command = python("-m", "pytest", "-q", "-s", "--no-header", test)
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    for line in done.stdout.splitlines():
        if line.startswith(("neutral", "lateness", "stop ", "hold ")):
            print(f"  ({line})")
    yield exactly(f"{test}: failed", float(done.returncode != 0), 0, "", done.stdout.strip().splitlines()[-1])


PARTS = (cost, outage)
