"""Whether two runs hold the same measurements: a log and a copy of a part of it, whatever its clock and its form.

    mark          hash of `LENGTH` successive positions, of which none repeats the one before: in mm, or, where the run
                  begins at a fix of its own, latitude and longitude in a receiver's digits (1e-7 deg, 11 mm), which are
                  the same in all logs
    fingerprint   the `MOST` least marks of a run

Marks below the largest of both fingerprints are a sample of either run, the same for the same positions (bottom-k
sketch: Cohen and Kaplan 2007). Order is in each mark. A boat at rest has none: they repeat, or are few in turn.
"""

from __future__ import annotations

import numpy as np

from companion.core.geometry.frames import geodetic_from_site
from companion.logs.runs.origin import stated_origin
from companion.logs.runs.run import Run

LENGTH, LEAST_DIFFERENT = 8, 5
"""Positions in a mark, and how many of them must differ; assumed. Two passes along one line, in steps of a decimetre,
agree in one position of two by chance, in eight on end in one of 256."""
SHARE = 0.1
"""Least share of the shorter run that is no chance; assumed."""
MOST = 1000
FACTOR = np.uint64(0x9E3779B97F4A7C15)
"""2^64 over the golden ratio (Knuth, TAOCP 3, 6.4): its multiples are spread evenly."""


def fingerprint(run: Run) -> np.ndarray:
    """Marks (k,) of a run, ascending, `MOST` at most; none without `LENGTH` positions on the way."""
    places, origin = run.samples("north_m", "east_m")[1], stated_origin(run)
    fine = 1e7 * np.column_stack(geodetic_from_site(origin, *places.T)) if origin else 1000.0 * places
    places = np.round(fine).astype(np.int64)
    moved = np.append(True, (np.diff(places, axis=0) != 0).any(axis=1))[: len(places)]
    keys = _mixed(_mixed(places[moved, 0].view(np.uint64)) + places[moved, 1].view(np.uint64))
    if len(keys) < LENGTH:
        return np.zeros(0, dtype=np.uint64)
    windows = np.lib.stride_tricks.sliding_window_view(keys, LENGTH)
    different = 1 + (np.diff(np.sort(windows, axis=1), axis=1) != 0).sum(axis=1)
    marks = np.zeros(len(windows), dtype=np.uint64)
    for column in windows.T:
        marks = _mixed(marks + column)
    return np.unique(marks[different >= LEAST_DIFFERENT])[:MOST]


def overlap(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether the runs of two fingerprints share `SHARE` of the shorter one."""
    ends = [marks[-1] for marks in (one, other) if len(marks) == MOST]
    if ends:
        one, other = one[one <= min(ends)], other[other <= min(ends)]
    least = min(len(one), len(other))
    return bool(least and len(np.intersect1d(one, other)) >= max(SHARE * least, 1))


def _mixed(values: np.ndarray) -> np.ndarray:
    """Values (k,) uint64, each bit of which depends on all of the old ones below it, and on some above."""
    values = values * FACTOR
    return values ^ (values >> np.uint64(32))
