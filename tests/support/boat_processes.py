"""A boat of real processes in real time: `aritra sim` with the simulated autopilot, or with a firmware that is named.

    with boat_processes(folder, binary, defaults) as boat:
        boat.command("check")               # a command of ours beside it, to its end

The firmware's scripts are in its folder `scripts`, on a board in `APM/scripts`: here both are one.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from companion.core.messages import GroundTruth
from companion.logs.log_file import LogFile
from companion.python_child import aritra
from tests.support.autopilots.firmware_world import HERE

ENV = {**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "160"}
START = 8.0, 8.0, 20.0
HOME = "12.9915,80.2337,0,0"
"""Origin of deploy/sites/basin.toml."""
PATIENCE_S, END_S = 300.0, 60.0
"""For a command, and for a process to end: far above what either takes on a busy machine."""
INSTANCES = range(150, 250)
"""ArduPilot's -I, a byte; others use lower ones."""


@dataclass(frozen=True)
class BoatProcesses:
    """`url`: MAVLink; `tag`: UWB; `truth`: the simulator's log, whole once it has ended."""

    folder: Path
    url: str
    tag: Path
    truth: Path

    def words(self, name: str, *options: str) -> list[str]:
        """Command line of `aritra NAME` for this boat."""
        tag = [] if name == "provision" else ["--uwb", f"serial:{self.tag}:115200"]
        return aritra(name, "--mavlink", self.url, *tag, *options)

    def command(self, name: str, *options: str) -> subprocess.CompletedProcess[str]:
        """Run `aritra NAME` to its end."""
        return subprocess.run(
            self.words(name, *options), env=ENV, cwd=self.folder, capture_output=True, text=True, errors="replace",
            timeout=PATIENCE_S,
            check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip

    def driven_m(self) -> float:
        """How far the boat has been from its start [m]."""
        places = [m for m in LogFile(self.truth).messages() if isinstance(m, GroundTruth)]
        return max((math.hypot(m.north_m - START[0], m.east_m - START[1]) for m in places), default=0.0)


@contextlib.contextmanager
def boat_processes(folder: Path, binary: Path | None, defaults: Path | None) -> Iterator[BoatProcesses]:
    """`binary`: the firmware, None: the simulated autopilot; `defaults`: parameter file that it has from the start."""
    tag, truth = folder / "tag", folder / "truth.mcap"
    instance = free_instance()
    tcp, fdm = 5760 + 10 * instance, 9002 + 10 * instance
    boat = BoatProcesses(folder, f"tcp:127.0.0.1:{tcp}", tag, truth)
    words = ["sim", "--uwb", str(tag), "--truth", str(truth), "--start", *map(str, START)]
    if binary:
        words += ["--ardupilot-json", f"127.0.0.1:{fdm}"]
    else:
        words += ["--tcp", f"127.0.0.1:{tcp}", "--udp-to", f"127.0.0.1:{fdm}"]
        words += ["--wiring", defaults.stem if defaults else "unsafe_plain"]
    with contextlib.ExitStack() as stack:
        said = stack.enter_context(child(aritra(*words), folder / "sim.txt"))
        wait_for(lambda: "simulator: " in said.read_text(), PATIENCE_S, said.read_text)
        if binary:
            room = folder / "firmware"
            (room / "APM" / "scripts").mkdir(parents=True)
            (room / "scripts").symlink_to("APM/scripts")
            here = room / "here.param"
            board = {name: value for name, value in HERE.items() if name != "MAV_GCS_SYSID"}
            here.write_text("".join(f"{name},{value:g}\n" for name, value in board.items()), encoding="utf-8")
            files = ",".join(str(path) for path in (here, defaults) if path)
            fw = [
                binary,
                "--model",
                "JSON:127.0.0.1",
                "--home",
                HOME,
                "--speedup",
                1,
                f"-I{instance}",
                "--defaults",
                files,
            ]
            console = stack.enter_context(child([*map(str, fw)], room / "console.txt", cwd=room))
            words = partial(console.read_text, encoding="utf-8", errors="replace")
            wait_for(lambda: "SERIAL0 on TCP port" in words(), PATIENCE_S, words)
        yield boat


@contextlib.contextmanager
def child(words: list[str], out: Path, cwd: Path | None = None) -> Iterator[Path]:
    """A process whose output goes to a file, which is yielded; it is asked to end at the end."""
    with out.open("w", encoding="utf-8") as file:
        process = subprocess.Popen(words, stdout=file, stderr=subprocess.STDOUT, env=ENV, cwd=cwd)
        try:
            yield out
        finally:
            process.terminate()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def wait_for(condition: Callable[[], bool], seconds: float, said: Callable[[], str]) -> None:
    """Until it is so; AssertionError with the last words otherwise."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise AssertionError(f"not within {seconds:g} s: {said()[-2000:]}")
        time.sleep(0.1)


def free_instance() -> int:
    """An instance of which no port is taken."""
    for instance in INSTANCES:
        try:
            for kind, base in ((socket.SOCK_STREAM, 5760), (socket.SOCK_STREAM, 5762), (socket.SOCK_DGRAM, 9002)):
                with socket.socket(socket.AF_INET, kind) as probe:
                    probe.bind(("127.0.0.1", base + 10 * instance))
        except OSError:
            continue
        return instance
    raise AssertionError("no free ports for a firmware")
