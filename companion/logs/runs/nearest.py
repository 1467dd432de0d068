"""Samples of one sensor beside those of another: the nearest in time."""

from __future__ import annotations

import numpy as np


def nearest(stamps: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Places in `stamps` (k,), ascending, k >= 1, of the nearest to each of `at`, in its shape; the later of two."""
    after = np.searchsorted(stamps, at).clip(0, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(at - stamps[before] < stamps[after] - at, before, after)


def distance(stamps: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Time from each of `at` to the nearest of `stamps`, as above, in its shape."""
    return np.abs(stamps[nearest(stamps, at)] - at)
