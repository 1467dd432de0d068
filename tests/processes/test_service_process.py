"""A real companion under a service manager that is a real datagram socket; the autopilot's wire is a TCP port.

Nobody speaks on the wire: leases are sent all the same, neutral ones. What is tested is what they prove.
"""

import contextlib
import os
import signal
import socket
import subprocess
import threading
import time
from itertools import pairwise

import pytest

from companion.boat.load_run import EXAMPLES
from companion.core.messages import LoopTiming, OverrideLease, VehicleRequest
from companion.logs.log_file import LogFile
from companion.python_child import aritra, python

pytestmark = pytest.mark.real_time

ARITRA = aritra()
WATCHDOG_S = 2.0
STARTED_S = 40.0


class Manager:
    """Collects what a child says on NOTIFY_SOCKET: (arrival [s], line)."""

    def __init__(self, path):
        self.said, self._ended = [], False
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(0.1)
        self.environ = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": str(round(WATCHDOG_S * 1e6))}
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self):
        while not self._ended:
            with contextlib.suppress(TimeoutError):
                data = self._socket.recv(65536)
                now = time.monotonic()
                self.said += [(now, line) for line in data.decode().split("\n")]

    def close(self):
        self._ended = True
        self._thread.join(5)
        self._socket.close()

    def of(self, start, since=0.0):
        return [t for t, line in list(self.said) if line.startswith(start) and t >= since]

    @property
    def status(self):
        return next((line for _, line in reversed(list(self.said)) if line.startswith("STATUS=")), "")


class Wire:
    """The autopilot's end: a TCP port that swallows what comes. While closed, connecting is refused."""

    def __init__(self):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]

    @contextlib.contextmanager
    def open(self):
        end = threading.Event()
        with socket.create_server(("127.0.0.1", self.port)) as server:
            server.settimeout(0.1)
            thread = threading.Thread(target=self._swallow, args=(server, end), daemon=True)
            thread.start()
            try:
                yield
            finally:
                end.set()
                thread.join(5)

    def _swallow(self, server, end):
        peers = []
        while not end.is_set():
            with contextlib.suppress(TimeoutError):
                peer, _ = server.accept()
                peer.settimeout(0.05)
                peers.append(peer)
            for peer in peers:
                with contextlib.suppress(OSError):
                    peer.recv(65536)
        for peer in peers:
            peer.close()


def wait_for(condition, seconds, what):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return
        time.sleep(0.02)
    raise AssertionError(f"not within {seconds} s; {what()}")


class Bench:
    def __init__(self, folder):
        self.folder, self.wire, self.manager = folder, Wire(), Manager(folder / "notify")
        self.log, self.out = folder / "run.mcap", folder / "out.txt"

    @contextlib.contextmanager
    def companion(self, *words, command=ARITRA):
        command = [*command, "run", "--mavlink", f"tcp:127.0.0.1:{self.wire.port}", "--log", str(self.log)]
        command += ["--uwb", f"serial:{self.folder}/no-tag:115200", *words]
        env = {**os.environ, **self.manager.environ}
        with self.out.open("w") as out:
            child = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, env=env)
            try:
                yield child
            finally:
                if child.poll() is None:
                    child.kill()
                child.wait()

    def told(self):
        return f"said {self.manager.said}; printed {self.out.read_text()}"

    def wait(self, condition, seconds):
        wait_for(condition, seconds, self.told)


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.manager.close()


@pytest.mark.long
def test_only_leases_that_were_sent_make_it_ready_and_keep_it_alive(bench):
    said = bench.manager
    with bench.companion() as child:
        bench.wait(lambda: "STATUS=no wire to the autopilot: cannot open tcp:" in said.status, STARTED_S)
        time.sleep(1.0)
        assert said.of("EXTEND_TIMEOUT_USEC="), "the start takes as long as the wire does"
        assert not said.of("READY") and not said.of("WATCHDOG"), "ready without a lease on the wire"

        with bench.wire.open():
            opened = time.monotonic()
            bench.wait(lambda: said.of("READY=1"), 5.0)
            bench.wait(lambda: said.status == "STATUS=neutral: waiting for the operator's start", 5.0)
            bench.wait(lambda: len(said.of("WATCHDOG=1", opened)) >= 5, 10.0)
        closed = time.monotonic()
        time.sleep(1.5)
        pets = said.of("WATCHDOG=1", opened)
        gaps = [b - a for a, b in pairwise(pets)]
        print(f"{len(pets)} pets, longest gap {max(gaps):.2f} s, last {pets[-1] - closed:+.2f} s after the wire closed")
        assert max(gaps) < WATCHDOG_S, "a busy machine may delay, but not as long as this"
        assert not said.of("WATCHDOG=1", closed + 0.5), "alive without a lease on the wire"
        assert "no wire to the autopilot" in said.status

        with bench.wire.open():
            reopened = time.monotonic()
            bench.wait(lambda: said.of("WATCHDOG=1", reopened), 5.0)
            child.send_signal(signal.SIGSTOP)
            time.sleep(0.3)
            stopped = time.monotonic()
            time.sleep(1.0)
            assert not said.of("", stopped), "a stopped process says nothing"
            child.send_signal(signal.SIGCONT)
            bench.wait(lambda: said.of("WATCHDOG=1", stopped), 5.0)

            asked = time.monotonic()
            child.send_signal(signal.SIGTERM)
            assert child.wait(10) == 0, bench.told()
            time.sleep(0.3)
    lines = [line for _, line in said.said]
    assert lines.count("READY=1") == lines.count("STOPPING=1") == 1
    assert said.of("STOPPING=1")[0] - asked < 0.7, "said when the end begins, a second before it"
    assert lines[-2:] == ["STOPPING=1", "STATUS=stopping: neutral for a second, then disarm and release"]
    messages = list(LogFile(bench.log).messages(LoopTiming, OverrideLease, VehicleRequest))
    timings = [m for m in messages if isinstance(m, LoopTiming)]
    assert not timings[0].sent and {m.sent for m in timings} == {True, False}
    first_sent = next(m for m in timings if m.sent)
    assert first_sent.t_ns * 1e-9 <= said.of("READY=1")[0] < first_sent.t_ns * 1e-9 + 0.5
    assert {p for m in messages if isinstance(m, OverrideLease) for p in m.pwm_us} == {1500}, "idle: neutral only"
    assert not any(isinstance(m, VehicleRequest) for m in messages), "idle: it neither arms nor changes the mode"


@pytest.mark.long
def test_it_keeps_its_folder_within_the_quota_from_the_start(bench):
    logs = bench.folder / "logs"
    logs.mkdir()
    for day, size in [(1, 600_000), (2, 600_000), (3, 300_000)]:
        old = logs / f"aritra-2026010{day}-120000.mcap"
        old.write_bytes(bytes(size))
        os.utime(old, (1.7e9 + day, 1.7e9 + day))
    (logs / "keep-me.mcap").write_bytes(bytes(5_000_000))
    config = bench.folder / "boat.toml"
    text = (EXAMPLES / "aritra.toml").read_text()
    for name in ("boats", "sites", "missions"):
        text = text.replace(f'"{name}/', f'"{EXAMPLES}/{name}/')
    config.write_text(text + '\n[log]\nfolder = "logs"\nquota_MB = 1.0\n')
    bench.log = logs / "aritra-20260104-120000.mcap"
    with bench.companion("--config", str(config)) as child:
        bench.wait(bench.log.exists, STARTED_S)
        bench.wait(lambda: "STATUS=no wire" in bench.manager.status, STARTED_S)
        child.send_signal(signal.SIGTERM)
        assert child.wait(10) == 0, bench.told()
    names = sorted(path.name for path in logs.iterdir())
    assert names == [f"aritra-2026010{n}-120000.mcap" for n in (2, 3, 4)] + ["keep-me.mcap"]
    assert "old logs deleted for log.quota_MB: aritra-20260101-120000.mcap" in bench.out.read_text()


FULL = """
import errno, os, sys
from pathlib import Path
from companion.__main__ import main

real, full = os.fsync, Path(sys.argv.pop(1))

def fsync(descriptor):
    if full.exists():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    real(descriptor)

os.fsync = fsync
sys.exit(main())
"""
"""`aritra` on a disk that is full for as long as a file is there."""


@pytest.mark.long
def test_on_a_disk_that_is_full_it_starts_and_records_once_there_is_room(bench):
    full = bench.folder / "full"
    full.touch()
    with bench.wire.open(), bench.companion(command=python("-c", FULL, str(full))) as child:
        bench.wait(lambda: bench.manager.of("READY=1"), STARTED_S)
        assert not bench.log.exists()
        assert "No space left on device" in bench.out.read_text()
        assert "runs without a recording" in bench.out.read_text()
        full.unlink()
        bench.wait(bench.log.exists, 10.0)
        time.sleep(0.5)
        child.send_signal(signal.SIGTERM)
        assert child.wait(10) == 0
    assert any(isinstance(m, OverrideLease) for m in LogFile(bench.log).messages())
