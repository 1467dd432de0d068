"""Subsampling of long logs: evenly spread pieces are fitted, so that memory and time stay bounded."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import floor

import numpy as np

from companion.logs.runs.splits import Interval, length_s, parts
from sim.fitting.engine.split import NEEDED, JobError, Split, usable_intervals

LONGEST_S = 1000.0  # of all fitted logs together: a quarter of an hour tells nearly every cause; assumed
PIECE_S = 50.0  # long against every time constant of a boat, short against drift and draining batteries; assumed


def subsample(original: Split) -> Split:
    """`original`, or where more than `LONGEST_S` would be fitted, usable pieces of `PIECE_S` evenly spread over it.

    JobError where no piece can be used.
    """
    total_s = original.fitted_length_s
    if total_s <= LONGEST_S:
        return original
    usable_pieces = [
        usable_intervals(used.log.run, [p for one in used.fitted_s for p in _pieces(one)]) for used in original.used
    ]
    usable_s = sum(map(length_s, usable_pieces))
    share, seen, kept = min(LONGEST_S / max(usable_s, PIECE_S), 1.0), 0, []
    for used, pieces in zip(original.used, usable_pieces, strict=True):
        taken: list[Interval] = []
        for piece in pieces:
            seen += 1
            if floor(seen * share) > floor((seen - 1) * share):
                begun = taken.pop()[0] if taken and taken[-1][1] == piece[0] else piece[0]
                taken.append((begun, piece[1]))  # merged with an adjacent piece
        kept.append(replace(used, fitted_s=tuple(taken)))
    fitted = tuple(run for used in kept for run in parts(used.log.run, used.fitted_s))
    if not fitted:
        raise JobError(f"{total_s / 60:.0f} minutes to fit, but no piece of {PIECE_S:g} s can be used: {NEEDED}")
    rule = f"{original.rule}; of {total_s / 60:.0f} minutes to fit, pieces of {PIECE_S:g} s, evenly spread"
    if usable_s < total_s - PIECE_S:
        rule += f", over the {usable_s / 60:.0f} that can be used: {NEEDED}"
    return replace(original, fitted=fitted, used=tuple(kept), rule=rule)


def _pieces(interval: Interval) -> list[Interval]:
    """`interval` cut into equal pieces of about `PIECE_S`."""
    low, high = interval
    edges = np.linspace(low, high, max(round((high - low) / PIECE_S), 1) + 1).tolist()
    return list(pairwise(edges))
