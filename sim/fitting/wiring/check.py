"""Is the boat connected as its file says? Asked of the logs before anything is fitted, without a model of the hull.

    gyro against heading            unit and sign                                  each log by itself
    speeds against thruster forces  places and signs of thrusters; axes of         all fitted logs together
                                    heading and positions
    accelerations against positions axes of the IMU                                each log by itself
    course against heading          hard iron at the compass                       all fitted logs together

What is found for certain is put right: thrusters in the vessel file, columns in the logs. What is in doubt is told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.problems import unit_fault
from companion.logs.runs.run import Run
from sim.fitting.engine.split import NamedLog
from sim.fitting.wiring.compass import compass_finding
from sim.fitting.wiring.correction import Correction
from sim.fitting.wiring.evidence import Connection, Evidence, candidates, evidence
from sim.fitting.wiring.record import SURE_NATS, WiringFinding, WiringReport
from sim.fitting.wiring.sensors import findings_by_log, gyro_fault, imu_fault
from sim.fitting.wiring.thrusters import DEAD, append_note

RIVAL_NATS = 1.0
"""Least nats over the next best of what is named; `SURE_NATS` over the file as it is. Right logs: below 0."""
HINT_NATS, OPEN_NATS = 3.0, 3.0
"""Nats from which on something is told though not named; what is nearer than that to the best is a rival."""
EXPLAINED, LEFT = 0.4, 0.75
"""Least share of the variance that it explains in surge and sway or in yaw, and largest share of what the file leaves
that it leaves there. Thrusters that fight wind and waves push against the motion, and explain little of it."""
NOTE = "wiring as the logs show it"


@dataclass(frozen=True)
class Checked:
    """Logs and vessel as a fit shall take them, and what was found."""

    logs: tuple[NamedLog, ...]
    held_out: tuple[NamedLog, ...]
    reference: tuple[NamedLog, ...]
    vessel: VesselFile
    wiring: WiringReport


def checked(
    logs: Sequence[NamedLog],
    held_out: Sequence[NamedLog],
    vessel: VesselFile,
    *,
    reference: Sequence[NamedLog] = (),
    as_found: bool = False,
    say: Callable[[str, float], None] = lambda _text, _share: None,
) -> Checked:
    """What the logs `logs` say of the wiring; `held_out` are corrected alike, and `reference` where it shows the same.

    `as_found`: everything stays as it is.
    Logs without what is needed are passed on unchanged: the fit itself says what is wrong with them.
    """
    given = (*logs, *held_out, *reference)
    runs = {log.name: log.run for log in given if _able(log.run, vessel)}
    # 1. Unit and sign of the gyro.
    gyro = _each(gyro_fault, runs)
    _apply(gyro, runs)
    # 2. Thrusters, heading and positions, by all fitted logs together.
    tried, seen = candidates(vessel), {}
    for i, log in enumerate(logs):
        say(log.name, i / len(logs))
        if log.name in runs and (found := evidence(runs[log.name], vessel, tried)) is not None:
            seen[log.name] = found
    best, findings, unknown = _decided(seen, tried)
    alike = {log.name for log in reference if log.name in runs and best and _shows(best, runs[log.name], vessel)}
    if best and best.motion:
        moved = [name for name in runs if name in alike or name not in {log.name for log in reference}]
        _apply(dict.fromkeys(moved, best.motion), runs)
        if best.motion.heading[0] < 0:  # the gyro was right
            wrong = [name for name in moved if name in gyro and gyro[name].gyro < 0]
            _apply(dict.fromkeys(wrong, Correction("", "", gyro=-1.0)), runs)
            gyro = {name: found for name, found in gyro.items() if name not in wrong}
    # 3. Axes of the IMU.
    imu = _each(imu_fault, runs)
    _apply(imu, runs)
    findings += findings_by_log(gyro, imu, runs)
    # 4. The compass, as everything else is right now.
    findings += compass_finding({log.name: runs[log.name] for log in logs if log.name in runs}, vessel)
    left_out = tuple(log.name for log in reference if best and best.way and log.name not in alike)
    wiring = WiringReport(
        findings=tuple(findings),
        unknown=unknown,
        logs=len(seen),
        as_found=as_found and bool(findings),
        left_out=() if as_found else left_out,
    )
    say("", 1.0)
    if as_found:
        return Checked(tuple(logs), tuple(held_out), tuple(reference), vessel, wiring)
    corrected = _noted(best.way.vessel, vessel) if best and best.way else vessel
    new, new_out, new_reference = (
        tuple(NamedLog(log.name, runs.get(log.name, log.run)) for log in some if log.name not in left_out)
        for some in (logs, held_out, reference)
    )
    return Checked(new, new_out, new_reference, corrected, wiring)


def _each(look: Callable[[Run], Correction | None], runs: Mapping[str, Run]) -> dict[str, Correction]:
    """What `look` finds, by name of the log."""
    return {name: found for name, run in runs.items() if (found := look(run))}


def _apply(corrections: Mapping[str, Correction], runs: dict[str, Run]) -> None:
    """Correct `runs` in place."""
    for name, correction in corrections.items():
        runs[name] = correction.apply(runs[name])


def _shows(best: Connection, run: Run, vessel: VesselFile) -> bool:
    """Whether a log by itself speaks for `best`, too."""
    found = evidence(run, vessel, [Connection(), best])
    return found is not None and bool(found.nats[1] > 0)


def _able(run: Run, vessel: VesselFile) -> bool:
    needed = ("psi_rad", "north_m", *(f"pwm_{t.name}" for t in vessel.thrusters))
    named = set(run.thrusters) == {t.name for t in vessel.thrusters}
    return named and all(run.known(c) for c in needed) and not unit_fault(run)


def _noted(changed: VesselFile, vessel: VesselFile) -> VesselFile:
    """`changed` with a note in the `source` of every thruster that differs."""
    pairs = zip(changed.thrusters, vessel.thrusters, strict=True)
    return replace(
        changed,
        thrusters=tuple(
            new if new == old else replace(new, source=append_note(new.source, NOTE)) for new, old in pairs
        ),
    )


def _decided(
    seen: Mapping[str, Evidence], tried: Sequence[Connection]
) -> tuple[Connection | None, list[WiringFinding], tuple[str, ...]]:
    """What is to be put right, what is told, and which single faults the logs leave open."""
    if not seen:
        return None, [], ()
    logs = list(seen.values())
    whole = sum(logs[1:], logs[0])
    nats, order = whole.nats, np.argsort(-whole.nats, kind="stable")
    best = int(order[0])
    less = whole.left[:, best] <= LEFT * whole.left[:, 0]
    explains = bool((less & (whole.explained[:, best] >= EXPLAINED)).any())
    dead = tried[best].name.startswith(DEAD)
    if dead or nats[best] < HINT_NATS or not explains:
        least = [max(-OPEN_NATS, nats[best] - SURE_NATS) if dead and one.way else -OPEN_NATS for one in tried]
        near = [tried[i] for i in order if nats[i] > least[i] and tried[i].faults == 1]
        return None, [], tuple(one.text for one in near if not one.name.startswith(DEAD))
    near = [i for i in order[1:] if nats[i] > nats[best] - OPEN_NATS and tried[i].faults == 1]
    against = tuple(name for name, one in seen.items() if one.nats[best] < -SURE_NATS)
    clear = bool(nats[best] >= SURE_NATS and nats[best] - nats[order[1]] >= RIVAL_NATS and not against)
    finding = WiringFinding(
        name=tried[best].name,
        text=tried[best].text,
        nats=round(float(nats[best]), 1),
        logs=tuple(seen),
        certain=clear,
        rivals=tuple(tried[i].text for i in near),
        against=against,
        thrusters=tried[best].way is not None,
    )
    return (tried[best] if clear else None), [finding], ()
