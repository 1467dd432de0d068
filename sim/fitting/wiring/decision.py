"""What evidence of all logs together comes to: what is put right, what is told only, what the logs leave open.

A mirrored log looks as a boat whose sides are mirrored. What tells them apart is where a log's axes are known, and an
IMU that is not mirrored along with the rest: it counts against whichever has it turned over, as one fault more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from companion.logs.runs.disagreements import turn_ratio
from companion.logs.runs.run import Run
from sim.fitting.wiring.correction import ENU
from sim.fitting.wiring.evidence import RARE_NATS, Connection, Evidence
from sim.fitting.wiring.record import SURE_NATS, WiringFinding
from sim.fitting.wiring.sensors import sway_sign
from sim.fitting.wiring.thrusters import DEAD

RIVAL_NATS = 1.0
"""Least nats over the next best of what is named; `SURE_NATS` over the file as it is. Right logs: below 0."""
HINT_NATS, OPEN_NATS = 3.0, 3.0
"""Nats from which on something is told though not named; what is nearer than that to the best is a rival."""
EXPLAINED, LEFT = 0.4, 0.75
"""Least share of the variance that it explains in surge and sway or in yaw, and largest share of what the file leaves
that it leaves there. Thrusters that fight wind and waves push against the motion, and explain little of it."""
FIND_OUT = (
    "Find out before you touch a motor: turn the boat to starboard by hand and log that. Where psi_rad falls, the log "
    "is mirrored: correct what writes it, and leave the thrusters as they are. Where it grows, correct the wiring."
)


def has_own_axes(run: Run) -> bool:
    """Whether the log's axes are those of whoever wrote it, not of an autopilot whose messages this program read.

    Whatever reads those states where pulse widths come from, and the file that is written of it says so.
    """
    return "pwm" not in run.meta.columns or any(note.kind == "edited" for note in run.meta.notes)


def decided(
    seen: Mapping[str, Evidence], tried: Sequence[Connection], runs: Mapping[str, Run]
) -> tuple[Connection | None, list[WiringFinding], tuple[str, ...]]:
    """What is to be put right, what is told, and which single faults the logs `runs`, as given, leave open."""
    if not seen:
        return None, [], ()
    logs = list(seen.values())
    whole = sum(logs[1:], logs[0])
    nats = whole.nats + _by_imu(whole.nats, tried, [runs[name] for name in seen])
    nats = np.round(nats, 6)  # a mirrored log is as good as mirrored sides but for rounding
    order = np.argsort(-nats, kind="stable")
    best = int(order[0])
    less = whole.left[:, best] <= LEFT * whole.left[:, 0]
    explains = bool((less & (whole.explained[:, best] >= EXPLAINED)).any())
    dead = tried[best].name.startswith(DEAD)
    if dead or nats[best] < HINT_NATS or not explains:
        least = [max(-OPEN_NATS, nats[best] - SURE_NATS) if dead and one.way else -OPEN_NATS for one in tried]
        open_ones = [tried[i] for i in order if nats[i] > least[i] and tried[i].faults == 1]
        return None, [], tuple(one.text for one in open_ones if not one.name.startswith(DEAD))
    behind = nats[best] - nats
    near = [i for i in order[1:] if behind[i] < (OPEN_NATS if tried[i].faults == 1 else RIVAL_NATS)]
    against = tuple(name for name, one in seen.items() if one.nats[best] < -SURE_NATS)
    clear = bool(nats[best] >= SURE_NATS and behind[order[1]] >= RIVAL_NATS and not against)
    mirrored = not clear and len({tried[i].motion is ENU for i in (best, *near)}) == 2
    one = tried[best]
    parts = [part for part in (one.motion, one.way) if part] if clear else [one]
    findings = [
        WiringFinding(
            name=part.name,
            text=part.text,
            nats=round(float(nats[best]), 1),
            logs=tuple(seen),
            certain=clear,
            rivals=tuple(tried[i].text for i in near),
            against=against,
            thrusters=one.way is not None and part is not one.motion,
            test=FIND_OUT if mirrored else "",
        )
        for part in parts
    ]
    return (one if clear else None), findings, ()


def _by_imu(nats: np.ndarray, tried: Sequence[Connection], runs: Sequence[Run]) -> np.ndarray:
    """What yaw rate and accelerations have to add to `nats` (c,): only where a mirrored log is among the best."""
    near = np.flatnonzero(nats > nats.max() - RARE_NATS - RIVAL_NATS).tolist()
    added = np.zeros(len(tried))
    if 0 not in near and any(tried[i].motion is ENU for i in near):
        added[near] = [-RARE_NATS * imu_is_turned_over(tried[i], runs) for i in near]
    return added


def imu_is_turned_over(one: Connection, runs: Sequence[Run]) -> bool:
    """Whether the IMU counts otherwise than `one` has heading and positions, and that is a fault of its own.

    It is none in a mirrored log in which everything is mirrored: who writes it so means it.
    """
    signs = {sign for run in runs for sign in _signs(one, run)}
    return -1 in signs and (one.motion is not ENU or 1 in signs)


def _signs(one: Connection, run: Run) -> tuple[int, int]:
    """Signs of yaw rate and sway acceleration, by heading and positions as `one` has them; 0: it does not show."""
    ratio = turn_ratio(run) if run.known("r_rad_s") else None
    factor = one.motion.heading[0] if one.motion else 1.0
    return int(np.sign((ratio or 0.0) * factor)), sway_sign(one.motion.apply(run) if one.motion else run)
