"""The rows of the kill matrix: what is broken, how, and what must be seen. Times and their reasons stand with each row.

`rest`: within `goal_s` of the fault every thruster is in neutral (or without pulses), and stays so to the end.
`on`: the boat drives on. `mode hold`: the mission is broken off, station is kept. `never`: no thruster ever turns.
`rules`: nothing is asked but the rules that hold in every row; what the thrusters did is told.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from tests.evidence.safe.acts import (
    BLIND_S,
    DISARM,
    HOLD,
    PILOT_US,
    SET_MODE,
    Act,
    absent_shore,
    beside_fence,
    blind_early,
    break_down,
    command,
    crossed_fence,
    drift_out,
    fill_disk,
    kill,
    on_wire,
    order,
    pilot_sticks,
    second_companion,
    second_spoke,
    sticks,
    stop,
    stop_for,
    tag_babbles,
    tag_held_back,
)
from tests.evidence.safe.pen import AT_REST
from tests.evidence.safe.trial import Trial
from tests.evidence.safe.wire import (
    attitude_not_a_number,
    delayed,
    duplicated,
    garbled,
    reordered,
    silent,
)

Must = Literal["rest", "on", "mode hold", "never", "rules"]
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
UNSEEN_S = BLIND_S + 3.0 + 1.0 + COMPANION_S
"""No fix for 3 s is degraded (three cycles at 1 Hz); the last one is up to 1 s old; then `blind_s`."""
BATTERY_S = 5.0 + 3.5 + COMPANION_S
"""5 s below the limit (docs/modes.md) for the mean of readings (weight 0.2): 7 readings, asked for at 2 Hz."""
FENCE_S = 1.0 + COMPANION_S
"""From the true crossing: a position of UWB comes once a second."""
PLANLESS_S = 5.0 + COMPANION_S
"""No usable plan for 5 s."""
REFUSED_S = 30.0
ONE_FAR, ALL_ANCHORS = "0CA8", "1151 0CA8 111C 1150"


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
    Case(DEATH, "SIGKILL, gate, no receiver", kill, quick=True),
    Case(DEATH, "SIGKILL, gate, receiver of 8", kill, sim=GATE8),
    Case(DEATH, "SIGKILL, gate, receiver of 16 at rest", kill, sim=GATE16),
    Case(
        DEATH,
        "SIGKILL, gate, receiver of 16, sticks at 1450",
        kill,
        sim=GATE16,
        before=pilot_sticks,
        rest=AT_REST | {PILOT_US},
    ),
    Case(DEATH, "SIGKILL, gate, firmware 4.7", kill, sim=("--wiring", "gate", "--firmware", "4.7")),
    Case(DEATH, "SIGKILL, scaled, no receiver", kill, sim=SCALED),
    Case(DEATH, "SIGSTOP, gate, no receiver", stop, quick=True),
    Case(DEATH, "SIGSTOP, gate, receiver of 16 at rest", stop, sim=GATE16),
    Case(DEATH, "SIGSTOP for 4 s, then SIGCONT", stop_for(4.0)),
    Case(DEATH, "SIGSTOP for 1 s, then SIGCONT", stop_for(1.0), must="rules"),
    Case(DEATH, "SIGTERM", lambda trial: trial.boat.terminate()),
    Case(DEATH, "exception in the core", break_down, fault="core", quick=True),
    Case(DEATH, "exception in the solver", break_down, "mode hold", PLANLESS_S, 9.0, fault="solver", quick=True),
    Case(DEATH, "solver never returns", break_down, "mode hold", PLANLESS_S, 9.0, fault="solver_hangs"),
    Case(DEATH, "log disk loses its power: I/O errors", break_down, "on", observe_s=8.0, fault="disk_cut"),
    Case(DEATH, "log disk hangs", break_down, "on", observe_s=8.0, fault="disk_hangs"),
    *([Case(DEATH, "log disk full", fill_disk, "on", observe_s=8.0, disk_mb=6)] if ROOT else []),
    Case(LINK, "silent both ways", on_wire(silent()), quick=True),
    Case(LINK, "silent towards the autopilot", on_wire(silent("to_autopilot"))),
    Case(LINK, "silent towards the companion", on_wire(silent("to_companion")), goal_s=LINK_S, observe_s=8.0),
    Case(LINK, "garbled: one byte in 100", on_wire(garbled(1)), "rules", observe_s=10.0),
    Case(LINK, "garbled: one byte in 5, no frame passes", on_wire(garbled(2, 0.2))),
    Case(LINK, "every datagram twice, 30 ms apart", on_wire(duplicated), "on", observe_s=6.0),
    Case(LINK, "reordered: late by 0 to 250 ms", on_wire(reordered(3)), "rules", observe_s=10.0),
    Case(LINK, "delayed by 500 ms", on_wire(delayed(0.5)), goal_s=IGNORED_S, observe_s=10.0),
    Case(LINK, "autopilot reboots", order("reboot"), observe_s=10.0),
    Case(UWB, "silent", order("uwb_silent"), goal_s=UNSEEN_S, observe_s=13.0, config=blind_early, quick=True),
    Case(UWB, "garbage", tag_babbles, goal_s=UNSEEN_S, observe_s=13.0, config=blind_early),
    Case(UWB, "all anchors lost", order("no_anchors"), goal_s=UNSEEN_S, observe_s=13.0, config=blind_early),
    Case(UWB, "one anchor reads 15 m far", order(f"far 15 {ONE_FAR}"), "on", observe_s=13.0, config=blind_early),
    Case(
        UWB,
        "all anchors read 15 m far",
        order(f"far 15 {ALL_ANCHORS}"),
        goal_s=UNSEEN_S,
        observe_s=13.0,
        config=blind_early,
    ),
    Case(UWB, "held back 3 s, then all at once", tag_held_back, "on", observe_s=10.0, config=blind_early),
    Case(IMU, "autopilot's clock jumps 10 s ahead", order("clock 10"), "rules", observe_s=10.0),
    Case(IMU, "autopilot's clock jumps 5 s back", order("clock -5"), "rules", observe_s=10.0),
    Case(IMU, "IMU and attitude frozen", order("imu_frozen"), goal_s=UNSEEN_S, observe_s=20.0, config=blind_early),
    Case(
        IMU,
        "attitude not a number",
        on_wire(attitude_not_a_number()),
        goal_s=UNSEEN_S,
        observe_s=13.0,
        config=blind_early,
    ),
    Case(BOAT, "battery critical: 12.5 V", order("volts 12.5"), goal_s=BATTERY_S, observe_s=10.0),
    Case(BOAT, "battery low: 13.8 V", order("volts 13.8"), "on", observe_s=9.0),
    Case(
        BOAT,
        "swept across the fence by 1.2 m/s of current",
        drift_out,
        goal_s=FENCE_S,
        observe_s=5.0,
        sim=("--wiring", "gate", "--start", "10", "27.5", "0"),
        config=beside_fence,
        since=crossed_fence,
    ),
    Case(PEOPLE, "RC takeover: channel 5 by 300 us", order(sticks(16, c5=1800)), sim=GATE16),
    Case(PEOPLE, "station disarms, gate", command(DISARM, 0)),
    Case(PEOPLE, "station sets HOLD, gate", command(SET_MODE, 1, HOLD)),
    Case(PEOPLE, "station disarms, scaled", command(DISARM, 0), goal_s=HEARTBEAT_S, sim=SCALED),
    Case(PEOPLE, "station sets HOLD, scaled", command(SET_MODE, 1, HOLD), goal_s=HEARTBEAT_S, sim=SCALED),
    Case(PEOPLE, "two companions at once", second_companion, goal_s=TURNS_S, since=second_spoke),
    Case(PEOPLE, "shore absent: nobody at forward.url", lambda trial: None, "on", observe_s=6.0, config=absent_shore),
    Case(REFUSAL, "aritra run --start", lambda trial: None, "never", sim=PLAIN, quick=True, ends_s=REFUSED_S),
    Case(
        REFUSAL,
        "aritra run --start --unchecked, SIGKILL",
        kill,
        "rules",
        sim=PLAIN_ARMS,
        run=("--start", "--unchecked"),
    ),
)
