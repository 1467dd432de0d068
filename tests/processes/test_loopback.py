"""Two processes on real wires, in real time: what is left when the companion is killed, and how it ends when asked."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import threading
import time

import numpy as np
import psutil
import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.__main__ import main
from companion.core.messages import GroundTruth, GuidanceReference, OverrideLease, Tick
from companion.logs.log_file import LogFile
from companion.logs.recover import recover
from companion.python_child import aritra

pytestmark = pytest.mark.real_time

ARITRA = aritra()
ENV = {**os.environ, "PYTHONUNBUFFERED": "1"}
DRIVING_S = 40.0


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def process(command, out):
    """A child whose output goes to a file; asked to end at the end."""
    with out.open("w") as file:
        child = subprocess.Popen([*ARITRA, *command], stdout=file, stderr=subprocess.STDOUT, env=ENV)
        try:
            yield child
        finally:
            if child.poll() is None:
                child.terminate()
            try:
                child.wait(10)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()


def wait_for(condition, seconds, what):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if result := condition():
            return result
        time.sleep(0.05)
    raise AssertionError(f"not within {seconds} s: {what()}")


class GroundStation:
    """A second MAVLink peer over TCP that watches the autopilot's outputs. `outputs`: (arrival [ns], pulses 1-4)."""

    def __init__(self, port):
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=5)
        self._mav = wire.MAVLink(None, 255, 190)
        self.outputs, self.armed = [], False
        self._ended = False
        ask = wire.MAVLink_command_long_message(1, 1, 511, 0, 36, 20_000, 0, 0, 0, 0, 0)
        self._socket.sendall(ask.pack(self._mav))
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self):
        parser = wire.MAVLink(None)
        parser.robust_parsing = True
        with contextlib.suppress(OSError):
            while not self._ended and (data := self._socket.recv(4096)):
                now_ns = time.monotonic_ns()
                for m in parser.parse_buffer(data) or []:
                    if m.get_type() == "SERVO_OUTPUT_RAW":
                        self.outputs.append((now_ns, (m.servo1_raw, m.servo2_raw, m.servo3_raw, m.servo4_raw)))
                    elif m.get_type() == "HEARTBEAT":
                        self.armed = bool(m.base_mode & 128)

    def close(self):
        self._ended = True
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join(5)
        self._socket.close()


class Loopback:
    """A simulator that runs, and companions to start beside it."""

    def __init__(self, folder):
        self.folder, self.udp = folder, free_port(socket.SOCK_DGRAM)
        self.tcp, self.uwb, self.truth = free_port(socket.SOCK_STREAM), folder / "tag", folder / "truth.mcap"
        self.station: GroundStation | None = None

    @property
    def sim_command(self):
        return ["sim", "--udp-to", f"127.0.0.1:{self.udp}", "--tcp", f"127.0.0.1:{self.tcp}", "--uwb", str(self.uwb),
                "--truth", str(self.truth), "--seed", "5"]  # fmt: skip

    @contextlib.contextmanager
    def companion(self, name):
        log = self.folder / f"{name}.mcap"
        wires = ["--mavlink", f"udpin:127.0.0.1:{self.udp}", "--uwb", f"serial:{self.uwb}:115200"]
        out = self.folder / f"{name}.txt"
        with process(["run", *wires, "--log", str(log), "--start"], out) as child:
            seen = len(self.station.outputs)

            def under_way():
                assert child.poll() is None, out.read_text()
                return sum(any(abs(p - 1500) > 30 for p in pulses) for _, pulses in self.station.outputs[seen:]) > 25

            wait_for(under_way, DRIVING_S, out.read_text)
            yield child, log


@pytest.fixture(scope="module")
def loopback(tmp_path_factory):
    made = Loopback(tmp_path_factory.mktemp("loopback"))
    out = made.folder / "sim.txt"
    with process(made.sim_command, out) as made.simulator:
        wait_for(lambda: "simulator: MAVLink on udp" in out.read_text(), 20.0, out.read_text)
        made.station = GroundStation(made.tcp)
        yield made
        made.station.close()
    assert made.simulator.returncode == 0, out.read_text()


@pytest.mark.long
def test_a_companion_that_is_killed_leaves_a_log_and_neutral_thrusters(loopback, tmp_path):
    with loopback.companion("killed") as (child, log):
        time.sleep(1.5)
        killed_ns = time.monotonic_ns()
        child.send_signal(signal.SIGKILL)
        assert child.wait(5) == -signal.SIGKILL
        time.sleep(1.5)
    pulses = loopback.station.outputs
    before = [p for t_ns, p in pulses if killed_ns - 3e8 < t_ns < killed_ns]
    assert any(p != (1500,) * 4 for p in before)
    driven = [t_ns for t_ns, p in pulses if p != (1500,) * 4]
    neutral_s = (driven[-1] - killed_ns) * 1e-9
    report = recover(log, tmp_path / "sound.mcap")
    lost_s = (killed_ns - report.last_t_ns) * 1e-9
    print(f"neutral {neutral_s:.2f} s after the kill, {lost_s:.2f} s of log lost")
    assert neutral_s < 0.7
    assert -0.05 < lost_s <= 1.0
    assert report.messages > 1000 and not LogFile(tmp_path / "sound.mcap").damage
    assert main(["replay", str(tmp_path / "sound.mcap")]) == 0
    assert main(["replay", str(log)]) == 0, "and so does the damaged one"


@pytest.mark.long
def test_a_companion_that_is_asked_to_end_ends_in_neutral_disarmed(loopback):
    """The second companion in the same simulation: the autopilot is still armed from the first."""
    with loopback.companion("asked") as (child, log):
        asked_ns = time.monotonic_ns()
        child.send_signal(signal.SIGINT)
        assert child.wait(10) == 0, (loopback.folder / "asked.txt").read_text()
        ended_ns = time.monotonic_ns()
    assert 0.9 < (ended_ns - asked_ns) * 1e-9 < 4.0
    wait_for(lambda: not loopback.station.armed, 3.0, lambda: "still armed")
    file = LogFile(log)
    messages = list(file.messages(Tick, OverrideLease, GuidanceReference))
    assert not file.damage
    ticks, leases = ([x.index for x in messages if isinstance(x, kind)] for kind in (Tick, OverrideLease))
    assert ticks == leases and len(ticks) > 30
    assert main(["replay", str(log)]) == 0
    time.sleep(0.6)
    truth = list(LogFile(loopback.truth).messages(GroundTruth))
    forces = {x.t_ns: np.abs(x.f_n).max() for x in truth}
    driven = max(f for t_ns, f in forces.items() if asked_ns - 1e9 < t_ns < asked_ns)
    after = [f for t_ns, f in forces.items() if t_ns > asked_ns + 0.9e9]
    assert driven > 1.0 and after and max(after) < 0.01
    assert all(x.pwm_us == (1500,) * 8 for x in messages if isinstance(x, OverrideLease) and x.t_ns > asked_ns + 1e8)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 130), (signal.SIGKILL, -signal.SIGKILL)])
def test_a_demo_that_ends_leaves_nobody_behind(number, code, tmp_path):
    """Asked to end, or killed: simulator and companion drove on, for ever."""
    with process(["demo", "--out", str(tmp_path / "out")], tmp_path / "text.txt") as child:
        started = psutil.Process(child.pid)
        wait_for(lambda: len(started.children()) == 2, 30.0, (tmp_path / "text.txt").read_text)
        both = started.children()
        child.send_signal(number)
        assert child.wait(30) == code, (tmp_path / "text.txt").read_text()
    assert not psutil.wait_procs(both, timeout=20)[1]


@pytest.mark.long
def test_the_demo(tmp_path):
    """Everything at once, on a short mission; the figures of the demo's own are judged by the evidence script."""
    (tmp_path / "corner.toml").write_text(
        "".join(f"[[waypoints]]\nnorth_m = {n}\neast_m = {e}\n" for n, e in ((10, 9), (15, 9), (15, 11)))
    )
    command = ["demo", "--out", tmp_path, "--seed", "2", "--mission", tmp_path / "corner.toml"]
    done = subprocess.run(
        [*ARITRA, *map(str, command)], env=ENV, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    print(summary)
    assert summary["waypoints_passed"] == summary["waypoints_total"] == 3
    assert summary["leases"] == summary["ticks"] > 300
    assert summary["cross_track_rms_m"] <= 0.15 and summary["position_rmse_m"] <= 0.2
    assert (tmp_path / "picture.png").stat().st_size > 20_000
    assert main(["replay", str(tmp_path / "run.mcap")]) == 0
    assert main(["log", "info", str(tmp_path / "run.mcap")]) == 0
