"""`aritra sim --ardupilot-json` as a real process and a firmware (`json_firmware`) as another, in lockstep over UDP."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from companion.core.messages import GroundTruth, UwbRanges
from companion.logs.log_file import LogFile
from companion.python_child import aritra
from drivers.uwb import uwb_codec
from tests.sim.world.sitl.sitl_fixture import packet
from tests.support.drive_fixture import setup

pytestmark = pytest.mark.real_time

FIRMWARE = [sys.executable, str(Path(__file__).with_name("json_firmware.py"))]
ENV = {**os.environ, "PYTHONUNBUFFERED": "1"}
REST, AHEAD, ASTERN = (1500,) * 4, (1600,) * 4, (1400,) * 4
TURN = (1650, 1350, 1650, 1350)
"""Starboard: the port thrusters push, the starboard ones pull; in an X nothing but a moment is left."""
PATIENT_S = 120.0


class Simulator:
    """One at a time on the same port; what it says goes to a file."""

    def __init__(self, folder):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.uwb, self.truth, self._out, self._child = folder / "tag", folder / "truth.mcap", folder / "sim.txt", None

    @property
    def said(self):
        return self._out.read_text()

    def start(self, *words):
        self.truth.unlink(missing_ok=True)
        wires = ["--ardupilot-json", f"127.0.0.1:{self.port}", "--uwb", str(self.uwb), "--truth", str(self.truth)]
        command = aritra("sim", *wires, "--start", "8", "8", "0", *words)
        with self._out.open("w") as file:
            self._child = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, env=ENV)
        wait_for(lambda: "waiting for ArduPilot" in self.said, self)

    def stop(self):
        self._child.terminate()
        assert self._child.wait(PATIENT_S) == 0, self.said

    def kill(self):
        self._child.kill()
        self._child.wait()


def wait_for(condition, simulator):
    end = time.monotonic() + PATIENT_S
    while not condition():
        assert time.monotonic() < end, simulator.said
        time.sleep(0.05)


def fly(simulator, *program, options=()):
    done = subprocess.run(
        [*FIRMWARE, str(simulator.port), "--program", json.dumps(program), *options],
        capture_output=True, text=True, timeout=PATIENT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr + simulator.said
    return json.loads(done.stdout)


@contextlib.contextmanager
def running(folder, *words):
    made = Simulator(folder)
    made.start(*words)
    try:
        yield made
    finally:
        made.kill()


@pytest.fixture
def simulator(tmp_path):
    with running(tmp_path) as made:
        yield made


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """For what leaves a simulator as good as it was."""
    with running(tmp_path_factory.mktemp("shared")) as made:
        yield made


def test_forward_thrust_moves_the_boat_north_and_a_couple_turns_it(simulator):
    """The firmware starts at 1200 Hz and comes down to its loop rate of 200 Hz, as the real one does."""
    seen = fly(simulator, (1, REST), (7, AHEAD), (9, REST), (11, TURN))
    assert seen["refused_states"] == seen["refused_steps"] == seen["resets"] == 0
    assert seen["rates"][0] == 1200 and seen["rates"][-1] == 200 and len(seen["rates"]) > 100
    at = {round(s["clock_s"]): s for s in seen["trace"]}
    assert next(s for s in seen["trace"] if s["clock_s"] > 0.9)["position"] == pytest.approx([8, 8, 0], abs=1e-3)
    assert at[7]["position"][0] > 10 and at[7]["position"][1] == pytest.approx(8, abs=0.05)
    assert at[7]["velocity"][0] > 0.5 and abs(at[7]["attitude"][2]) < 0.05
    assert at[4]["accel_body"][0] > 0.05, "it speeds up"
    assert seen["state"]["gyro"][2] > 0.3 and 0.3 < seen["state"]["attitude"][2] < 3.0
    simulator.stop()
    truth = list(LogFile(simulator.truth).messages(GroundTruth))
    assert len(truth) > 150 and truth[-1].north_m == pytest.approx(seen["state"]["position"][0], abs=0.1)
    frames = simulator.said.rpartition("simulator: ")[2]
    assert frames.startswith(f"{seen['frames']} frames, 0 asked for again, 0 missed")


@pytest.mark.long
def test_losses_and_repeats_change_nothing_and_a_firmware_started_again_begins_anew(shared):
    """Some datagrams lost, either way: the same flight to the last digit. With 32 outputs, too."""
    program = (1, REST), (4, AHEAD), (6, TURN)
    slow = ("--rate", "200")
    first = fly(shared, *program, options=slow)
    bad = fly(shared, *program, options=(*slow, "--lose-every", "401", "--resend", "0.7", "--outputs", "32"))
    assert first["resends"] == 0 and bad["resends"] >= 4
    assert bad["state"] == first["state"] and bad["trace"] == first["trace"]
    assert "firmware started again (frame 0 after" in shared.said and "32 outputs" in shared.said
    assert "missed" not in shared.said


@pytest.mark.long
def test_a_timestamp_that_goes_back_is_a_reset_that_the_firmware_survives(simulator):
    """The simulator is killed and started again under a firmware that runs on and asks again; `--speed` holds it."""
    program = json.dumps([(30, AHEAD)])
    firmware = subprocess.Popen(
        [*FIRMWARE, str(simulator.port), "--program", program, "--resend", "0.6"], stdout=subprocess.PIPE, text=True
    )
    wait_for(lambda: "firmware at" in simulator.said, simulator)
    time.sleep(0.5)  # so that the clock that begins anew is behind
    simulator.kill()
    simulator.start("--speed", "20")
    began = time.monotonic()
    out, _ = firmware.communicate(timeout=PATIENT_S)
    seen, took_s = json.loads(out), time.monotonic() - began
    assert seen["resets"] == 1 and seen["refused_steps"] == 0 and seen["resends"] > 0
    assert 10 < seen["state"]["timestamp"] < seen["clock_s"] and seen["clock_s"] >= 30
    assert took_s > seen["state"]["timestamp"] / 20 - 0.3
    simulator.stop()
    assert "frame 0," not in simulator.said and "0 missed" in simulator.said


@pytest.mark.long
def test_a_firmware_that_pauses_is_told_of_and_goes_on_where_it_was(shared):
    seen = fly(shared, (2, AHEAD), (4, REST), options=("--pause", "2", "3.5"))
    steps = [b["timestamp"] - a["timestamp"] for a, b in zip(seen["trace"], seen["trace"][1:], strict=False)]
    assert max(steps) < 0.2, "the world stood still"
    assert "firmware silent for 2 s" in shared.said and "firmware back after 3." in shared.said


@pytest.mark.long
def test_the_tag_is_on_its_terminal_as_in_the_loopback(shared):
    uwb = setup().pilot.vessel.sensors.uwb
    codec, heard, ended = uwb_codec(uwb.wire_format, "tag", uwb.rate_Hz), [], threading.Event()
    tag = os.open(shared.uwb, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def listen():
        for data in codec.start_bytes():
            os.write(tag, data)
        while not ended.wait(0.02):
            now_ns = time.monotonic_ns()
            for data in codec.step(now_ns):
                os.write(tag, data)
            with contextlib.suppress(BlockingIOError):
                heard.extend(codec.feed(os.read(tag, 4096), now_ns))

    listener = threading.Thread(target=listen)
    listener.start()
    try:
        fly(shared, (40, REST), options=("--pause", "1", "1"))
        wait_for(lambda: any(isinstance(m, UwbRanges) for m in heard), shared)
    finally:
        ended.set()
        listener.join()
        os.close(tag)
    ranges = next(m for m in heard if isinstance(m, UwbRanges)).ranges
    assert len(ranges) == 4 and all(1 < r.range_m < 40 for r in ranges)


@pytest.mark.long
def test_the_companion_drives_a_firmware_that_flies_this_boat(simulator, tmp_path):
    """Three processes: `aritra run` over TCP, an autopilot that lives on the JSON interface, the boat. First leg."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        tcp = probe.getsockname()[1]
    program = aritra()
    wires = ["--mavlink", f"tcp:127.0.0.1:{tcp}", "--uwb", f"serial:{simulator.uwb}:115200"]
    log, out = tmp_path / "run.mcap", tmp_path / "run.txt"
    with contextlib.ExitStack() as stack, out.open("w") as file:
        rover = [sys.executable, str(Path(__file__).with_name("json_rover.py")), str(simulator.port), str(tcp)]
        for command in (rover, [*program, "run", *wires, "--log", str(log), "--start"]):
            child = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, env=ENV)
            stack.callback(child.wait, PATIENT_S)
            stack.callback(child.terminate)

        def driven():
            return "waypoint 2/5" in out.read_text()

        end = time.monotonic() + PATIENT_S
        while time.monotonic() < end and not driven():
            time.sleep(0.5)
        assert driven(), out.read_text() + simulator.said
    simulator.stop()
    truth = list(LogFile(simulator.truth).messages(GroundTruth))
    assert max(m.north_m for m in truth) > 18
    assert all(abs(m.east_m - 9) < 0.6 for m in truth if 11 < m.north_m < 19), "along the first leg, E = 9 m"


def test_what_is_not_a_servo_packet_is_told_and_does_not_stop_it(shared):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(1.0)
        other.sendto(b"hello", ("127.0.0.1", shared.port))
        answer, asked = b"", time.monotonic()
        while not answer and time.monotonic() < asked + PATIENT_S:  # not while the firmware before may still be there
            other.sendto(packet(0), ("127.0.0.1", shared.port))
            with contextlib.suppress(TimeoutError):
                answer = other.recv(4096)
        assert answer.startswith(b'\n{"timestamp":0.005,'), "the answer goes to the sender's port"
    assert "5 bytes, a servo packet has 40 or 72" in shared.said
