"""STOP with the programs as they are run: simulator, companion, router, `aritra shore`; attackers in a fifth."""

from __future__ import annotations

import contextlib
import http.client
import json
import random
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import zenoh

from companion.boat.load_run import EXAMPLES
from companion.core.telemetry import structs as shore
from tests.evidence.line import Line, at_least, at_most, exactly
from tests.evidence.trust.stop_attacks import ATTACKS, BOAT, KEY
from tests.evidence.trust.stop_bench import Attackers
from tests.processes.test_loopback import GroundStation, free_port, process, wait_for
from tests.processes.test_telemetry_process import router, run_file
from tests.support.console_fixture import served, state
from tests.support.zenoh_fixture import Console, config
from tests.support.zenoh_fixture import free_port as tcp_port

TRIES, FULL_TRIES, SEED = 28, 500, 22
GOAL_MS = 300.0
SLOW, AMONG_SLOW, SETTLED_S = 1000, 5, 7.0
OPEN_HERE = 1000
"""Sockets that this program keeps itself."""
NEUTRAL = (1500,) * 4
OTHER = "other"
"""A boat whose key file has mode 644."""


def stop_with_real_processes(full: bool) -> Iterator[Line]:
    """STOP with real processes: the same attacks; a bad key file of another boat; 1000 half-sent requests (hole 4)"""
    with _at_sea() as sea:
        rng, took = random.Random(SEED), []
        for k in range(FULL_TRIES if full else TRIES):
            if k % 20 == 0:
                mission = {"name": "square.plan", "text": (EXAMPLES / "missions" / "square.plan").read_text()}
                _ordered(sea, {"boat": BOAT, "command": "load_mission", "mission": mission})
            _ordered(sea, {"boat": BOAT, "command": "start"})
            wait_for(lambda: _moving(sea), 30.0, lambda: "thrusters stay neutral")
            sea.session.put(shore.telemetry_key(OTHER, "state"), shore.encode(state(k)))
            assert sea.attackers.ask(ATTACKS[k % len(ATTACKS)]) == "ready"
            time.sleep(rng.uniform(0.0, 0.1))
            took.append(_stop_ms(sea))
            sea.attackers.ask("end")
        yield exactly("stops that ended in neutral", int(np.isfinite(took).sum()), len(took))
        note = f"median {np.median(took):.0f}, largest {max(took):.0f}; outputs are told every 20 ms"
        yield at_most("from STOP to neutral at the ESC, p95", float(np.percentile(took, 95)), GOAL_MS, "ms", note)
        yield from _half_sent(sea)
        said = sea.out.read_text()
        yield exactly("console alive after another boat's bad key file", sea.console.poll() is None, 1, "", "it ended")
        yield at_least("  told in words", said.count(f"{OTHER} can be given no orders: --command-key"), 1)
        given = _post(sea, "/order", {"boat": OTHER, "command": "stop"})
        yield exactly("  and to who wants to order that boat", "chmod 600" in given["why"], 1)


def _half_sent(sea: SimpleNamespace) -> Iterator[Line]:
    """A thousand requests without an end: they were kept for ever, and took every socket that the console may have."""
    took, lines = [], []
    with contextlib.ExitStack() as held:
        for _ in range(AMONG_SLOW):
            _ordered(sea, {"boat": BOAT, "command": "start"})
            wait_for(lambda: _moving(sea), 30.0, lambda: "thrusters stay neutral")
            for _ in range(SLOW):
                line = held.enter_context(socket.create_connection(("127.0.0.1", sea.web), timeout=5))
                line.sendall(b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ")
                lines.append(line)
            took.append(_stop_ms(sea))
            open_then = sum(c.status == "ESTABLISHED" for c in _lines(sea))
            while len(lines) > OPEN_HERE:
                lines.pop(0).close()
        note = f"median; largest {max(took):.0f}; was never"
        yield at_most(f"STOP among {SLOW} half-sent requests, {AMONG_SLOW} times", np.median(took), GOAL_MS, "ms", note)
        yield at_most("  connections of the console meanwhile", open_then, 64)
        time.sleep(SETTLED_S)
        yield exactly(f"  half-sent requests left after {SETTLED_S:g} s", sum(map(_is_open, lines)), 0)


def _lines(sea: SimpleNamespace) -> list:
    return [c for c in psutil.Process(sea.console.pid).net_connections("tcp") if c.laddr.port == sea.web]


def _is_open(line: socket.socket) -> bool:
    line.setblocking(False)
    try:
        return line.recv(1) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


@contextlib.contextmanager
def _at_sea() -> Iterator[SimpleNamespace]:
    """All of them, and the boat known to the console."""
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as held:
        folder, udp, tcp = Path(name), free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
        port, web, tag, told = tcp_port(), tcp_port(), folder / "tag", folder / "sim.txt"
        file = run_file(folder, port)
        (folder / "boat.key").write_bytes(KEY)
        (folder / "other.key").write_bytes(KEY)
        (folder / "other.key").chmod(0o644)
        held.enter_context(router(folder, port))
        sim = ["sim", "--udp-to", f"127.0.0.1:{udp}", "--tcp", f"127.0.0.1:{tcp}", "--uwb", str(tag), "--seed", "5"]
        held.enter_context(process(sim, told))
        wait_for(lambda: "simulator: MAVLink" in told.read_text(), 60.0, told.read_text)
        station = GroundStation(tcp)
        held.callback(station.close)
        boat = ["run", "--config", str(file), "--mavlink", f"udpin:127.0.0.1:{udp}", "--uwb", f"serial:{tag}:115200"]
        held.enter_context(process([*boat, "--log", str(folder / "run.mcap")], folder / "run.txt"))
        given = ["--connect", f"tcp/127.0.0.1:{port}", "--port", str(web)]
        given += ["--command-key", f"{BOAT}={folder}/boat.key", "--command-key", f"{OTHER}={folder}/other.key"]
        _, console = held.enter_context(served(folder / "shore.txt", *given))
        session = held.enter_context(zenoh.open(config("client", connect=[f"tcp/127.0.0.1:{port}"])))
        ear = Console(session, BOAT)
        wait_for(lambda: ear.of("mode"), 120.0, (folder / "run.txt").read_text)
        wait_for(lambda: "state estimate healthy" in (folder / "run.txt").read_text(), 120.0, lambda: "no estimate")
        attackers = Attackers(port, web, ear.of("mode")[0].run)
        held.callback(attackers.close)
        yield SimpleNamespace(
            web=web, station=station, console=console, session=session, attackers=attackers, out=folder / "shore.txt"
        )


def _post(sea: SimpleNamespace, path: str, body: object):
    line = http.client.HTTPConnection("127.0.0.1", sea.web, timeout=10)
    with contextlib.closing(line):
        headers = {"Content-Type": "application/json", "Origin": f"http://127.0.0.1:{sea.web}"}
        line.request("POST", path, json.dumps(body), headers)
        return json.loads(line.getresponse().read())


def _ordered(sea: SimpleNamespace, body: dict) -> None:
    """An order, again until it is done: the name may be shared until a twin that ended is forgotten."""
    wait_for(lambda: (_post(sea, "/order", body)["outcome"] or {}).get("status") == "done", 30.0, lambda: str(body))


def _moving(sea: SimpleNamespace) -> bool:
    return len(sea.station.outputs) > 5 and all(pulses != NEUTRAL for _, pulses in sea.station.outputs[-5:])


def _stop_ms(sea: SimpleNamespace) -> float:
    """From STOP to the last output off neutral [ms]; infinite: it went on."""
    begun_ns = time.monotonic_ns()
    _post(sea, "/stop", {"boats": [BOAT]})
    try:
        wait_for(lambda: all(p == NEUTRAL for _, p in sea.station.outputs[-10:]), 15.0, lambda: "off neutral")
    except AssertionError:
        return float("inf")
    outputs = [(t_ns, p) for t_ns, p in list(sea.station.outputs) if t_ns > begun_ns]
    first_ns = next(t_ns for t_ns, p in outputs if p == NEUTRAL)
    return (max([first_ns, *(t_ns for t_ns, p in outputs if p != NEUTRAL)]) - begun_ns) * 1e-6
