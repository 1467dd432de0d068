"""`aritra check` and `aritra provision` as processes beside `aritra sim`: refused, set up, accepted."""

import contextlib
import json
import os
import socket
import subprocess
import time

import pytest

from companion.core.preflight.parameter_diff import changes
from companion.python_child import aritra
from sim.world.autopilot.parameter_table import BOARD_PARAMETERS
from sim.world.autopilot.parameters import ParameterStore
from tests.sim.world.wirings.wiring_fixture import load

pytestmark = pytest.mark.real_time

ARITRA = aritra()
ENV = {**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "160"}
SOON = 90.0


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Boat:
    """A simulator that runs, and commands to run beside it."""

    def __init__(self, folder):
        self.folder, self.udp, self.tcp = folder, free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
        self.tag, self.told = folder / "tag", folder / "sim.txt"

    @contextlib.contextmanager
    def sailing(self, *options):
        wires = ["--udp-to", f"127.0.0.1:{self.udp}", "--tcp", f"127.0.0.1:{self.tcp}", "--uwb", str(self.tag)]
        with self.told.open("w") as out:
            child = subprocess.Popen([*ARITRA, "sim", *wires, *options], stdout=out, stderr=subprocess.STDOUT, env=ENV)
            try:
                end = time.monotonic() + SOON
                while "simulator: MAVLink on udp" not in self.told.read_text():
                    assert child.poll() is None and time.monotonic() < end, self.told.read_text()
                    time.sleep(0.05)
                yield self
            finally:
                child.terminate()
                child.wait(20)

    def run(self, *words):
        done = subprocess.run(
            [*ARITRA, *words],
            env=ENV,
            capture_output=True,
            text=True,
            timeout=SOON,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        assert "Traceback" not in done.stderr, done.stderr
        return done

    def check(self, *options):
        wires = ["--mavlink", f"udpin:127.0.0.1:{self.udp}", "--uwb", f"serial:{self.tag}:115200"]
        return self.run("check", *wires, "--listen-s", "3", *options)

    def provision(self, *options):
        return self.run("provision", "--mavlink", f"tcp:127.0.0.1:{self.tcp}", *options)


def rows(done):
    told = json.loads(done.stdout)
    return told["verdict"], {row["name"]: row for row in told["rows"]}


@pytest.mark.long
def test_plain_pass_through_is_refused_provisioned_and_then_accepted(tmp_path):
    with Boat(tmp_path).sailing("--wiring", "unsafe_plain") as boat:
        refused = boat.check()
        assert refused.returncode == 1, refused.stdout + refused.stderr
        told = " ".join(refused.stdout.split())
        assert "LAST PULSE STAYS ON THE THRUSTERS FOR EVER" in told and "DO NOT START" in told
        assert "aritra provision --wiring gate" in told

        wires = ["--mavlink", f"udpin:127.0.0.1:{boat.udp}", "--uwb", f"serial:{boat.tag}:115200"]
        started = boat.run("run", *wires, "--log", str(tmp_path / "run.mcap"), "--start")
        assert started.returncode == 1, started.stdout + started.stderr
        assert "start refused: the boat might not stop" in started.stdout

        done = boat.provision("--wiring", "gate", "--yes", "--reboot")
        assert done.returncode == 0, done.stdout + done.stderr
        before = ParameterStore({**BOARD_PARAMETERS, **load("unsafe_plain")}).saved()
        n = len(changes(before, load("gate")))
        assert n > 10 and f"wrote and read back {n} of {n} parameters" in done.stdout
        assert "gate.lua is in /APM/scripts" in done.stdout
        time.sleep(4.5)  # it restarts

        accepted = boat.check("--json")
        verdict, found = rows(accepted)
        assert accepted.returncode == 0, [row for row in found.values() if row["level"] == "refuse"]
        assert verdict in ("ok", "warning")
        assert found["SERVO1-4_FUNCTION"]["found"] == "94-97 (script)" and found["output 1-4"]["found"] == "1500 us"
        assert found["state"]["found"].startswith(("healthy", "it has started"))
