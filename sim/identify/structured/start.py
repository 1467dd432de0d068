"""First guess of the nodes from the measurements alone: position and velocity from fixes, heading, yaw rate."""

from __future__ import annotations

import numpy as np

from sim.identify.structured.data import PSI, RATE, Windows
from sim.identify.structured.noise import L
from sim.identify.structured.parameters import Parameters

REACH = 3.0  # fixes to either side, in units of their median spacing or 0.8 s, whichever is longer


def first_nodes(windows: Windows, parameters: Parameters) -> np.ndarray:
    """Nodes (W, L): states guessed, biases and latent force nil."""
    uwb = parameters.vessel.sensors.uwb
    arm = np.array([uwb.x_m, uwb.y_m])
    z = np.zeros((windows.size[0], L))
    fixes = windows.fixes
    for i, (span, (t, starts)) in enumerate(zip(windows.spans, windows.grids, strict=True)):
        y_psi, y_r = _series(windows, span, PSI), _series(windows, span, RATE)
        at = t[starts]
        psi = np.interp(at, *y_psi)
        z[span, 2] = psi
        z[span, 5] = np.interp(at, *y_r) if len(y_r[0]) else np.interp(at, y_psi[0], np.gradient(y_psi[1], y_psi[0]))
        mine = fixes.run == i
        when = fixes.t_s[mine] - uwb.latency_s
        heading = np.interp(when, *y_psi)
        place = fixes.place_m[mine] - _turned(heading, np.tile(arm, (len(when), 1)))
        reach = REACH * max(0.8, float(np.median(np.diff(when))))
        track = np.array([_local_line(when, place, t0, reach) for t0 in at])
        z[span, :2] = track[:, 0]
        z[span, 3:5] = _turned(-psi, track[:, 1])
    return z


def _series(windows: Windows, span: slice, channel: int) -> tuple[np.ndarray, np.ndarray]:
    values, t = windows.y[span, :, channel], windows.t_s[span, :-1]
    known = np.isfinite(values)
    return t[known], values[known]


def _turned(psi: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """R(psi) vector for each row."""
    c, s = np.cos(psi), np.sin(psi)
    return np.stack([c * vector[:, 0] - s * vector[:, 1], s * vector[:, 0] + c * vector[:, 1]], axis=1)


def _local_line(t: np.ndarray, place: np.ndarray, t0: float, reach: float) -> np.ndarray:
    """Place and velocity at t0, shape (2, 2), by weighted least squares over the fixes within reach (4 or more)."""
    reach = max(reach, float(np.sort(np.abs(t - t0))[3]) * 1.01)
    near = np.abs(t - t0) < reach
    weight = np.sqrt(1 - np.abs(t[near] - t0) / reach)[:, None]
    basis = np.stack([np.ones(int(near.sum())), t[near] - t0], axis=1)
    return np.linalg.lstsq(basis * weight, place[near] * weight, rcond=None)[0]
