"""Holes of the boat's program: each attack that opened one, replayed against the real code, and what it gets now."""

from __future__ import annotations

import asyncio
import itertools
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.core.configuration.run_file import BatteryLimits
from companion.core.messages import Alert, Battery, OverrideLease, PlanResult, Tick
from companion.core.preflight.boat import battery_rows
from companion.jit.cache import CodeStore, cache_folder
from companion.jit.checksummed import with_checksum
from companion.python_child import python
from drivers.mavlink.codec import MavlinkCodec
from tests.companion.boat.app.ending import ends_in_order
from tests.companion.boat.app.shell_faults import IN_THE_SHELL
from tests.companion.boat.app_fixture import Bench, S
from tests.companion.boat.guarded_fixture import PLAIN, Guarded, silently_written, strange, told, written
from tests.companion.core.pilot.pilot_shell import N, heartbeat, on_the_leg, plan
from tests.companion.core.preflight.observations_fixture import heard
from tests.evidence.firmware.missions import WAVES
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.support.drive_fixture import CORNER, settled, voyage

MOST_N = 12.0
"""Largest change of a force in a tick: the vessel file's rate limit, 120 N/s, in 0.1 s."""
DEAD_S = 20.0
"""How long the world goes on after the companion's death."""


def interlock(full: bool) -> Iterator[Line]:
    """Interlock: SERVO1-4_FUNCTION = 59 to 62 written under way, then the companion's death; --full: ten seeds"""
    seeds = range(1, 11 if full else 3)
    for name, write, within_s in (("broadcast", written, 0.5), ("no broadcast", silently_written, 8.5)):
        found = [_rewired(seed, write) for seed in seeds]
        yield exactly(f"{name}: runs that end in safe", sum(took_s < np.inf for took_s, *_ in found), len(found))
        yield at_most(f"{name}: until safe, the slowest", max(took_s for took_s, *_ in found), within_s, "s")
        yield exactly(f"{name}: alerts with parameter and remedy", sum(alert for _, alert, _ in found), len(found))
        off_us = max(off for *_, off in found)
        yield exactly(f"{name}: pulses off 1500 after the companion's death", off_us, 0, "us", "before: for ever")


def _rewired(seed: int, write: Callable[[Any, dict[str, float]], None]) -> tuple[float, bool, int]:
    """Time until safe [s], whether the alert says what and what to do, largest pulse off neutral when all is over."""
    found: list[Any] = [np.inf, 0]

    async def story(bench: Any) -> None:
        bench.order("start")
        assert await bench.run(25.0, until=lambda: bench.mode == "auto")
        await bench.run(2.0)
        since_ns = bench.clock.now_ns()
        write(bench, PLAIN)
        if await bench.run(12.0, until=lambda: bench.mode == "safe"):
            found[0] = (bench.clock.now_ns() - since_ns) / S
        await bench.run(1.0)
        bench.answering = False
        await bench.run(DEAD_S)
        found[1] = max(abs(us - 1500) for us in bench.world.rover.outputs_us[:4])

    with tempfile.TemporaryDirectory() as folder:
        bench = Guarded(Path(folder) / "run.mcap", seed=seed)
        bench.scene(story)
    says = any("_FUNCTION is " in text and "aritra provision" in text for text in bench.alerts())
    return found[0], says, found[1]


def autopilots(full: bool) -> Iterator[Line]:
    """Autopilots: a foreign vehicle's heartbeat comes first, with and without the key of the run file"""
    bench = _foreign_first(MavlinkCodec(target_system=1))
    to = [m.target_system for _, m in bench.sent if getattr(m, "target_system", 0)]
    yield at_least("ours named: frames to ours", to.count(1), 20)
    yield exactly("ours named: frames to the foreign one", sum(system == 7 for system in to), 0)
    yield exactly("ours named: drives once ours is there", bench.mode_then == "auto", 1)
    yield at_least("ours named: alerts of the foreign one", told(bench, "system 7 is heard, which is not ours"), 1)
    bench = _foreign_first(MavlinkCodec())
    obeyed = bench.mode_then != "idle"
    yield exactly("nobody named: starts that are obeyed", obeyed, 0, "", "before: it spoke to the foreign one")
    yield at_least("nobody named: alerts", told(bench, "this run keeps to 7, which spoke first"), 1)


def _foreign_first(codec: MavlinkCodec) -> Any:
    async def story(bench: Any) -> None:
        bench.answering = False
        await bench.run(0.1)
        for _ in range(3):
            strange(bench)
            await bench.run(1.0)
        bench.answering, bench.deaf = True, False
        await bench.run(2.0)
        bench.order("start")
        await bench.run(20.0, until=lambda: bench.mode == "auto")
        bench.mode_then = bench.mode

    with tempfile.TemporaryDirectory() as folder:
        bench: Any = Guarded(Path(folder) / "run.mcap", codec=codec)
        bench.deaf = True
        bench.scene(story)
    return bench


def battery(full: bool) -> Iterator[Line]:
    """Battery: a monitor that reads 0 V, falls silent, or reads what no pack of 14.8 V has, under way"""
    limits = BatteryLimits(low_V=14.0, critical_V=13.2)
    readings = (None, 0.0, 3.3, 7.0, 24.0, 65.5)
    waits = [_alerted_s(volts) for volts in readings]
    yield exactly("readings that are told", sum(s < np.inf for s in waits), len(readings), "", "before: 0")
    yield at_most("the longest until the alert", max(waits), 10.5, "s")
    packs = [None if volts is None else Battery(t_ns=0, voltage_v=volts) for volts in readings]
    levels = [next(iter(battery_rows(heard(battery=pack), 14.8, limits))).level for pack in packs]
    yield exactly("readings that aritra check refuses", levels.count("refuse"), len(readings))


def _alerted_s(volts: float | None) -> float:
    """From the first such reading to the alert [s]."""
    shell = on_the_leg()
    since_ns = shell.t_ns
    for k in range(150):
        shell.t_ns += S // 10
        shell.feed(heartbeat(shell.t_ns), *(() if volts is None else (Battery(t_ns=shell.t_ns, voltage_v=volts),)))
        shell.feed(Tick(t_ns=shell.t_ns, index=2000 + k))
    said = [o.t_ns for o in shell.outputs if isinstance(o, Alert) and "count for nothing" in o.text]
    return (said[0] - since_ns) / S if said else np.inf


def failures(full: bool) -> Iterator[Line]:
    """Failures inside the shell: neutral for a second, disarm, release, whatever is raised and wherever"""
    raised = (SystemExit(0), KeyboardInterrupt(), asyncio.CancelledError(), GeneratorExit(), MemoryError())
    ended = [_ends(lambda bench, patch, fault=fault: fault(bench, patch)) for fault, _ in IN_THE_SHELL]
    yield exactly("parts that break: neutral and disarm", sum(ended), len(IN_THE_SHELL))
    ended = [_ends(lambda bench, patch, error=error: _raise_in_watch(bench, error)) for error in raised]
    yield exactly("what is no exception: neutral and disarm", sum(ended), len(raised), "", "before: nothing was sent")
    yield exactly("cancelled run: neutral and disarm", _ends(lambda bench, patch: bench.running.cancel()), 1)


def _raise_in_watch(bench: Any, error: BaseException) -> None:
    def watch(message: object) -> None:
        if isinstance(message, Tick):
            bench.on_watch = None
            raise error

    bench.on_watch = watch


def _ends(act: Callable[[Any, pytest.MonkeyPatch], object]) -> bool:
    """Whether a boat that drives ends in order, and its run in an error."""
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        bench = Bench(Path(folder) / "run.mcap")

        async def story(bench: Any) -> None:
            await bench.drive()
            act(bench, patch)
            assert await bench.run(4.0, until=bench.running.done)

        error = bench.scene(story)
    try:
        ends_in_order(bench)
    except AssertionError:
        return False
    return error is not None


FULL = """
import errno, os, sys
from companion.__main__ import main
def fsync(descriptor):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
os.fsync = fsync
sys.exit(main())
"""
START_S, STARTED = 60.0, "waiting for the operator's start"


def full_disk(full: bool) -> Iterator[Line]:
    """Full disk at the start: the run goes on without a recording, and says so"""
    with tempfile.TemporaryDirectory() as folder:
        wires = ["--mavlink", "udpout:127.0.0.1:9", "--uwb", f"serial:{folder}/no-tag"]
        command = python("-u", "-c", FULL, "run", "--log", f"{folder}/run.mcap", *wires)
        out = Path(folder) / "out.txt"
        with out.open("w") as file:
            child = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)
            end = time.monotonic() + START_S
            while time.monotonic() < end and child.poll() is None and STARTED not in out.read_text():
                time.sleep(0.2)
            child.send_signal(signal.SIGTERM)
            code = child.wait(20)
        said = out.read_text()
    yield exactly("exit code after SIGTERM", code, 0, "", "before: 2 at once, which is never tried again")
    yield exactly("it says why and what follows", "No space left" in said and "without a recording" in said, 1)


def plans(full: bool) -> Iterator[Line]:
    """Plans: full force that alternates at every tick, and what no controller can mean; sound ones are untouched"""
    shell = on_the_leg()
    forces, sources = [shell.state.f_command_n], []
    for k in range(40):
        shell.feed(heartbeat(shell.t_ns))
        shell.tick()
        shell.feed(plan(shell.index, f_n=((38.0 if k % 2 else -30.0,) * N,) * 20))
        forces.append(shell.lease.f_command_n)
        sources.append(shell.lease.source)
    changes = np.abs(np.diff(forces, axis=0))
    yield at_most("alternating: largest change in a tick", changes.max(), MOST_N + 1e-9, "N", "before: 68 N")
    yield at_most("alternating: ticks until no plan is sent", sources.count("plan"), 8)
    bad = ("38 -30", "1e6", "nan", "inf")
    yield exactly("plans that nobody can mean: sent", sum(_sent(kind) for kind in bad), 0, "", f"of {len(bad)}")
    for name, world in (("calm", {}), ("waves", {"weather": WAVES})):
        run = voyage(1, CORNER, **world)
        run.run(settled(2.0), 60.0)
        made, leases = run.of(PlanResult), run.of(OverrideLease)
        refused = sum("not plausible" in lease.reason for lease in leases)
        yield exactly(f"closed loop, {name}: plans refused", refused, 0, "", f"of {len(made)}")
        first = {p.index: p.f_n[0] for p in made if p.f_n}
        sent = [pair for pair in itertools.pairwise(leases) if pair[1].source == "plan"]
        other = [pair for pair in sent if not np.allclose(pair[1].f_command_n, first[pair[1].index], atol=1e-6)]
        held = sum(
            np.abs(np.subtract(now.f_command_n, before.f_command_n)).max() > MOST_N - 1e-6 for before, now in other
        )
        yield exactly(f"closed loop, {name}: plans held by the rate limit", held, 0, "", f"of {len(sent)}")
        yield information(f"closed loop, {name}: plans sent with a probe of thrusters", len(other) - held)


def _sent(kind: str) -> bool:
    """Whether such a plan becomes a lease."""
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    values = [float(word) for word in kind.split()] * 20
    shell.feed(plan(shell.index, f_n=tuple((value,) * N for value in values[:20])))
    return shell.lease.source == "plan"


def cache(full: bool) -> Iterator[Line]:
    """Cache: code with a right checksum that somebody else can have put there"""
    shared = Path(tempfile.gettempdir())
    yield exactly("without HOME: in the shared temporary folder", shared in (cache_folder({}) or Path("/")).parents, 0)
    tries = [_given_out(*how) for how in ((0o777, 0o600), (0o1777, 0o600), (0o770, 0o600), (0o700, 0o666))]
    if os.geteuid() == 0:
        tries += [_given_out(0o700, 0o600, folder_of=54321), _given_out(0o700, 0o600, file_of=54321)]
    yield exactly(
        "planted code that is given out", sum(out for out, _ in tries), 0, "", f"of {len(tries)}; before: all"
    )
    yield exactly("of which one line is said", sum(lines == 1 for _, lines in tries), len(tries))
    yield exactly("our own code is still given out", _given_out(0o700, 0o600)[0], 1)


def _given_out(
    folder_mode: int, file_mode: int, *, folder_of: int | None = None, file_of: int | None = None
) -> tuple[bool, int]:
    """Whether the store gives it out, and how many lines it says."""
    with tempfile.TemporaryDirectory() as above:
        folder = Path(above) / "cache"
        folder.mkdir()
        file = folder / "key.o"
        file.write_bytes(with_checksum(b"planted"))
        file.chmod(file_mode)
        folder.chmod(folder_mode)
        for path, owner in ((file, file_of), (folder, folder_of)):
            if owner is not None:
                os.chown(path, owner, owner)
        said: list[str] = []
        store = CodeStore(folder, tell=said.append)
        return [store.get("key") for _ in range(3)][-1] is not None, len(said)


PARTS = (interlock, autopilots, battery, failures, full_disk, plans, cache)
