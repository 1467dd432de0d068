"""Lagged forces of thrusters at many instants, compiled by numba when they first run and kept between runs.

The equations of `companion.core.model.thrust_lag`, written once more for speed; tests compare the two.
After each change of command j the force is F_j + gap_j exp(-t / lag), t since then. Shapes: changes (c,), F, gap, s
(c, n), instants t (m,) roughly in order of time, results (m, n): means over what lies `around` (m, o) each instant.
"""

from __future__ import annotations

import math

import numpy as np

from sim.fitting.engine.kernels.windows import kernel


@kernel
def _latest(changes: np.ndarray, t: float, j: int) -> int:
    """Which change was the last at t (the first, before it); `j`: a guess."""
    while j + 1 < len(changes) and changes[j + 1] <= t:
        j += 1
    while j > 0 and changes[j] > t:
        j -= 1
    return j


@kernel
def lagged(
    changes: np.ndarray, F: np.ndarray, gap: np.ndarray, lag: float, t: np.ndarray, around: np.ndarray, f: np.ndarray
) -> None:
    """Forces f."""
    count, j = around.shape[1], 0
    for i in range(len(t)):
        f[i] = 0.0
        for part in range(count):
            at = t[i] + around[i, part]
            j = _latest(changes, at, j)
            keep = math.exp(-max(at - changes[j], 0.0) / lag)
            for n in range(f.shape[1]):
                f[i, n] += (F[j, n] + gap[j, n] * keep) / count


@kernel
def impulses(
    changes: np.ndarray,
    F: np.ndarray,
    gap: np.ndarray,
    before: np.ndarray,
    lag: float,
    t: np.ndarray,
    around: np.ndarray,
    impulse: np.ndarray,
) -> None:
    """Integrals of the forces from the first change on [N s]; `before` (c, n): up to each change."""
    count, j = around.shape[1], 0
    for i in range(len(t)):
        impulse[i] = 0.0
        for part in range(count):
            at = t[i] + around[i, part]
            j = _latest(changes, at, j)
            since = at - changes[j]
            faded = lag * (1.0 - math.exp(-max(since, 0.0) / lag))
            for n in range(F.shape[1]):
                impulse[i, n] += (before[j, n] + F[j, n] * since + gap[j, n] * faded) / count


@kernel
def lagged_slopes(
    changes: np.ndarray,
    gap: np.ndarray,
    s: np.ndarray,
    lag: float,
    t: np.ndarray,
    around: np.ndarray,
    by_dead: np.ndarray,
    by_lag: np.ndarray,
) -> None:
    """What a second of dead time and of lag adds to the force; s: of lag, at each change."""
    count, j = around.shape[1], 0
    for i in range(len(t)):
        by_dead[i], by_lag[i] = 0.0, 0.0
        for part in range(count):
            at = t[i] + around[i, part]
            j = _latest(changes, at, j)
            since = max(at - changes[j], 0.0)
            keep = math.exp(-since / lag)
            for n in range(by_dead.shape[1]):
                left = gap[j, n] * keep
                by_dead[i, n] += left / lag / count
                by_lag[i, n] += (s[j, n] * keep + left * since / lag**2) / count


@kernel
def slewed(dt: np.ndarray, F: np.ndarray, lag: float, slew: float, f: np.ndarray) -> None:
    """Forces f (c, n) at each change, before it acts, where f_dot = clip((F - f) / lag, -slew, slew); dt (c - 1,)."""
    tail = lag * slew
    f[0] = F[0]
    for j in range(len(dt)):
        for n in range(F.shape[1]):
            gap = F[j, n] - f[j, n]
            steady = max(abs(gap) - tail, 0.0) / slew
            if dt[j] < steady:
                f[j + 1, n] = f[j, n] + math.copysign(slew * dt[j], gap)
            else:
                f[j + 1, n] = F[j, n] - max(-tail, min(gap, tail)) * math.exp(-(dt[j] - steady) / lag)
