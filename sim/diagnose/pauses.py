"""Logs whose recording paused, as the pieces that they are: nobody knows what was commanded meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sim.identify.blocks import HeldOut, Interval, part, parts, recorded
from sim.identify.job_split import JobError, Log, Split, Used
from sim.identify.run import Problem, Run
from sim.identify.structured.data import EDGE_S, LEAST_FIXES, SETTLE_S

PIECE_S, FIXES = 10.0, 8  # shorter pieces, and with fewer positions, are left out; assumed
NEEDED = f"a piece needs {PIECE_S:g} s with heading, commands and {FIXES} positions"


def unbroken(run: Run) -> list[Run]:
    """`run` cut where its recording paused; the run itself where it never did. JobError where nothing long is left."""
    spans = recorded(run)
    if len(spans) == 1:
        return [run]
    kept = enough(run, spans)
    if not kept:
        raise _nothing_left(run, spans, "used")
    return pieces(run, kept)


def without_pauses(found: Split) -> Split:
    """`found` with intervals that end where the recording pauses, without those that hold too little, which is noted.

    Of a log without pauses that is in one piece, all stays. JobError where nothing is left of a log.
    """
    used = tuple(_without_pauses(one) for one in found.used)
    fitted = tuple(run for one in used for run in pieces(one.log.run, one.fitted_s))
    was = [one for one in found.used if one.held_out_s]
    now = [one for one in used if one.held_out_s]
    held_out = tuple(
        out if before is after else HeldOut(after.log.run, after.held_out_s)
        for out, before, after in zip(found.held_out, was, now, strict=True)
    )
    return replace(found, fitted=fitted, used=used, held_out=held_out)


def pieces(run: Run, intervals: Sequence[Interval]) -> list[Run]:
    """Intervals without pauses as runs, with the commands just before them, but none from before a pause."""
    spans, out = recorded(run), []
    for begin, end in spans:
        mine = [interval for interval in intervals if begin <= interval[0] <= end]
        after = begin > spans[0][0] and mine
        out += parts(replace(part(run, begin, end, 0.0), meta=run.meta) if after else run, mine)
    return out


def enough(run: Run, intervals: Sequence[Interval]) -> list[Interval]:
    """Those of the intervals that are long enough and hold what a fit needs."""
    pulses = [f"pwm_{name}" for name in run.thrusters]
    known = [run.samples(*columns)[0] for columns in (pulses, ("psi_rad",), ("north_m", "east_m"))]
    kept = []
    for low, high in intervals:
        commands, heading, fixes = (t_s[(t_s >= low) & (t_s <= high)] for t_s in known)
        if high - low < PIECE_S or len(fixes) < FIXES or not len(commands) or not len(heading):
            continue
        begin, end = max(heading[0], commands[0] + SETTLE_S), heading[-1]
        inside = (fixes > begin + EDGE_S) & (fixes < end - EDGE_S)
        if end - begin >= PIECE_S / 2 and inside.sum() >= LEAST_FIXES:
            kept.append((low, high))
    return kept


def _without_pauses(used: Used) -> Used:
    run = used.log.run
    spans = recorded(run)
    if len(spans) == 1 and len(used.fitted_s) <= 1 and len(used.held_out_s) <= 1:
        return used
    fitted_s, held_out_s = (_within(run, some, spans) for some in (used.fitted_s, used.held_out_s))
    for some, kept, what in ((used.fitted_s, fitted_s, "fitted"), (used.held_out_s, held_out_s, "held out")):
        if some and not kept:
            raise _nothing_left(run, spans, what)
    left_s = _length_s(spans) - _length_s(fitted_s) - _length_s(held_out_s)
    if left_s > 1.0:
        text = f"{left_s:.0f} s in pieces that are too short, or hold too little, are not used: {NEEDED}"
        run = run.with_notes([Problem(kind="left out", text=text)])
    return Used(Log(used.log.name, run), fitted_s, held_out_s)


def _within(run: Run, some: Sequence[Interval], spans: Sequence[Interval]) -> tuple[Interval, ...]:
    return tuple(enough(run, [(max(low, a), min(high, b)) for low, high in some for a, b in spans]))


def _length_s(some: Sequence[Interval]) -> float:
    return sum(high - low for low, high in some)


def _nothing_left(run: Run, spans: Sequence[Interval], what: str) -> JobError:
    pauses = f"the recording pauses {len(spans) - 1} times, first at {spans[0][1]:g} s; " if len(spans) > 1 else ""
    return JobError(f"{run.meta.source}: {pauses}nothing of it can be {what}: {NEEDED}")
