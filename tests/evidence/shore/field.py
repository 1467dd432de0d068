"""A boat and a shore as real programs in network namespaces, with a bad radio link between them.

namespace boat     aritra sim, aritra run --start (laps of the square, telemetry to 10.77.0.2)
lossy_link         carries IP packets across
namespace shore    deploy/zenoh/router.py, listener
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from companion.boat.load_run import EXAMPLES, RunSetup, load_setup
from companion.core.telemetry.structs import StateNow
from companion.core.telemetry.view import TelemetryView, Who
from companion.logs.log_file import LogFile
from companion.python_child import aritra
from tests.evidence.shore.lossy_link import ADDRESSES

ROOT = Path(__file__).resolve().parents[3]
ENDPOINT = f"tcp/{ADDRESSES[1]}:7447"
LAPS = 100
START_S = 180.0
FRESH_S = 0.5
BACK_S = 40.0
"""How long shore may take to hear the boat again."""


def missing() -> str | None:
    """What keeps this from running here; None: nothing."""
    if os.geteuid() != 0:
        return "needs root, for network namespaces"
    if not shutil.which("ip"):
        return "needs ip, of Debian's package iproute2"
    if not os.access("/dev/net/tun", os.R_OK | os.W_OK):
        return "needs /dev/net/tun"
    return None


class Field:
    """Use as a context. `log`, `silent_log`: of the companion, and of one without telemetry; `heard`: what the listener
    that is always there wrote."""

    def __init__(self, seed: int = 1) -> None:
        self._stack, self._seed = contextlib.ExitStack(), seed
        self._spaces = {side: f"aritra-{side}-{os.getpid()}" for side in ("boat", "shore")}
        self._companions: list[subprocess.Popen] = []
        self.router: subprocess.Popen | None = None

    def __enter__(self) -> Field:
        with self._stack:
            self.folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="aritra-")))
            for space in self._spaces.values():
                subprocess.run(["ip", "netns", "add", space], check=True)
                self._stack.callback(subprocess.run, ["ip", "netns", "del", space], check=False)
            link = [sys.executable, "-m", "tests.evidence.shore.lossy_link", *self._spaces.values(), str(self._seed)]
            self._link = self._popen(link, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            assert self._link.stdout and self._link.stdout.readline() == "carrying\n"
            self.log, self.silent_log = self.folder / "run.mcap", self.folder / "silent.mcap"
            self.heard = self.folder / "heard.txt"
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def set_link(self, **how: float | bool) -> None:
        """Set the radio link; nothing: a good one."""
        assert self._link.stdin and self._link.stdout
        self._link.stdin.write(json.dumps(how) + "\n")
        self._link.stdin.flush()
        self._link.stdout.readline()

    def start_router(self) -> None:
        told = {"listen": {"endpoints": [ENDPOINT]}, "scouting": {"multicast": {"enabled": False}}}
        (self.folder / "router.json5").write_text(json.dumps(told))
        words = [sys.executable, ROOT / "deploy/zenoh/router.py", self.folder / "router.json5"]
        self.router = self._popen(words, "shore", stdout=subprocess.PIPE)
        assert self.router.stdout and self.router.stdout.readline()

    def start_listener(self, file: Path) -> subprocess.Popen:
        """A console that writes what it hears to `file`."""
        words = [sys.executable, "-m", "tests.evidence.shore.listener", ENDPOINT, file]
        return self._popen(words, "shore", stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)

    def start_boat(self) -> None:
        """Simulator and companion, and a second pair that knows no shore; returns once the first drives."""
        self._pair(self._run_file(), "run", 14551)
        self._pair(self._run_file(telemetry=False), "silent", 14561)
        self.wait(lambda: "leg  waypoint" in (self.folder / "run.txt").read_text(), START_S)

    def _pair(self, config: Path, name: str, port: int) -> None:
        tag, log, at = self.folder / f"tag-{name}", self.folder / f"{name}.mcap", f"127.0.0.1:{port}"
        wires = ["--mavlink", f"udpin:{at}", "--uwb", f"serial:{tag}:115200", "--log", log]
        sim = ["sim", "--config", config, "--udp-to", at, "--uwb", tag, "--seed", self._seed]
        for words, text in ((sim, f"sim-{name}.txt"), (["run", "--config", config, "--start", *wires], f"{name}.txt")):
            out = self._stack.enter_context((self.folder / text).open("w"))
            program = aritra(*words)
            child = self._popen(program, "boat", stdout=out, stderr=subprocess.STDOUT)
        self._companions.append(child)

    def end_boat(self) -> None:
        """Ask the companions to end; their logs are whole then."""
        for companion in self._companions:
            companion.send_signal(signal.SIGINT)
        if any(companion.wait(30) for companion in self._companions):
            raise RuntimeError((self.folder / "run.txt").read_text()[-2000:])

    def wait_until_heard(self) -> float:
        """Until the listener hears what the boat does now; seconds that it took. Raises TimeoutError."""
        begun = time.monotonic()
        self.wait(lambda: self._age_s() < FRESH_S, BACK_S)
        return time.monotonic() - begun

    def wait(self, condition, seconds: float) -> None:
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"not within {seconds:g} s: {(self.folder / 'run.txt').read_text()[-2000:]}")
            time.sleep(0.05)

    def in_shore(self, words: list[str]) -> list[str]:
        """A command line that runs in the namespace of the shore."""
        return ["ip", "netns", "exec", self._spaces["shore"], *words]

    def in_boat(self, words: list[str]) -> list[str]:
        """And of the boat."""
        return ["ip", "netns", "exec", self._spaces["boat"], *words]

    def published(self) -> list[int]:
        """Stamps [ns] of every sample of `state` that the boat published, by its log."""
        return states_of(self.log, load_setup(self._run_file()))

    def _age_s(self) -> float:
        """Age of the newest sample heard; the machine's monotonic clock is also the boat's."""
        newest = max(read_heard(self.heard), default=0)
        return (time.monotonic_ns() - newest) * 1e-9

    def _run_file(self, *, telemetry: bool = True) -> Path:
        text = (EXAMPLES / "aritra.toml").read_text()
        for name in ("boats", "sites"):
            text = text.replace(f'"{name}/', f'"{EXAMPLES}/{name}/')
        text = text.replace('"missions/square.toml"', '"laps.toml"')
        corners = "".join(
            f"[[waypoints]]\nnorth_m = {n}\neast_m = {e}\n" for n, e in ((21, 9), (21, 21), (9, 21), (9, 9))
        )
        (self.folder / "laps.toml").write_text(corners * LAPS)
        file = self.folder / ("run.toml" if telemetry else "silent.toml")
        file.write_text(text + (f'\n[telemetry]\nconnect = ["{ENDPOINT}"]\n' if telemetry else ""))
        return file

    def _popen(self, words: list, side: str | None = None, **options) -> subprocess.Popen:
        """A child that ends with the field; `side`: whose namespace it lives in."""
        words = [str(word) for word in words]
        if side:
            words = self.in_shore(words) if side == "shore" else self.in_boat(words)
        child = subprocess.Popen(words, text=True, cwd=ROOT, **options)
        self._stack.callback(_end, child)
        return child


def _end(child: subprocess.Popen) -> None:
    if child.poll() is None:
        child.send_signal(signal.SIGCONT)
        child.terminate()
        try:
            child.wait(10)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
    for pipe in (child.stdin, child.stdout):
        if pipe:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()


def read_heard(file: Path) -> dict[int, int]:
    """Stamp of each state heard -> when it first arrived [ns]."""
    told: dict[int, int] = {}
    for line in file.read_text().splitlines():
        words = line.split()
        if len(words) == 3:
            told.setdefault(int(words[1]), int(words[2]))
    return told


def states_of(log: Path, setup: RunSetup) -> list[int]:
    """What the view makes of a log's messages: the stamps of topic `state`."""
    view = TelemetryView(setup.pilot, Who("run", "digest", "aritra", 0, False), 10.0)
    told = (told for message in LogFile(log).messages() for told in view.see(message))
    return [each.t_ns for each in told if isinstance(each, StateNow)]
