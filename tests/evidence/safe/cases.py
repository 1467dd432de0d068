"""The rows of the kill matrix: what is broken, how, and what must be seen. Times and their reasons stand with each row.

`rest`: within `goal_s` of the fault every thruster is in neutral (or without pulses), and stays so to the end.
`on`: the boat drives on. `mode hold`: the mission is broken off, station is kept. `never`: no thruster ever turns.
`rules`: nothing is asked but the rules that hold in every row; what the thrusters did is told.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from tests.evidence.safe.trial import AT_REST, NEUTRAL_US, Trial, free_port, run_file
from tests.evidence.safe.wire import (
    Fault,
    attitude_not_a_number,
    babble,
    delayed,
    duplicated,
    garbled,
    held_back,
    reordered,
    silent,
)

Must = Literal["rest", "on", "mode hold", "never", "rules"]
Act = Callable[[Trial], object]
COMPANION_S = 0.7
"""The issue's own: neutral, or the pilot's sticks, after the companion's death. Also for what acts at once."""
HEARTBEAT_S = 1.0 + COMPANION_S
"""What a heartbeat has to tell: they come once a second."""
LINK_S = 3.0 + COMPANION_S
"""No heartbeat for 3 s (docs/modes.md)."""
IGNORED_S = 1.5 + 0.5 + 0.5 + COMPANION_S
"""Overrides not shown for 1.5 s (docs/modes.md); the news of it, and neutral itself, come 0.5 s late."""
TURNS_S = 5.0 + COMPANION_S
"""Three times wrong within 5 s (docs/modes.md): two senders take turns, and how they fall is chance."""
BLIND_S = 5.0
"""`control.blind_s` in the rows of UWB and IMU: 5 s and not the default of 15 s, so that the matrix ends."""
UNSEEN_S = BLIND_S + 3.0 + 1.0 + COMPANION_S
"""No fix for 3 s is degraded (three cycles at 1 Hz); the last one is up to 1 s old; then `blind_s`."""
BATTERY_S = 5.0 + 3.5 + COMPANION_S
"""5 s below the limit (docs/modes.md) for the mean of readings (weight 0.2): 7 readings, asked for at 2 Hz."""
FENCE_S = 1.0 + COMPANION_S
"""From the true crossing: a position of UWB comes once a second."""
PLANLESS_S = 5.0 + COMPANION_S
"""No usable plan for 5 s."""
REFUSED_S = 30.0
UNDER_WAY_NS = 50_000_000
"""The simulator's clock may lag behind the wire's by so much: it makes up for late steps."""
PILOT_US = 1450
DISARM, SET_MODE, HOLD = 400, 176, 4
ONE_FAR, ALL_ANCHORS = "0CA8", "1151 0CA8 111C 1150"
EAST_FENCE_M = 29.5
ALONG_EAST = """name = "along the east fence"
[[waypoints]]
north_m = 10.0
east_m = 27.5
[[waypoints]]
north_m = 25.0
east_m = 27.5
"""


@dataclass(frozen=True)
class Case:
    """One row. `act` breaks something; `since`: when it began, if not then [ns]; `quick`: also without --full."""

    group: str
    name: str
    act: Act
    must: Must = "rest"
    goal_s: float = COMPANION_S
    observe_s: float = 4.0
    quick: bool = False
    sim: Sequence[str] = ("--wiring", "gate")
    run: Sequence[str] = ("--start",)
    fault: str = ""
    config: Callable[[Path], Sequence[str]] = field(default=lambda folder: ())
    before: Act = field(default=lambda trial: None)
    since: Callable[[Trial, int], int] = field(default=lambda trial, t0_ns: t0_ns)
    rest: frozenset[int] = AT_REST
    disk_mb: int = 0
    ends_s: float | None = None


def _kill(trial: Trial) -> None:
    trial.boat.kill()


def _break(trial: Trial) -> None:
    trial.boat.send_signal(signal.SIGUSR1)


def _stop(trial: Trial) -> None:
    trial.boat.send_signal(signal.SIGSTOP)


def _stop_for(seconds: float) -> Act:
    def act(trial: Trial) -> None:
        _stop(trial)
        time.sleep(seconds)
        trial.boat.send_signal(signal.SIGCONT)

    return act


def _order(line: str) -> Act:
    return lambda trial: trial.order(line)


def _wire(fault: Fault) -> Act:
    def act(trial: Trial) -> None:
        trial.wire.fault = fault

    return act


def _command(number: int, *params: float) -> Act:
    return lambda trial: trial.station().command(number, *params)


def _sticks(channels: int, **moved: int) -> str:
    """Pulse widths of a receiver; `moved`: c5=1800."""
    pulses = [moved.get(f"c{n}", NEUTRAL_US) for n in range(1, channels + 1)]
    return " ".join(["sticks", *map(str, pulses)])


def _pilot_sticks(trial: Trial) -> None:
    trial.order(_sticks(16, **dict.fromkeys(("c9", "c10", "c11", "c12"), PILOT_US)))


def _tag_babbles(trial: Trial) -> None:
    trial.tag.fault = babble(1)


def _tag_held_back(trial: Trial) -> None:
    trial.tag.fault = held_back(3.0)


def _second(trial: Trial) -> None:
    """A second companion on another port of the autopilot, until it has spoken for a while."""
    trial.companion("second", ["--mavlink", f"tcp:127.0.0.1:{trial.tcp}"], ["--start"])
    sent = len(trial.wire.sent)
    trial.until(lambda t: len(t.pen.read().overrides) - len(t.wire.sent) > 20 and sent, 60.0)
    trial.observe(10.0)


def _second_spoke(trial: Trial, t0_ns: int) -> int:
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


def _fill(trial: Trial) -> None:
    """Write until nothing more fits."""
    with open(trial.log.parent / "ballast", "wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(65536))
        except OSError:
            return


def _blind(folder: Path) -> Sequence[str]:
    return ["--config", str(run_file(folder, {"blind_s = 15.0": f"blind_s = {BLIND_S}"}))]


def _shore(folder: Path) -> Sequence[str]:
    """A ground station that is not there."""
    return ["--config", str(run_file(folder, {}, f'\n[forward]\nurl = "udpout:127.0.0.1:{free_port()}"\n'))]


def _beside_fence(folder: Path) -> Sequence[str]:
    (folder / "fence.toml").write_text(ALONG_EAST)
    return ["--mission", str(folder / "fence.toml")]


def _crossed(trial: Trial, t0_ns: int) -> int:
    """When the boat truly left the fence."""
    return next((s.t_ns for s in trial.pen.steps if s.t_ns >= t0_ns and s.east_m > EAST_FENCE_M), t0_ns)


def _drift_out(trial: Trial) -> None:
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


ROOT = os.geteuid() == 0
GATE8 = ("--wiring", "gate", "--receiver", "8")
GATE16 = ("--wiring", "gate", "--receiver", "16")
SCALED = ("--wiring", "scaled")
PLAIN = ("--wiring", "unsafe_plain")
PLAIN_ARMS = (*PLAIN, "--param", "ARMING_CHECK=0")
DEATH, LINK, UWB, IMU, BOAT, PEOPLE, REFUSAL = (
    "companion",
    "link",
    "UWB",
    "IMU and clock",
    "boat",
    "people",
    "plain pass-through",
)
CASES: tuple[Case, ...] = (
    Case(DEATH, "SIGKILL, gate, no receiver", _kill, quick=True),
    Case(DEATH, "SIGKILL, gate, receiver of 8", _kill, sim=GATE8),
    Case(DEATH, "SIGKILL, gate, receiver of 16 at rest", _kill, sim=GATE16),
    Case(
        DEATH,
        "SIGKILL, gate, receiver of 16, sticks at 1450",
        _kill,
        sim=GATE16,
        before=_pilot_sticks,
        rest=AT_REST | {PILOT_US},
    ),
    Case(DEATH, "SIGKILL, gate, firmware 4.7", _kill, sim=("--wiring", "gate", "--firmware", "4.7")),
    Case(DEATH, "SIGKILL, scaled, no receiver", _kill, sim=SCALED),
    Case(DEATH, "SIGSTOP, gate, no receiver", _stop, quick=True),
    Case(DEATH, "SIGSTOP, gate, receiver of 16 at rest", _stop, sim=GATE16),
    Case(DEATH, "SIGSTOP for 4 s, then SIGCONT", _stop_for(4.0)),
    Case(DEATH, "SIGSTOP for 1 s, then SIGCONT", _stop_for(1.0), must="rules"),
    Case(DEATH, "SIGTERM", lambda trial: trial.boat.terminate()),
    Case(DEATH, "exception in the core", _break, fault="core", quick=True),
    Case(DEATH, "exception in the solver", _break, "mode hold", PLANLESS_S, 9.0, fault="solver", quick=True),
    Case(DEATH, "solver never returns", _break, "mode hold", PLANLESS_S, 9.0, fault="solver_hangs"),
    Case(DEATH, "log disk loses its power: I/O errors", _break, "on", observe_s=8.0, fault="disk_cut"),
    Case(DEATH, "log disk hangs", _break, "on", observe_s=8.0, fault="disk_hangs"),
    *([Case(DEATH, "log disk full", _fill, "on", observe_s=8.0, disk_mb=6)] if ROOT else []),
    Case(LINK, "silent both ways", _wire(silent()), quick=True),
    Case(LINK, "silent towards the autopilot", _wire(silent("to_autopilot"))),
    Case(LINK, "silent towards the companion", _wire(silent("to_companion")), goal_s=LINK_S, observe_s=8.0),
    Case(LINK, "garbled: one byte in 100", _wire(garbled(1)), "rules", observe_s=10.0),
    Case(LINK, "garbled: one byte in 5, no frame passes", _wire(garbled(2, 0.2))),
    Case(LINK, "every datagram twice, 30 ms apart", _wire(duplicated), "on", observe_s=6.0),
    Case(LINK, "reordered: late by 0 to 250 ms", _wire(reordered(3)), "rules", observe_s=10.0),
    Case(LINK, "delayed by 500 ms", _wire(delayed(0.5)), goal_s=IGNORED_S, observe_s=10.0),
    Case(LINK, "autopilot reboots", _order("reboot"), observe_s=10.0),
    Case(UWB, "silent", _order("uwb_silent"), goal_s=UNSEEN_S, observe_s=13.0, config=_blind, quick=True),
    Case(UWB, "garbage", _tag_babbles, goal_s=UNSEEN_S, observe_s=13.0, config=_blind),
    Case(UWB, "all anchors lost", _order("no_anchors"), goal_s=UNSEEN_S, observe_s=13.0, config=_blind),
    Case(UWB, "one anchor reads 15 m far", _order(f"far 15 {ONE_FAR}"), "on", observe_s=13.0, config=_blind),
    Case(
        UWB,
        "all anchors read 15 m far",
        _order(f"far 15 {ALL_ANCHORS}"),
        goal_s=UNSEEN_S,
        observe_s=13.0,
        config=_blind,
    ),
    Case(UWB, "held back 3 s, then all at once", _tag_held_back, "on", observe_s=10.0, config=_blind),
    Case(IMU, "autopilot's clock jumps 10 s ahead", _order("clock 10"), "rules", observe_s=10.0),
    Case(IMU, "autopilot's clock jumps 5 s back", _order("clock -5"), "rules", observe_s=10.0),
    Case(IMU, "IMU and attitude frozen", _order("imu_frozen"), goal_s=UNSEEN_S, observe_s=20.0, config=_blind),
    Case(IMU, "attitude not a number", _wire(attitude_not_a_number()), goal_s=UNSEEN_S, observe_s=13.0, config=_blind),
    Case(BOAT, "battery critical: 12.5 V", _order("volts 12.5"), goal_s=BATTERY_S, observe_s=10.0),
    Case(BOAT, "battery low: 13.8 V", _order("volts 13.8"), "on", observe_s=9.0),
    Case(
        BOAT,
        "swept across the fence by 1.2 m/s of current",
        _drift_out,
        goal_s=FENCE_S,
        observe_s=5.0,
        sim=("--wiring", "gate", "--start", "10", "27.5", "0"),
        config=_beside_fence,
        since=_crossed,
    ),
    Case(PEOPLE, "RC takeover: channel 5 by 300 us", _order(_sticks(16, c5=1800)), sim=GATE16),
    Case(PEOPLE, "station disarms, gate", _command(DISARM, 0)),
    Case(PEOPLE, "station sets HOLD, gate", _command(SET_MODE, 1, HOLD)),
    Case(PEOPLE, "station disarms, scaled", _command(DISARM, 0), goal_s=HEARTBEAT_S, sim=SCALED),
    Case(PEOPLE, "station sets HOLD, scaled", _command(SET_MODE, 1, HOLD), goal_s=HEARTBEAT_S, sim=SCALED),
    Case(PEOPLE, "two companions at once", _second, goal_s=TURNS_S, since=_second_spoke),
    Case(PEOPLE, "shore absent: nobody at forward.url", lambda trial: None, "on", observe_s=6.0, config=_shore),
    Case(REFUSAL, "aritra run --start", lambda trial: None, "never", sim=PLAIN, quick=True, ends_s=REFUSED_S),
    Case(
        REFUSAL,
        "aritra run --start --unchecked, SIGKILL",
        _kill,
        "rules",
        sim=PLAIN_ARMS,
        run=("--start", "--unchecked"),
    ),
)
