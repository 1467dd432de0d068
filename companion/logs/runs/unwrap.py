"""Heading without jumps of 2 pi: unwrapped between samples, and over compass dropouts by the integrated yaw rate."""

from __future__ import annotations

import numpy as np

from companion.logs.runs.run import Run

SILENT_S = 1.5  # longest gap of the yaw rate that is bridged: yaw, the fastest motion, has a time constant of about 2 s


def unwrapped(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) [s] and headings (n,) [rad] without jumps.

    Where the yaw rate is known, the number of turns between two samples is

        round((integral of r - delta psi - bias dt) / 2 pi),   bias = median of (integral of r - delta psi) / dt
    """
    # 1. Unwrapped the short way round.
    t_s, psi = run.samples("psi_rad")
    psi = np.unwrap(psi)
    t_r, r = run.samples("r_rad_s")
    if len(t_r) < 2 or len(t_s) < 2:
        return t_s, psi
    # 2. Intervals over which the yaw rate was logged without a gap, and its integral.
    steps = np.diff(t_r, prepend=t_r[0])
    silence_s = np.interp(t_s, t_r, np.cumsum(np.where(steps > SILENT_S, steps, 0.0)))
    turned = np.interp(t_s, t_r, integrated(r, t_r))
    covered = (np.diff(silence_s) == 0) & (t_s[:-1] >= t_r[0] - SILENT_S) & (t_s[1:] <= t_r[-1] + SILENT_S)
    lasts_s, beyond = np.diff(t_s), np.diff(turned) - np.diff(psi)
    # 3. Whole turns, with the bias of the rate removed.
    bias = float(np.median((beyond / lasts_s)[covered])) if covered.any() else 0.0
    turns = np.where(covered, np.rint((beyond - bias * lasts_s) / (2 * np.pi)), 0.0)
    return t_s, psi + 2 * np.pi * np.append(0.0, np.cumsum(turns))


def integrated(values: np.ndarray, t_s: np.ndarray) -> np.ndarray:
    """Cumulative trapezoidal integral from 0 along axis 0: values (k,) or (k, n) at t_s (k,). scipy is slow to load."""
    steps = np.diff(t_s).reshape(-1, *(1,) * (values.ndim - 1))
    return np.append(np.zeros_like(values[:1]), np.cumsum(steps * (values[1:] + values[:-1]) / 2.0, axis=0), axis=0)
