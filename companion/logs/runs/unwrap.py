"""Heading without jumps: the short way round between samples, over a dropout of the compass as the boat turned."""

from __future__ import annotations

import numpy as np

from companion.logs.runs.run import Run

SILENT_S = 1.5  # yaw, the fastest motion, has a time constant of about 2 s: a longer silence of the rate is not bridged


def unwrapped(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [s] and headings [rad]. Where the yaw rate is known, it tells how many turns lie between samples.

    The rate less its bias: the median of what it says beyond the heading.
    """
    t_s, psi = run.samples("psi_rad")
    psi = np.unwrap(psi)
    t_r, r = run.samples("r_rad_s")
    if len(t_r) < 2 or len(t_s) < 2:
        return t_s, psi
    steps = np.diff(t_r, prepend=t_r[0])
    silence_s = np.interp(t_s, t_r, np.cumsum(np.where(steps > SILENT_S, steps, 0.0)))
    turned = np.interp(t_s, t_r, integrated(r, t_r))
    told = (np.diff(silence_s) == 0) & (t_s[:-1] >= t_r[0] - SILENT_S) & (t_s[1:] <= t_r[-1] + SILENT_S)
    lasts_s, beyond = np.diff(t_s), np.diff(turned) - np.diff(psi)
    bias = float(np.median((beyond / lasts_s)[told])) if told.any() else 0.0
    turns = np.where(told, np.rint((beyond - bias * lasts_s) / (2 * np.pi)), 0.0)
    return t_s, psi + 2 * np.pi * np.append(0.0, np.cumsum(turns))


def integrated(values: np.ndarray, t_s: np.ndarray) -> np.ndarray:
    """Over time from nought by trapezes, along axis 0: values (k,) or (k, n) at t_s (k,). scipy's is slow to load."""
    steps = np.diff(t_s).reshape(-1, *(1,) * (values.ndim - 1))
    return np.append(np.zeros_like(values[:1]), np.cumsum(steps * (values[1:] + values[:-1]) / 2.0, axis=0), axis=0)
