"""Several boats at once, real processes: each under its own name, with a key of its own."""

import json
import os
import secrets
import signal
import subprocess
import time

import pytest

from companion.boat.load_run import EXAMPLES
from companion.boat.signing_key import load_secret
from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import read_outcome
from companion.core.telemetry.order_sender import Sender
from companion.python_child import aritra
from tests.processes.test_telemetry_process import router
from tests.support.zenoh_fixture import console, free_port, wait_for

pytestmark = pytest.mark.real_time

NEAR = "[[waypoints]]\nnorth_m = 9.0\neast_m = 8.5\n[[waypoints]]\nnorth_m = 11.0\neast_m = 9.0\n"


def near(folder):
    """The example's run file with a mission of a few seconds."""
    text = (EXAMPLES / "aritra.toml").read_text().replace("missions/square.toml", "near.toml")
    for name in ("boats", "sites"):
        text = text.replace(f'"{name}/', f'"{os.path.relpath(EXAMPLES, folder)}/{name}/')
    (folder / "near.toml").write_text(NEAR)
    (folder / "my.toml").write_text(text)
    return folder / "my.toml"


def hold(shore_side, boat, key):
    """Codes of the answers to an order for `boat`, signed with `key`."""
    newest = next(t for topic, t in reversed(shore_side.heard) if topic == "state" and t.run == shore_side.runs[boat])
    sender = Sender(boat, secrets.token_hex(8), "anna", key, time.monotonic_ns)
    sender.hear(newest.run, newest.t_ns)
    payload, sealed = sender.order("hold")
    replies = shore_side.session.get(shore.command_key(boat), payload=payload, attachment=sealed, timeout=5.0)
    return [read_outcome(bytes(r.ok.payload)).code for r in replies if r.ok]


@pytest.mark.matrix
@pytest.mark.long
def test_a_demo_of_two_boats_from_shore(tmp_path):
    port, out, text = free_port(), tmp_path / "out", tmp_path / "text.txt"
    command = ["demo", "--config", str(near(tmp_path)), "--boats", "anna,bob", "--stagger", "1", "--out", str(out)]
    command += ["--shore", f"tcp/127.0.0.1:{port}"]
    with router(tmp_path, port), console(port) as shore_side, text.open("w") as file:
        child = subprocess.Popen(aritra(*command), stdout=file, stderr=subprocess.STDOUT)
        try:
            wait_for(lambda: shore_side.alive() == {"aritra/anna/alive", "aritra/bob/alive"}, 120.0, text.read_text)
            names = ("anna", "bob")
            shore_side.runs = {n: json.loads(shore_side.last_values(n)["about"])["run"] for n in names}
            runs = {t.run for topic, t in shore_side.heard if topic == "state"}
            wait_for(lambda: len({t.run for topic, t in list(shore_side.heard) if topic == "state"}) == 2, 60.0)
            keys = {name: load_secret(out / name / "command.key", where="test") for name in names}
            assert runs <= set(shore_side.runs.values()) and keys["anna"] != keys["bob"]
            assert hold(shore_side, "bob", keys["anna"]) == ["unsigned"], "another boat's key"
            child.wait(180)
        finally:
            child.send_signal(signal.SIGINT)
            child.wait(30)
    told = text.read_text()
    assert child.returncode == 0, told
    for name in names:
        summary = json.loads((out / name / "summary.json").read_text())
        assert summary["waypoints_passed"] == summary["waypoints_total"] == 2
        assert (out / name / "picture.png").exists() and f"{name}: info: telemetry: {name} is connected" in told
    seeds = [(out / name / "truth.mcap").read_bytes() for name in names]
    assert seeds[0] != seeds[1], "worlds of their own"
