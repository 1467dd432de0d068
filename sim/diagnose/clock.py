"""One clock for several logs: what changes slowly goes on from one to the next."""

from __future__ import annotations

from collections.abc import Sequence

from sim.identify.run import Run


def clock_start(run: Run, runs: Sequence[Run]) -> float:
    """When a run begins on the clock that all of them share [s]: by the stamps, else one after the other."""
    zero = min(r.meta.zero_ns for r in runs)
    if any(r.meta.zero_ns != zero for r in runs) or len(runs) == 1:
        return (run.meta.zero_ns - zero) * 1e-9
    before = 0.0
    for other in runs:
        if other is run:
            break
        before += other.duration_s
    return before
