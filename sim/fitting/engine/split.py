"""Which part of which log is fitted and which is held out, and whether the logs can be used at all.

Rules, the first that applies:

logs named to be held out   every other log is fitted whole
alternate blocks of S s     the first, third .. of each log are fitted, the second, fourth .. held out
neither                     the last quarter of each log is held out, 20 s at least; shorter logs are fitted whole

Where the recording paused nobody knows what was commanded, and after a reset heading or position is another: logs are
cut there, and only recorded seconds count.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from companion.logs.readers.gps import NO_FIX
from companion.logs.runs.as_if_blank import without_absurd_voltages, without_dead_columns, without_held_readings
from companion.logs.runs.fingerprint import fingerprint, overlap
from companion.logs.runs.origin import with_one_origin
from companion.logs.runs.problems import IDLE_US, dead_columns, unit_fault
from companion.logs.runs.run import LogProblem, Run, RunError, RunMeta
from companion.logs.runs.splits import HeldOut, Interval, alternate, length_s, parts, recording_intervals, tail
from sim.fitting.engine.wind import is_measured
from sim.fitting.engine.windows import LEAST_FIXES, SETTLE_S, inside_edges

SHARE = 0.25
LEAST_FIT_S, LEAST_HELD_OUT_S = 30.0, 20.0
"""Assumed: a few of the hull's time constants to fit on; two open-loop runs of 10 s to be judged by."""
PIECE_S, FIXES = 10.0, 8  # shorter pieces, and with fewer positions, are left out; assumed
OTHER_BOAT, WIND = "another boat", "measured wind"
"""Kinds of problems: logs state several boats; who uses the wind that was measured."""
UNCERTAIN = ("no pulse", "constant", "outputs by order", "filtered positions")
"""Kinds of problems by which a log may not hold what was driven, or what a sensor measured; fits name them, too."""
NEEDED = f"a piece needs {PIECE_S:g} s with heading, commands and {FIXES} positions"


class JobError(ValueError):
    """Logs and vessel file cannot be used together. The text names the log, what is wrong with it, and a remedy."""


@dataclass(frozen=True)
class NamedLog:
    """One log under the name by which its user knows it."""

    name: str
    run: Run


@dataclass(frozen=True)
class LogUse:
    """How one log is used: intervals [s] on its own clock that are fitted, and that are held out."""

    log: NamedLog
    fitted_s: tuple[Interval, ...]
    held_out_s: tuple[Interval, ...]


@dataclass(frozen=True)
class Split:
    """`fitted`: runs to fit; `held_out`: what models are judged on; `used`: the same by log; `rule`: as a sentence."""

    fitted: tuple[Run, ...]
    held_out: tuple[HeldOut, ...]
    used: tuple[LogUse, ...]
    rule: str

    @property
    def fitted_length_s(self) -> float:
        """Of what is fitted [s]."""
        return sum(length_s(use.fitted_s) for use in self.used)

    @property
    def held_out_length_s(self) -> float:
        """Of what is held out [s]."""
        return sum(length_s(use.held_out_s) for use in self.used)

    def about(self, vessel: VesselFile) -> tuple[tuple[str, str], ...]:
        """What a report is about, name and value: the boat, the logs, how much of them is fitted and held out."""
        size = f"{vessel.hull.length_m:g} m, {vessel.inertia.mass_kg:g} kg, {len(vessel.thrusters)} thrusters"
        logs = ", ".join(f"{use.log.name} ({_recorded_s(use.log):.0f} s)" for use in self.used)
        shares = f"{self.fitted_length_s:.0f} s fitted, {self.held_out_length_s:.0f} s held out"
        return ("Boat", f"{vessel.name}: {size}"), ("Logs", logs), ("Of them", shares)


def split(
    logs: Sequence[NamedLog], held_out: Sequence[NamedLog], vessel: VesselFile, block_s: float | None = None
) -> Split:
    """Divide the logs. Raises JobError or RunError naming the log where one cannot be used."""
    if not logs:
        raise JobError("no log to fit")
    logs, held_out = [usable(log, vessel) for log in logs], [usable(log, vessel) for log in held_out]
    reject_overlap([*logs, *held_out])
    runs = with_one_origin([log.run for log in (*logs, *held_out)])
    named = [NamedLog(log.name, run) for log, run in zip((*logs, *held_out), runs, strict=True)]
    logs, held_out = named[: len(logs)], named[len(logs) :]
    boats = {log.run.meta.vessel for log in (*logs, *held_out)} - {RunMeta().vessel}
    logs, held_out = [_of_boat(log, boats) for log in logs], [_of_boat(log, boats) for log in held_out]
    if held_out:
        used = [LogUse(_long(log, LEAST_FIT_S, "to fit"), (_all(log),), ()) for log in logs]
        used += [LogUse(_long(log, LEAST_HELD_OUT_S, "to be held out"), (), (_all(log),)) for log in held_out]
        rule = "the logs named to be held out; all others were fitted whole"
    elif block_s:
        used = [_alternate(log, block_s) for log in logs]
        rule = f"alternate blocks of {block_s:g} s of each log, the second, fourth and so on"
    else:
        used = _tails(logs)
        whole = sum(not u.held_out_s for u in used)
        rule = f"the last {100 * SHARE:g} % of each log, {LEAST_HELD_OUT_S:g} s at least"
        if whole:
            rule += f"; {whole} of {len(used)} are too short for that and were fitted whole"
    pauses = sum(len(recording_intervals(u.log.run)) - 1 for u in used)
    rule += f"; cut at pauses and resets ({pauses} times)" if pauses else ""
    used = [_without_pauses(u) for u in used]
    fitted = [run for u in used for run in parts(u.log.run, u.fitted_s)]
    out = [HeldOut(u.log.run, None if u.held_out_s == (_all(u.log),) else u.held_out_s) for u in used if u.held_out_s]
    return Split(tuple(fitted), tuple(out), tuple(used), rule)


def _of_boat(log: NamedLog, boats: Collection[str]) -> NamedLog:
    """The log with a note where `boats`, which the logs state, are several, and it states one of them."""
    if len(boats) < 2 or log.run.meta.vessel not in boats:
        return log
    others = ", ".join(sorted({*boats} - {log.run.meta.vessel}))
    text = f"it states {log.run.meta.vessel}, others {others}: what differs between boats is fitted as if it were one's"
    return NamedLog(log.name, log.run.with_notes([LogProblem(kind=OTHER_BOAT, text=text)]))


def reject_overlap(logs: Sequence[NamedLog]) -> None:
    """Raise JobError naming two logs of which one holds the other's data, or a part of it."""
    seen = [(log.name, log.run.data_hash, fingerprint(log.run)) for log in logs]
    for (other, other_hash, other_marks), (name, data_hash, marks) in combinations(seen, 2):
        if data_hash == other_hash:
            raise JobError(f"{name}: holds the same data as {other}; name each log once")
        if overlap(other_marks, marks):
            raise JobError(
                f"{name}: holds positions of {other}: one is a part of the other, or both are of one recording; name "
                "logs that have nothing in common"
            )


def usable(log: NamedLog, vessel: VesselFile, *, at_rest: bool = False) -> NamedLog:
    """The log under its own name, with its thrusters in the vessel file's order. Raises JobError.

    `at_rest`: a log in which no thruster ever leaves neutral is one, too. Sensors that say one and the same throughout
    (an IMU that is not there, written as zeros), and voltages that no pack has, are left blank, and noted.
    """
    run, names = Run(log.run.table, replace(log.run.meta, source=log.name)), tuple(t.name for t in vessel.thrusters)
    if set(run.thrusters) != set(names):
        raise JobError(
            f"{log.name}: columns pwm_{', pwm_'.join(run.thrusters)}, but the thrusters of {vessel.name} are "
            f"{', '.join(names)}: another boat's log, or another boat's vessel file"
        )
    if fault := unit_fault(run):
        raise JobError(f"{log.name}: {fault}")
    dead = dead_columns(run)
    run = without_absurd_voltages(without_dead_columns(run, dead), vessel.propulsion.nominal_voltage_V)
    run = without_held_readings(run)
    for column, what in (("psi_rad", "heading"), ("north_m", "position"), *((f"pwm_{n}", "commands") for n in names)):
        if not run.known(column):
            hint = _why_no_position(run, vessel) if column == "north_m" and column not in dead else ""
            state = "the same value" if column in dead else "blank"
            raise JobError(f"{log.name}: {column}: {state} throughout; nothing can be identified without {what}{hint}")
    if not at_rest and not _is_driven(run):
        source = run.meta.columns.get("pwm", "not stated")
        raise JobError(
            f"{log.name}: no thruster ever leaves neutral: nothing can be learned of a boat that is not commanded. If "
            f"it was, its thrusters are others than those that were read (source of the pulses: {source})"
        )
    if run.known("V_w_m_s"):
        text = (
            "V_w_m_s, beta_w_deg: identify has this wind where the file has [terms.wind], or predicts better by it (by "
            "the areas of [hull]); diagnose estimates the wind itself"
        )
        if not is_measured(run):
            text = "V_w_m_s: a wind without beta_w_deg, where it comes from, is used by no fit"
        run = run.with_notes([LogProblem(kind=WIND, text=text)])
    others = [c for c in run.table.columns if not c.startswith("pwm_")]
    return NamedLog(log.name, Run(run.table.select(*(f"pwm_{n}" for n in names), *others), run.meta))


def _is_driven(run: Run) -> bool:
    """Whether a thruster leaves the dead band of speed controllers about neutral, at some time."""
    pwm_us = run.table.select(f"pwm_{name}" for name in run.thrusters).to_numpy()
    return bool((np.abs(pwm_us - NEUTRAL_US) > IDLE_US).any())  # unknown (NaN) is not beyond it


def _why_no_position(run: Run, vessel: VesselFile) -> str:
    """What the reader says of it, else what to do about a boat whose positions come from UWB."""
    if said := [note.text for note in run.meta.notes if note.kind == NO_FIX]:
        return f": {said[0]}"
    return "" if vessel.sensors.gnss else "; `aritra log export --uwb` joins a UWB log to a .bin or .tlog"


def split_at_pauses(run: Run) -> list[Run]:
    """`run` cut at the pauses of its recording; the run itself where there are none. JobError: no usable part."""
    spans = recording_intervals(run)
    return [run] if len(spans) == 1 else parts(run, _usable(run, spans, spans, "used"))


def usable_intervals(run: Run, intervals: Sequence[Interval]) -> list[Interval]:
    """Those of `intervals` that last `PIECE_S` and hold heading, commands and positions enough for a fit."""
    pulses = [f"pwm_{name}" for name in run.thrusters]
    known = [run.samples(*columns)[0] for columns in (pulses, ("psi_rad",), ("north_m", "east_m"))]
    long = [(low, high) for low, high in intervals if high - low >= PIECE_S]
    return [(low, high) for low, high in long if _fits(*(t_s[(t_s >= low) & (t_s <= high)] for t_s in known))]


def _all(log: NamedLog) -> Interval:
    """From its first row to its last."""
    t_s = log.run.table["t_s"]
    return float(t_s[0]), float(t_s[-1])


def _recorded_s(log: NamedLog) -> float:
    """Length of a log without the pauses of its recording [s]."""
    return length_s(recording_intervals(log.run))


def _long(log: NamedLog, least_s: float, what: str) -> NamedLog:
    """The log. Raises JobError where less than `least_s` was recorded, the least for the purpose `what`."""
    if (recorded_s := _recorded_s(log)) < least_s:
        pauses = len(recording_intervals(log.run)) - 1
        between = f" beside {pauses} pauses of the recording" if pauses else ""
        raise JobError(f"{log.name}: {recorded_s:.1f} s{between}; {least_s:g} s are the least {what}")
    return log


def _alternate(log: NamedLog, block_s: float) -> LogUse:
    """Alternate blocks of a log. Raises JobError where it does not hold two."""
    if block_s < LEAST_HELD_OUT_S:
        raise JobError(f"blocks of {block_s:g} s: {LEAST_HELD_OUT_S:g} s are the least to be judged by")
    try:
        fitted, out = alternate(log.run, block_s)
    except RunError as error:
        raise JobError(f"{error}; choose shorter blocks, {LEAST_HELD_OUT_S:g} s at least, or hold out a log") from None
    return LogUse(log, tuple(fitted), tuple(out))


def _tails(logs: Sequence[NamedLog]) -> list[LogUse]:
    """The last part of each log held out, where it is long enough. Raises JobError where none is."""
    least_s = LEAST_FIT_S + LEAST_HELD_OUT_S
    _long(max(logs, key=_recorded_s), least_s, "when its last part is held out (or hold out another log)")
    return [
        _tail(log) if _recorded_s(log) >= least_s else LogUse(_long(log, LEAST_FIT_S, "to fit"), (_all(log),), ())
        for log in logs
    ]


def _tail(log: NamedLog) -> LogUse:
    fitted, out = tail(log.run, max(SHARE * _recorded_s(log), LEAST_HELD_OUT_S))
    return LogUse(log, (fitted,), (out,))


def _without_pauses(used: LogUse) -> LogUse:
    """`used` with usable intervals within the recorded spans, and a note of what is left out."""
    run = used.log.run
    spans = recording_intervals(run)
    if len(spans) == 1 and len(used.fitted_s) <= 1 and len(used.held_out_s) <= 1:
        return used
    fitted_s = _usable(run, used.fitted_s, spans, "fitted")
    held_out_s = _usable(run, used.held_out_s, spans, "held out")
    left_s = length_s(spans) - length_s(fitted_s) - length_s(held_out_s)
    if left_s > 1.0:
        text = f"{left_s:.0f} s in pieces that are too short, or hold too little, are not used: {NEEDED}"
        run = run.with_notes([LogProblem(kind="left out", text=text)])
    return LogUse(NamedLog(used.log.name, run), fitted_s, held_out_s)


def _usable(run: Run, intervals: Sequence[Interval], spans: Sequence[Interval], what: str) -> tuple[Interval, ...]:
    """Usable parts of the intervals `intervals` within the recorded `spans`. JobError where there is none.

    `what`: the purpose, for the message.
    """
    left = tuple(usable_intervals(run, [(max(low, a), min(high, b)) for low, high in intervals for a, b in spans]))
    if intervals and not left:
        pauses = f"{len(spans) - 1} pauses and resets, the first at {spans[0][1]:g} s; " if len(spans) > 1 else ""
        raise JobError(f"{run.meta.source}: {pauses}nothing of it can be {what}: {NEEDED}")
    return left


def _fits(commands_s: np.ndarray, heading_s: np.ndarray, fixes_s: np.ndarray) -> bool:
    """Whether one piece, by the stamps of its commands, headings and fixes [s], can be fitted."""
    if len(fixes_s) < FIXES or not len(commands_s) or not len(heading_s):
        return False
    begin_s, end_s = max(heading_s[0], commands_s[0] + SETTLE_S), heading_s[-1]
    return bool(end_s - begin_s >= PIECE_S / 2 and inside_edges(fixes_s, begin_s, end_s).sum() >= LEAST_FIXES)
