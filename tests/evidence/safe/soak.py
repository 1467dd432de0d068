"""Long runs: no tick without its lease, memory flat. The whole App with the real controller.

    stepped   App, simulated autopilot and tag in one process on the stepped clock: 20 simulated minutes, --full 8 hours
              (a simulated hour takes six and a half minutes of one core, the real controller at each tick included)
    real      --full: `aritra sim` and `aritra run` as two processes for an hour of wall time

The mission is driven again and again, with station keeping between. The slope of memory is a least-squares line
through the resident size at every simulated minute (real: ten seconds), the first quarter left out.
"""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import psutil

from companion.cli.simulator.demo import free_port
from companion.core.messages import LoopTiming, OperatorCommand, OverrideLease, Tick
from companion.logs.log_file import LogFile
from companion.python_child import aritra
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.support.fault_fixture import FaultBench
from tests.support.fault_oracle import judge
from tests.support.faults import Sequence as Story

SHORT_S, LONG_S, REAL_S = 1200.0, 8 * 3600.0, 3600.0
LOOK_S, AGAIN_S, SAY_S = 60.0, 240.0, 1800.0
"""How often memory is read; how often the mission begins anew; how often it is told how far the run is."""
SLOPE_MB_H, SHORT_SLOPE_MB_H = 2.0, 20.0
"""Assumed: 2 MB/h fill no memory in a season's longest day. A short run's line is steep: its heap settles, and it is
hardly longer than one file of the log, whose index is in memory until the file ends (`recorder.ROTATE_BYTES`)."""
START_S = 30.0
"""From the start of the process to its first tick: the controller is compiled; assumed, for a loaded machine."""
MEGABYTE = 1e6
S = 1_000_000_000
KNOWN_NS = 30 * S
"""The oracle looks back by 20 s."""


class Soak(FaultBench):
    """Looks at everything once a minute, and forgets it: the memory that grows is the App's."""

    def __init__(self, path, story, seconds):
        super().__init__(path, story)
        self._for_s, self._ends_ns = seconds, 0
        self.told = dict.fromkeys(("ticks", "unleased", "wrong", "missions"), 0)
        self.at_s: list[float] = []
        self.rss_mb: list[float] = []
        self._open: int | None = None

    async def _story(self):
        await self.run(1.5)
        await self._begin("auto")
        begun_s = told_s = 0.0
        while told_s < self._for_s:
            await self.run(LOOK_S)
            told_s += LOOK_S
            self._look(told_s)
            if told_s - begun_s >= AGAIN_S:
                begun_s = told_s
                self.told["missions"] += self.app.state.guidance.phase == "done"
                for command in ("hold", "start"):
                    self.app.command(OperatorCommand(t_ns=self.clock.now_ns(), command=command))
                    await self.run(0.5)

    def _look(self, told_s):
        """Judge the last minute; keep no more of it than the oracle needs for the next."""
        ends_ns, self.stopped_ns = self.stopped_ns, self.clock.now_ns()
        self.told["wrong"] += len(found := judge(self))
        self.stopped_ns = ends_ns
        for text in found[:3]:
            print(f"    {text}")
        now_ns, heard = self.clock.now_ns(), self.heard
        heard.uwb_ns[:] = [t_ns for t_ns in heard.uwb_ns if t_ns >= now_ns - KNOWN_NS]
        for kept, for_ns in ((self.sent, S), (heard.esc, S), (heard.boat, KNOWN_NS), (heard.rover, KNOWN_NS)):
            kept[:] = [entry for entry in kept if entry[0] >= now_ns - for_ns]
        self.seen.clear()
        gc.collect()
        self.at_s.append(told_s)
        self.rss_mb.append(psutil.Process().memory_info().rss / MEGABYTE)
        if told_s % SAY_S < LOOK_S:
            at = f"{told_s / 3600:.1f} of {self._for_s / 3600:.1f} h, {self.rss_mb[-1]:.0f} MB, {self.told}"
            print(f"    {at}", file=sys.stderr, flush=True)

    def _watch(self, message):
        if isinstance(message, Tick):
            self.told["ticks"] += 1
            self.told["unleased"] += self._open is not None
            self._open = message.index
        elif isinstance(message, OverrideLease):
            self.told["unleased"] += message.index != self._open
            self._open = None


def lines(full: bool) -> Iterator[Line]:
    """Both kinds of run."""
    yield from stepped(LONG_S if full else SHORT_S)
    if full:
        yield from real_time(REAL_S)


def slope_mb_h(t_s: Sequence[float], rss_mb: Sequence[float]) -> float:
    """Least-squares slope [MB/h], without the first quarter, in which caches fill."""
    first = len(t_s) // 4
    return 3600.0 * float(np.polyfit(t_s[first:], rss_mb[first:], 1)[0])


def stepped(seconds: float) -> Iterator[Line]:
    """The App on the stepped clock for so long."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        bench = Soak(Path(folder) / "run.mcap", Story("auto", False, True, ()), seconds)
        bench.play()
        log_mb = sum(path.stat().st_size for path in Path(folder).iterdir()) / MEGABYTE
    if bench.raised:
        print(f"    the app raised {bench.raised!r}")
    name = f"{seconds / 3600:.2g} simulated hours"
    told = bench.told
    yield exactly(f"{name}: the app raised", int(bool(bench.raised)), 0)
    yield at_least(f"{name}: ticks", told["ticks"], 0.99 * seconds / 0.1)
    yield exactly(f"{name}: ticks without exactly one lease", told["unleased"], 0)
    yield exactly(f"{name}: faults on the wire and of neutral due", told["wrong"], 0)
    yield at_least(f"{name}: missions driven to the end", told["missions"], int(seconds / AGAIN_S) - 1)
    goal = SLOPE_MB_H if seconds > SHORT_S else SHORT_SLOPE_MB_H
    note = f"from {bench.rss_mb[0]:.0f} to {bench.rss_mb[-1]:.0f} MB, most {max(bench.rss_mb):.0f} MB"
    yield at_most(f"{name}: slope of memory", slope_mb_h(bench.at_s, bench.rss_mb), goal, "MB/h", note)
    yield information(f"{name}: log written", log_mb, "MB")
    yield information(f"{name}: took", (time.monotonic() - started) / 60, "min")


def real_time(seconds: float) -> Iterator[Line]:
    """`aritra sim` and `aritra run` for so long; their log and the companion's memory."""
    root = Path(__file__).resolve().parents[3]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        port, tag = free_port(), folder / "uwb"
        program = aritra()
        sim = subprocess.Popen(
            [*program, "sim", "--udp-to", f"127.0.0.1:{port}", "--uwb", str(tag)], cwd=root, stdout=subprocess.DEVNULL
        )
        boat = subprocess.Popen(
            [*program, "run", "--mavlink", f"udpin:127.0.0.1:{port}", "--uwb", f"serial:{tag}:115200",
             "--log", str(folder / "run.mcap"), "--start"],
            cwd=root, stdout=subprocess.DEVNULL, env={**os.environ, "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        try:
            at_s, rss_mb = _sampled(boat, seconds)
        finally:
            for process in (boat, sim):
                process.send_signal(signal.SIGTERM)
                process.wait(20)
        messages = list(LogFile(folder / "run.mcap").messages())
    beats = [m for m in messages if isinstance(m, Tick)]
    ticks = [m.index for m in beats]
    running_s = (beats[-1].t_ns - beats[0].t_ns) * 1e-9
    leases = {m.index for m in messages if isinstance(m, OverrideLease)}
    sent = [m for m in messages if isinstance(m, LoopTiming)]
    what = f"real time, {seconds / 60:.0f} min"
    yield at_least(f"{what}: the program ran", running_s, seconds - START_S, "s")
    yield at_least(f"{what}: ticks", len(ticks), 0.98 * running_s / 0.1)
    yield exactly(f"{what}: ticks without a lease", len(set(ticks[:-1]) - leases), 0)
    yield exactly(f"{what}: leases that did not leave", sum(not m.sent for m in sent), 0)
    yield at_most(f"{what}: lateness of a tick, worst", max(m.lateness_ms for m in sent), 100.0, "ms")
    note = f"from {rss_mb[0]:.0f} to {rss_mb[-1]:.0f} MB"
    yield at_most(f"{what}: slope of memory", slope_mb_h(at_s, rss_mb), SLOPE_MB_H, "MB/h", note)


def _sampled(process: subprocess.Popen, seconds: float) -> tuple[list[float], list[float]]:
    """Resident size every ten seconds; RuntimeError where the process ends before."""
    begun, at_s, rss_mb = time.monotonic(), [], []
    seen = psutil.Process(process.pid)
    while (now_s := time.monotonic() - begun) < seconds:
        if process.poll() is not None:
            raise RuntimeError(f"aritra run ended with {process.returncode} after {now_s:.0f} s")
        at_s.append(now_s)
        rss_mb.append(seen.memory_info().rss / MEGABYTE)
        time.sleep(10.0)
    return at_s, rss_mb
