"""`aritra teleop` in a terminal of its own (a pty) against the simulator: what a person types moves the boat."""

import contextlib
import os
import pty
import re
import socket
import subprocess
import threading
import time

import pytest

from companion.__main__ import main
from companion.core.messages import Alert, ManualInput, ModeStatus, OverrideLease
from companion.logs.log_file import LogFile
from tests.processes.test_loopback import ARITRA, DRIVING_S, ENV, GroundStation, free_port, process, wait_for

pytestmark = pytest.mark.real_time

NEUTRAL = (1500,) * 4


class Terminal:
    """A program in a pty: `screen` is all it has drawn, without colours."""

    def __init__(self, command):
        self._master, slave = pty.openpty()
        env = {**ENV, "TERM": "xterm", "COLUMNS": "150", "LINES": "40"}
        self.child = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, env=env, start_new_session=True)
        os.close(slave)
        self._drawn = b""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        with contextlib.suppress(OSError):
            while data := os.read(self._master, 65536):
                self._drawn += data

    @property
    def screen(self):
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self._drawn.decode(errors="replace"))

    def latest(self):
        """The last table."""
        return self.screen.rpartition("aritra teleop")[2]

    def type(self, keys):
        os.write(self._master, keys)

    def hold(self, key, seconds):
        """As a terminal repeats it: at once, after 0.3 s, then 25 times a second."""
        self.type(key)
        time.sleep(0.3)
        end = time.monotonic() + seconds - 0.3
        while time.monotonic() < end:
            self.type(key)
            time.sleep(0.04)

    def close(self):
        if self.child.poll() is None:
            self.child.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.child.wait(10)
        if self.child.poll() is None:
            self.child.kill()
            self.child.wait()
        self._thread.join(5)
        os.close(self._master)


@pytest.mark.long
def test_a_boat_driven_by_hand(tmp_path):
    udp, tcp, tag = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM), tmp_path / "tag"
    command = ["sim", "--udp-to", f"127.0.0.1:{udp}", "--tcp", f"127.0.0.1:{tcp}", "--uwb", str(tag), "--seed", "5"]
    out, log = tmp_path / "sim.txt", tmp_path / "run.mcap"
    with process(command, out), contextlib.ExitStack() as stack:
        wait_for(lambda: "simulator: MAVLink on udp" in out.read_text(), 20.0, out.read_text)
        station = GroundStation(tcp)
        stack.callback(station.close)
        terminal = Terminal([*ARITRA, "teleop", "--mavlink", f"udpin:127.0.0.1:{udp}", "--uwb", f"serial:{tag}:115200",
                             "--log", str(log)])  # fmt: skip
        stack.callback(terminal.close)

        def told():
            return terminal.screen[-3000:]

        def pulses():
            return station.outputs[-1][1]

        wait_for(lambda: "IDLE" in terminal.latest(), DRIVING_S, told)
        terminal.hold(b"w", 1.0)
        assert not station.armed and all(p in (NEUTRAL, (0,) * 4) for _, p in station.outputs), "nothing before R"
        terminal.type(b"r")
        wait_for(lambda: station.armed and "MANUAL" in terminal.latest(), 20.0, told)
        assert pulses() == NEUTRAL
        terminal.type(b"m5")
        holding = threading.Thread(target=terminal.hold, args=(b"w", 2.5))
        holding.start()
        wait_for(lambda: all(p > 1500 for p in pulses()) or all(abs(p - 1500) > 20 for p in pulses()), 10.0, told)
        holding.join()
        released_ns = time.monotonic_ns()
        wait_for(lambda: pulses() == NEUTRAL, 5.0, told)
        driven = [t_ns for t_ns, p in station.outputs if p != NEUTRAL and any(p)]
        print(f"neutral {(driven[-1] - released_ns) * 1e-9:.2f} s after the key was let go of")
        terminal.type(b"m")
        holding = threading.Thread(target=terminal.hold, args=(b"d", 1.5))
        holding.start()
        wait_for(lambda: pulses() != NEUTRAL, 10.0, told)
        holding.join()
        terminal.type(b" ")
        wait_for(lambda: pulses() == NEUTRAL and "IDLE" in terminal.latest(), 5.0, told)
        terminal.type(b"\x04")
        assert terminal.child.wait(20) == 0, told()
        wait_for(lambda: not station.armed, 3.0, told)
    file = LogFile(log)
    messages = list(file.messages(Alert, ManualInput, ModeStatus, OverrideLease))
    marks = [m.text for m in messages if isinstance(m, Alert) and m.text.startswith("mark ")]
    assert marks == ["mark 1 begins", "mark 1 ends"]
    shares = {(m.surge, m.sway, m.yaw) for m in messages if isinstance(m, ManualInput)}
    assert {(0.5, 0, 0), (0, 0, 0.5), (0, 0, 0)} <= shares
    assert {"idle", "locked", "manual"} <= {m.mode for m in messages if isinstance(m, ModeStatus)}
    assert {m.source for m in messages if isinstance(m, OverrideLease)} == {"neutral", "manual"}
    assert main(["replay", str(log)]) == 0


def test_without_a_terminal_it_says_so(capsys, monkeypatch):
    with open(os.devnull) as nothing:
        monkeypatch.setattr("sys.stdin", nothing)
        assert main(["teleop"]) == 2
    assert "needs a terminal" in capsys.readouterr().err
