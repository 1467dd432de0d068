"""What is done to the boat in the rows of the kill matrix: processes, wires, sticks, disks, places."""

from __future__ import annotations

import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.evidence.safe.pen import NEUTRAL_US
from tests.evidence.safe.trial import Trial, free_port, run_file
from tests.evidence.safe.wire import (
    Fault,
    babble,
    held_back,
)

Act = Callable[[Trial], object]
BLIND_S = 5.0
"""`control.blind_s` in the rows of UWB and IMU: 5 s and not the default of 15 s, so that the matrix ends."""
UNDER_WAY_NS = 50_000_000
"""The simulator's clock may lag behind the wire's by so much: it makes up for late steps."""
PILOT_US = 1450
DISARM, SET_MODE, HOLD = 400, 176, 4
EAST_FENCE_M = 29.5
ALONG_EAST = """name = "along the east fence"
[[waypoints]]
north_m = 10.0
east_m = 27.5
[[waypoints]]
north_m = 25.0
east_m = 27.5
"""


def kill(trial: Trial) -> None:
    trial.boat.kill()


def break_down(trial: Trial) -> None:
    trial.boat.send_signal(signal.SIGUSR1)


def stop(trial: Trial) -> None:
    trial.boat.send_signal(signal.SIGSTOP)


def stop_for(seconds: float) -> Act:
    def act(trial: Trial) -> None:
        stop(trial)
        time.sleep(seconds)
        trial.boat.send_signal(signal.SIGCONT)

    return act


def order(line: str) -> Act:
    return lambda trial: trial.order(line)


def on_wire(fault: Fault) -> Act:
    def act(trial: Trial) -> None:
        trial.wire.fault = fault

    return act


def command(number: int, *params: float) -> Act:
    return lambda trial: trial.station().command(number, *params)


def sticks(channels: int, **moved: int) -> str:
    """Pulse widths of a receiver; `moved`: c5=1800."""
    pulses = [moved.get(f"c{n}", NEUTRAL_US) for n in range(1, channels + 1)]
    return " ".join(["sticks", *map(str, pulses)])


def pilot_sticks(trial: Trial) -> None:
    trial.order(sticks(16, **dict.fromkeys(("c9", "c10", "c11", "c12"), PILOT_US)))


def tag_babbles(trial: Trial) -> None:
    trial.tag.fault = babble(1)


def tag_held_back(trial: Trial) -> None:
    trial.tag.fault = held_back(3.0)


def second_companion(trial: Trial) -> None:
    """A second companion on another port of the autopilot, until it has spoken for a while."""
    trial.companion("second", ["--mavlink", f"tcp:127.0.0.1:{trial.tcp}"], ["--start"])
    sent = len(trial.wire.sent)
    trial.until(lambda t: len(t.pen.read().overrides) - len(t.wire.sent) > 20 and sent, 60.0)
    trial.observe(10.0)


def second_spoke(trial: Trial, t0_ns: int) -> int:
    """When the first override reached the autopilot that had not come over the first companion's wire before."""
    left: Counter[tuple[int, ...]] = Counter()
    sent = iter(trial.wire.sent)
    waiting = next(sent, None)
    for override in trial.pen.overrides:
        while waiting and waiting[0] <= override.t_ns + UNDER_WAY_NS:
            left[waiting[1]] += 1
            waiting = next(sent, None)
        left[override.channels] -= 1
        if override.t_ns >= t0_ns and left[override.channels] < 0:
            return override.t_ns
    return t0_ns


def fill_disk(trial: Trial) -> None:
    """Write until nothing more fits."""
    with open(trial.log.parent / "ballast", "wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(65536))
        except OSError:
            return


def blind_early(folder: Path) -> Sequence[str]:
    return ["--config", str(run_file(folder, {"blind_s = 15.0": f"blind_s = {BLIND_S}"}))]


def absent_shore(folder: Path) -> Sequence[str]:
    """A ground station that is not there."""
    return ["--config", str(run_file(folder, {}, f'\n[forward]\nurl = "udpout:127.0.0.1:{free_port()}"\n'))]


def beside_fence(folder: Path) -> Sequence[str]:
    (folder / "fence.toml").write_text(ALONG_EAST)
    return ["--mission", str(folder / "fence.toml")]


def crossed_fence(trial: Trial, t0_ns: int) -> int:
    """When the boat truly left the fence."""
    return next((s.t_ns for s in trial.pen.steps if s.t_ns >= t0_ns and s.east_m > EAST_FENCE_M), t0_ns)


def drift_out(trial: Trial) -> None:
    trial.order("current 1.2 90")
    trial.until(lambda t: t.pen.read().steps[-1].east_m > EAST_FENCE_M, 40.0)


@contextmanager
def disk_of(folder: Path, megabytes: int) -> Iterator[Path]:
    """A disk of its own of so many MB (tmpfs; needs root); with 0 the folder itself."""
    if not megabytes:
        yield folder / "run.mcap"
        return
    disk = folder / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(disk)], check=True)
    try:
        yield disk / "run.mcap"
    finally:
        subprocess.run(["umount", str(disk)], check=True)
