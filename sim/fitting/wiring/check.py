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

from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.problems import unit_fault
from companion.logs.runs.run import Run
from sim.fitting.engine.split import NamedLog
from sim.fitting.wiring.compass import compass_finding
from sim.fitting.wiring.correction import Correction
from sim.fitting.wiring.decision import decided, has_own_axes
from sim.fitting.wiring.evidence import Connection, candidates, evidence
from sim.fitting.wiring.record import WiringReport
from sim.fitting.wiring.sensors import findings_by_log, gyro_fault, imu_fault, one_of
from sim.fitting.wiring.thrusters import append_note

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
    as_given = dict(runs)
    # 1. Unit and sign of the gyro.
    gyro = _each(gyro_fault, runs)
    _apply(gyro, runs)
    # 2. Thrusters, heading and positions, by all fitted logs together.
    any_axes = all(has_own_axes(runs[log.name]) for log in logs if log.name in runs)
    tried, seen = candidates(vessel, any_axes), {}
    for i, log in enumerate(logs):
        say(log.name, i / len(logs))
        if log.name in runs and (found := evidence(runs[log.name], vessel, tried)) is not None:
            seen[log.name] = found
    best, findings, unknown = decided(seen, tried, as_given)
    alike = {log.name for log in reference if log.name in runs and best and _shows(best, runs[log.name], vessel)}
    if best and best.motion:
        moved = [name for name in runs if name in alike or name not in {log.name for log in reference}]
        _apply(dict.fromkeys(moved, best.motion), runs)
        again = _each(gyro_fault, {name: runs[name] for name in moved})  # by the heading as it is now
        _apply(again, runs)
        both = ((name, one_of(gyro.get(name), again.get(name))) for name in {**gyro, **again})
        gyro = {name: found for name, found in both if found}
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
    corrected = noted(best.way.vessel, vessel) if best and best.way else vessel
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


def noted(changed: VesselFile, vessel: VesselFile) -> VesselFile:
    """`changed` with a note in the `source` of every thruster that differs."""
    pairs = zip(changed.thrusters, vessel.thrusters, strict=True)
    return replace(
        changed,
        thrusters=tuple(
            new if new == old else replace(new, source=append_note(new.source, NOTE)) for new, old in pairs
        ),
    )
