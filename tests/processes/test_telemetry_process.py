"""Simulator, companion and zenoh router as programs of their own, and a console: driven from shore by signed orders."""

import json
import secrets
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

from companion.__main__ import main
from companion.boat.load_run import EXAMPLES
from companion.core.messages import LoopTiming, OperatorCommand
from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import MissionFile, read_outcome
from companion.core.telemetry.order_sender import Sender
from companion.logs.log_file import LogFile
from tests.processes.test_loopback import DRIVING_S, GroundStation, free_port, process, wait_for
from tests.support.zenoh_fixture import console

pytestmark = pytest.mark.real_time

KEY = bytes(range(100, 132))


@contextmanager
def router(folder, port):
    told = {"listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}
    told["scouting"] = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    (folder / "router.json5").write_text(json.dumps(told))
    out = folder / "router.txt"
    with out.open("w") as file:
        command = [sys.executable, EXAMPLES / "zenoh" / "router.py", folder / "router.json5"]
        child = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)
    try:
        wait_for(lambda: "router" in out.read_text(), 20.0, out.read_text)
        yield child
    finally:
        child.send_signal(signal.SIGCONT)
        child.terminate()
        assert child.wait(10) == 0


def run_file(folder, port):
    text = (EXAMPLES / "aritra.toml").read_text()
    for name in ("boats", "sites", "missions"):
        text = text.replace(f'"{name}/', f'"{EXAMPLES}/{name}/')
    (folder / "boat.key").write_bytes(KEY)
    (folder / "boat.key").chmod(0o600)
    telemetry = f'\n[telemetry]\nconnect = ["tcp/127.0.0.1:{port}"]\ncommands = true\ncommand_key = "boat.key"\n'
    (folder / "run.toml").write_text(text + telemetry)
    return folder / "run.toml"


def order(shore_side, command, mission=None, key=KEY):
    payload, mac = shore_side.sender.order(command, mission)
    if key != KEY:
        mac = key
    begun = time.monotonic()
    replies = shore_side.session.get(shore.command_key("aritra"), payload=payload, attachment=mac, timeout=5.0)
    (answer,) = [read_outcome(bytes(r.ok.payload)) for r in replies if r.ok]
    print(command, answer.status, f"{(time.monotonic() - begun) * 1e3:.1f} ms")
    return answer


@pytest.mark.long
def test_driven_from_shore_through_a_router_that_stalls(tmp_path):  # noqa: PLR0915  (one story)
    """The console is there before the boat; the router stops taking bytes for 3 s while the boat drives."""
    udp, tcp, tag = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM), tmp_path / "tag"
    port, log, out = free_port(socket.SOCK_STREAM), tmp_path / "run.mcap", tmp_path / "out.txt"
    sim = ["sim", "--udp-to", f"127.0.0.1:{udp}", "--tcp", f"127.0.0.1:{tcp}", "--uwb", str(tag), "--seed", "5"]
    wires = ["--mavlink", f"udpin:127.0.0.1:{udp}", "--uwb", f"serial:{tag}:115200"]
    boat = ["run", "--config", str(run_file(tmp_path, port)), *wires, "--log", str(log)]
    with process(sim, tmp_path / "sim.txt"), router(tmp_path, port) as between, console(port) as shore_side:
        shore_side.sender = Sender("aritra", secrets.token_hex(8), "anna", KEY, time.monotonic_ns)
        wait_for(lambda: "simulator: MAVLink" in (tmp_path / "sim.txt").read_text(), 20.0, lambda: "no simulator")
        station = GroundStation(tcp)
        with process(boat, out) as child:
            wait_for(lambda: any(s.health == "healthy" for s in shore_side.of("state")), DRIVING_S, out.read_text)
            assert shore_side.alive() == {"aritra/aritra/alive"}
            refused = order(shore_side, "start", key=bytes(32))
            assert (refused.status, refused.code) == ("refused", "unsigned")
            near = "[[waypoints]]\nnorth_m = 10.0\neast_m = 9.0\n[[waypoints]]\nnorth_m = 14.0\neast_m = 9.0\n"
            assert order(shore_side, "load_mission", MissionFile(name="near.toml", text=near)).status == "done"
            assert order(shore_side, "start").status in ("done", "waiting")
            wait_for(lambda: shore_side.of("horizon") and shore_side.of("reference"), DRIVING_S, out.read_text)
            wait_for(lambda: shore_side.of("path")[-1].name == "near", 5.0, out.read_text)
            time.sleep(2.0)
            stalled_ns = time.monotonic_ns()
            between.send_signal(signal.SIGSTOP)
            time.sleep(3.0)
            between.send_signal(signal.SIGCONT)
            resumed_ns = time.monotonic_ns()
            wait_for(lambda: shore_side.of("state")[-1].t_ns > resumed_ns, 20.0, out.read_text)
            assert order(shore_side, "hold").mode == "hold"
            wait_for(lambda: any(p != (1500,) * 4 for _, p in station.outputs[-10:]), 10.0, out.read_text)
            asked_ns = time.monotonic_ns()
            assert order(shore_side, "stop").mode == "idle"
            wait_for(lambda: all(p == (1500,) * 4 for _, p in station.outputs[-5:]), 5.0, out.read_text)
            time.sleep(0.3)
            last = max(t_ns for t_ns, p in station.outputs if p != (1500,) * 4)
            print(f"neutral at the autopilot {(last - asked_ns) * 1e-9:.2f} s after the stop")
            assert (last - asked_ns) * 1e-9 < 0.5
            child.send_signal(signal.SIGTERM)
            assert child.wait(20) == 0, out.read_text()
        station.close()
    told = out.read_text()
    assert "order from shore refused: not signed" in told and "shore (anna): stop: done" in told
    assert told.count("telemetry: ") <= 3, "told once"
    messages = list(LogFile(log).messages(LoopTiming, OperatorCommand))
    assert [m.command for m in messages if isinstance(m, OperatorCommand)] == ["start", "hold", "stop", "stop"]
    timings = [m for m in messages if isinstance(m, LoopTiming)]
    during = [m.lateness_ms for m in timings if stalled_ns < m.t_ns < resumed_ns]
    before = [m.lateness_ms for m in timings if stalled_ns - 2e9 < m.t_ns < stalled_ns]
    print(f"lateness, median: {np.median(before):.2f} ms before, {np.median(during):.2f} ms while the router stood")
    assert len(during) >= 28, "no tick is lost"
    assert np.median(during) < np.median(before) + 10.0
    assert main(["replay", str(log)]) == 0
