"""Logs whose recording paused, cut at the pauses: the commands during a pause are unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from companion.logs.runs.run import LogProblem, Run
from companion.logs.runs.splits import HeldOut, Interval, length_s, part, parts, recording_intervals
from sim.fitting.engine.split import JobError, LogUse, NamedLog, Split
from sim.fitting.engine.windows import LEAST_FIXES, SETTLE_S, inside_edges

PIECE_S, FIXES = 10.0, 8  # shorter pieces, and with fewer positions, are left out; assumed
NEEDED = f"a piece needs {PIECE_S:g} s with heading, commands and {FIXES} positions"


def split_at_pauses(run: Run) -> list[Run]:
    """`run` cut at the pauses of its recording; the run itself where there are none. JobError: no usable part."""
    spans = recording_intervals(run)
    return [run] if len(spans) == 1 else intervals_as_runs(run, _usable(run, spans, spans, "used"))


def without_pauses(original: Split) -> Split:
    """`original` with intervals cut at pauses, without unusable ones; what is left out is noted in the log's problems.

    A log in one piece without pauses is unchanged. JobError where no interval of a log is usable.
    """
    used = tuple(_without_pauses(one) for one in original.used)
    fitted = tuple(run for one in used for run in intervals_as_runs(one.log.run, one.fitted_s))
    both = [(was, now) for was, now in zip(original.used, used, strict=True) if was.held_out_s]
    held_out = tuple(
        out if now is was else HeldOut(now.log.run, now.held_out_s)
        for out, (was, now) in zip(original.held_out, both, strict=True)
    )
    return replace(original, fitted=fitted, used=used, held_out=held_out)


def intervals_as_runs(run: Run, intervals: Sequence[Interval]) -> list[Run]:
    """`intervals` of `run` (none across a pause) as runs, with the commands just before each, but since the pause."""
    spans, out = recording_intervals(run), []
    for begin, end in spans:
        mine = [interval for interval in intervals if begin <= interval[0] <= end]
        after = begin > spans[0][0] and mine
        out += parts(replace(part(run, begin, end, 0.0), meta=run.meta) if after else run, mine)
    return out


def usable_intervals(run: Run, intervals: Sequence[Interval]) -> list[Interval]:
    """Those of `intervals` that last `PIECE_S` and hold heading, commands and positions enough for a fit."""
    pulses = [f"pwm_{name}" for name in run.thrusters]
    known = [run.samples(*columns)[0] for columns in (pulses, ("psi_rad",), ("north_m", "east_m"))]
    long = [(low, high) for low, high in intervals if high - low >= PIECE_S]
    return [(low, high) for low, high in long if _fits(*(t_s[(t_s >= low) & (t_s <= high)] for t_s in known))]


def _fits(commands_s: np.ndarray, heading_s: np.ndarray, fixes_s: np.ndarray) -> bool:
    """Whether one piece, by the stamps of its commands, headings and fixes [s], can be fitted."""
    if len(fixes_s) < FIXES or not len(commands_s) or not len(heading_s):
        return False
    begin_s, end_s = max(heading_s[0], commands_s[0] + SETTLE_S), heading_s[-1]
    return bool(end_s - begin_s >= PIECE_S / 2 and inside_edges(fixes_s, begin_s, end_s).sum() >= LEAST_FIXES)


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
        pauses = f"the recording pauses {len(spans) - 1} times, first at {spans[0][1]:g} s; " if len(spans) > 1 else ""
        raise JobError(f"{run.meta.source}: {pauses}nothing of it can be {what}: {NEEDED}")
    return left
