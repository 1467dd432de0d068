"""Evidence that shore hears a boat whatever is started first, and once the router was started anew: fresh processes."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from companion.boat.load_run import EXAMPLES, load_setup
from companion.boat.recorder import Recorder
from companion.logs.metadata import log_metadata
from tests.evidence.line import Line, at_most, information
from tests.evidence.main_job.parts import ROOT, reference_boat
from tests.evidence.shore.boat import closed_port, messages_of_a_drive
from tests.evidence.shore.field import read_heard

STARTS, FULL_STARTS = 10, 50
UP = {"router": "router ", "console": "listening", "boat": "playing"}
"""What each says once Python has loaded what it needs, which takes 20 s where the machine is busy."""
LIMIT_S = 45.0
"""A console once heard nothing for 40 s."""
SEED = 3
ORDERS = (("router", "console", "boat"), ("router", "boat", "console"), ("boat", "router", "console"),
          ("console", "router", "boat"), ("boat", "console", "router"), ("console", "boat", "router"))  # fmt: skip


def log_of_a_drive(path: Path) -> None:
    """A log of 30 s under way, as `recorded_boats.py` plays it (seed 1, calm)."""
    setup = load_setup(EXAMPLES / "aritra.toml")
    ticks = messages_of_a_drive()
    about = log_metadata(setup.pilot.vessel.name, setup.files)
    with Recorder(path, about, time.monotonic_ns, wall_offset_ns=0) as log:
        for message in (message for tick in ticks for message in tick):
            log.record(message)


class Trio:
    """Router, console and boat, each a process of its own. `heard`: the console's file."""

    def __init__(self, folder: Path, log: Path) -> None:
        self.port, self.heard, self._running = closed_port(), folder / "heard.txt", dict[str, subprocess.Popen]()
        self.heard.write_text("")
        self._out = {name: folder / f"{name}.txt" for name in UP}
        endpoint = f"tcp/127.0.0.1:{self.port}"
        told = {"listen": {"endpoints": [endpoint]}, "scouting": {"multicast": {"enabled": False}}}
        (folder / "router.json5").write_text(json.dumps(told))
        self._commands = {
            "router": [ROOT / "deploy/zenoh/router.py", folder / "router.json5"],
            "console": ["-m", "tests.evidence.shore.listener", endpoint, self.heard],
            "boat": ["-m", "tests.evidence.shore.recorded_boats", endpoint, "1", log],
        }

    def start(self, name: str) -> None:
        words = [sys.executable, *map(str, self._commands[name])]
        self._out[name].write_text("")
        with self._out[name].open("w") as out:
            self._running[name] = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=out, cwd=ROOT)

    def kill(self, name: str) -> None:
        child = self._running.pop(name)
        child.kill()
        child.wait()
        if child.stdin:
            child.stdin.close()

    def wait_s(self) -> float:
        """From when all three say that they are up until a fresh state arrives [s]; infinite after LIMIT_S."""
        while not all(word in self._out[name].read_text() for name, word in UP.items()):
            time.sleep(0.05)
        begun_ns = time.monotonic_ns()
        while (waited := (time.monotonic_ns() - begun_ns) * 1e-9) < LIMIT_S:
            if any(t_ns > begun_ns for t_ns in read_heard(self.heard)):
                return waited
            time.sleep(0.05)
        return float("inf")

    def close(self) -> None:
        for name in list(self._running):
            self.kill(name)


def lines(full: bool) -> Iterator[Line]:
    reference_boat()
    rng, waits = random.Random(SEED), defaultdict[str, list[float]](list)
    with tempfile.TemporaryDirectory(prefix="aritra-") as name:
        folder, log = Path(name), Path(name) / "drive.mcap"
        log_of_a_drive(log)
        for k in range(FULL_STARTS if full else STARTS):
            order = ORDERS[k % len(ORDERS)]
            trio = Trio(folder, log)
            try:
                for each in order:
                    trio.start(each)
                    time.sleep(rng.choice([0.0, 0.5, 3.0]))
                waits[", ".join(order)].append(trio.wait_s())
                trio.kill("router")
                time.sleep(rng.choice([0.0, 1.0, 12.0]))
                trio.start("router")
                waits["router killed and started again"].append(trio.wait_s())
            finally:
                trio.close()
            if k % 10 == 9:
                print(f"  ({k + 1} done)", flush=True)
    for order, seconds in waits.items():
        yield information(f"first fresh state: {order}", max(seconds), "s", f"largest of {len(seconds)}")
    every = [s for seconds in waits.values() for s in seconds]
    note = f"median {np.median(every):.1f} s, of {len(every)}; from when all three are up"
    yield at_most("longest wait for a fresh state", max(every), 10.0, "s", note)
