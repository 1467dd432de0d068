"""A log whose recording paused, as the logs that it is: nobody knows what was commanded meanwhile."""

from __future__ import annotations

import numpy as np

from sim.identify.blocks import HISTORY_S, part
from sim.identify.job_split import JobError
from sim.identify.run import Run

PAUSE_S, PERIODS = 2.0, 3.5  # a longer silence of all columns, commands too, and of so many rows, is a pause; assumed
PIECE_S, FIXES = 10.0, 8  # shorter pieces, and with fewer positions, are left out; assumed


def unbroken(run: Run) -> list[Run]:
    """`run` cut where its recording paused; the run itself where it never did. JobError where nothing long is left."""
    t_s, measured = run.table["t_s"].to_numpy(), run.measured_s()
    t_s = t_s[t_s >= measured[0]]  # before are commands only, those that changed
    steps = np.diff(t_s)
    usual = float(np.median(steps)) if len(steps) else 0.0
    pauses = np.flatnonzero(steps > max(PAUSE_S, PERIODS * usual))
    if not len(pauses):
        return [run]
    begins, ends = [t_s[0], *t_s[pauses + 1]], [*t_s[pauses], t_s[-1]]
    spans = [(float(a), float(b)) for a, b in zip(begins, ends, strict=True) if b - a >= PIECE_S]
    pieces = [part(run, a, b, HISTORY_S if a == t_s[0] else 0.0) for a, b in spans]
    whole = [piece for piece in pieces if _usable(piece)]
    if not whole:
        raise JobError(
            f"{run.meta.source}: the recording pauses {len(pauses)} times, first at {ends[0]:g} s; no piece of "
            f"{PIECE_S:g} s with heading and {FIXES} positions is left"
        )
    return whole


def _usable(piece: Run) -> bool:
    return piece.known("psi_rad") and len(piece.samples("north_m", "east_m")[0]) >= FIXES
