"""Parts of a run as runs of their own: blocks of time, alternate blocks, the last share; to fit and to hold out.

A part refers to its run (`Run.whole`) and keeps its clock: t_s is not moved. In front of it stand the rows of the last
`HISTORY_S` in which pulse widths or voltage changed, their sampled columns blank: so dead time and lag of the thrusters
start from what was commanded, and no measurement from outside the part is in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import polars as pl
from msgspec.structs import replace

from companion.logs.runs.columns import HELD
from companion.logs.runs.resets import reset_intervals
from companion.logs.runs.run import Run, RunError

HISTORY_S = 2.0
"""Commands kept from before a part: dead time and lag of small thrusters have passed by then. As in validation."""
PAUSE_S, PERIODS = 2.0, 3.5  # a gap of all columns longer than this, and than so many usual steps, is a pause; assumed
Interval = tuple[float, float]


def length_s(intervals: Sequence[Interval]) -> float:
    """Of all together [s]."""
    return sum(high - low for low, high in intervals)


"""Begin and end [s] on the run's clock."""


@dataclass(frozen=True)
class HeldOut:
    """A run held out from fits: the intervals `inside` [s] of it; None: all of it."""

    run: Run
    inside: tuple[Interval, ...] | None = None


def part(run: Run, low_s: float, high_s: float, history_s: float = HISTORY_S) -> Run:
    """Rows of low_s <= t_s <= high_s, with the commands of `history_s` before. RunError where nothing is measured."""
    t_s = run.table["t_s"].to_numpy()
    first, last = np.searchsorted(t_s, low_s), np.searchsorted(t_s, high_s, side="right")
    begin = max(int(np.searchsorted(t_s, low_s - history_s, side="right")) - 1, 0)
    source = f"{run.meta.source}, {low_s:g} to {high_s:g} s"
    inside = run.table[int(first) : int(last)]
    if not any(inside[c].null_count() < len(inside) for c in run.sampled):
        raise RunError(f"{source}: nothing is measured there; the run is from {t_s[0]:g} to {t_s[-1]:g} s")
    held = pl.col([c for c in run.table.columns if c.startswith(HELD)])
    before = run.table[: int(first)].with_columns(held.forward_fill())[begin:]
    before = before.filter(_changed(before)).with_columns(pl.lit(None, pl.Float64).alias(c) for c in run.sampled)
    return Run(pl.concat([before, inside]), replace(run.meta, source=source), run.whole)


def parts(run: Run, intervals: Sequence[Interval], history_s: float = HISTORY_S) -> list[Run]:
    """`part` of each interval, without commands from before a pause of the recording: whether they lasted is unknown.

    An interval must not reach across a pause.
    """
    begins, found = [begin for begin, _ in recording_intervals(run)[1:]], []
    for begin, end in pairwise([-np.inf, *begins, np.inf]):
        mine = [one for one in intervals if begin <= one[0] < end]
        cut = begin > -np.inf and mine
        since = Run(run.table.filter(pl.col("t_s") >= begin), run.meta, run.whole) if cut else run
        found += [part(since, low_s, high_s, history_s) for low_s, high_s in mine]
    return found


def source_runs(runs: Sequence[Run]) -> list[Run]:
    """The whole logs that `runs` are parts of, each once."""
    return list({id(run.whole): run.whole for run in runs}.values())


def recording_intervals(run: Run) -> list[Interval]:
    """Intervals between pauses of the recording; the whole run where it never paused.

    A reset of heading or position counts as a pause: no motion of a boat leads from before it to after it.
    """
    t_s = run.table["t_s"].to_numpy()
    since = t_s[t_s >= run.measured_s()[0]]  # before are commands only, those that changed
    steps = np.diff(since)
    usual = float(np.median(steps)) if len(steps) else 0.0
    pauses = np.flatnonzero(steps > max(PAUSE_S, PERIODS * usual))
    holes = [(float(since[i]), float(since[i + 1])) for i in pauses] + reset_intervals(run)
    if not holes:
        return [(float(t_s[0]), float(t_s[-1]))]
    edges: list[Interval] = [(-np.inf, float(since[0]))]
    for low, high in sorted(holes):
        if low < edges[-1][1]:
            edges[-1] = edges[-1][0], max(edges[-1][1], high)
        else:
            edges.append((low, high))
    begins, ends = [high for _, high in edges], [low for low, _ in edges[1:]] + [float(since[-1])]
    return list(zip(begins, ends, strict=True))


def block_intervals(run: Run, block_s: float) -> list[Interval]:
    """Blocks of `block_s` from the first row on, starting anew after each pause of the recording.

    A remainder shorter than half a block joins the last one. Left out: intervals between pauses that are shorter than a
    block, and blocks in which nothing is measured. RunError for a run that is shorter than one block.
    """
    begin, end = float(run.table["t_s"][0]), float(run.table["t_s"][-1])
    if not 0 < block_s <= end - begin:
        raise RunError(f"{run.meta.source}: {end - begin:g} s cannot be cut into blocks of {block_s:g} s")
    measured = run.measured_s()
    blocks = [block for low, high in recording_intervals(run) for block in _blocks(low, high, block_s)]
    return [(low, high) for low, high in blocks if ((measured >= low) & (measured <= high)).any()]


def _blocks(begin: float, end: float, block_s: float) -> list[Interval]:
    """Blocks of one interval; none where it is shorter than a block."""
    if end - begin < block_s:
        return []
    count = int(np.floor((end - begin) / block_s + 0.5))
    edges = [*(begin + block_s * np.arange(count)).tolist(), end]
    return [(low, before(high) if high < end else high) for low, high in pairwise(edges)]


def alternate(run: Run, block_s: float) -> tuple[list[Interval], list[Interval]]:
    """Blocks to fit (the first, the third ..) and blocks to hold out (the second, the fourth ..).

    RunError where there are not two.
    """
    blocks = block_intervals(run, block_s)
    if len(blocks) < 2:
        pauses = len(recording_intervals(run)) - 1
        between = f" between {pauses} pauses of the recording" if pauses else ""
        raise RunError(f"{run.meta.source}: {run.duration_s:g} s{between} hold no two blocks of {block_s:g} s")
    return blocks[::2], blocks[1::2]


def tail(run: Run, held_out_s: float) -> tuple[Interval, Interval]:
    """Interval to fit, and the last `held_out_s` to hold out. RunError where nothing would be left to fit.

    Pauses of the recording count for nothing.
    """
    spans = recording_intervals(run)
    if not 0 < held_out_s < length_s(spans):
        raise RunError(f"{run.meta.source}: cannot hold out {held_out_s:g} s of {length_s(spans):g} s")
    left_s = held_out_s
    while left_s > length_s(spans[-1:]):
        left_s -= length_s(spans[-1:])
        spans = spans[:-1]
    begin, end, middle = float(run.table["t_s"][0]), float(run.table["t_s"][-1]), spans[-1][1] - left_s
    return (begin, before(middle)), (middle, end)


def before(t_s: float) -> float:
    """The last instant before `t_s`, so that no row is in two parts."""
    return float(np.nextafter(t_s, -np.inf))


def _changed(rows: pl.DataFrame) -> pl.Series:
    """The first row, and those whose held values differ from the row before."""
    held = rows.select(c for c in rows.columns if c.startswith(HELD)).to_numpy()
    same = (held[1:] == held[:-1]) | (np.isnan(held[1:]) & np.isnan(held[:-1]))
    return pl.Series(np.append(True, ~same.all(axis=1))[: len(rows)])
