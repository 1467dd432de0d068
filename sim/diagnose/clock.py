"""One clock for several logs: what changes slowly goes on from one to the next."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from sim.identify.run import Run


def clock_start(run: Run, runs: Sequence[Run]) -> float:
    """When the first row of a run is on the clock that all of them share [s]: by the stamps, else one after the other.

    Nought is the first row of all.
    """
    if by_stamps(runs):
        zero = min(r.meta.zero_ns for r in runs)
        begins = {id(r): (r.meta.zero_ns - zero) * 1e-9 + float(r.table["t_s"][0]) for r in runs}
        return begins[id(run)] - min(begins.values())
    before = 0.0
    for other in runs:
        if other is run:
            break
        before += other.duration_s
    return before


def by_stamps(runs: Sequence[Run]) -> bool:
    """Whether stamps tell when each was: they differ, or the runs are parts of one log."""
    spans = sorted((float(r.table["t_s"][0]), float(r.table["t_s"][-1])) for r in runs)
    return len({r.meta.zero_ns for r in runs}) > 1 or all(a[1] <= b[0] for a, b in pairwise(spans))
