"""First guess of the nodes from the measurements alone, without a model.

heading, yaw rate    interpolated; a missing yaw rate is the slope of the heading
position, velocity   local linear regression of the fixes: weighted least-squares lines through near ones,
                     p = fix - R(psi) l_tag,   [u v] = R(psi)^T v
"""

from __future__ import annotations

import numpy as np

from companion.core.geometry.frames import rotate
from sim.fitting.engine.kernels.windows import kernel
from sim.fitting.engine.noise import L
from sim.fitting.engine.parameters import Parameters
from sim.fitting.engine.windows import PSI, RATE, Windows

REACH = 3.0  # fixes to either side of an instant that count, in units of their median spacing, or of 0.8 s if longer


def initial_nodes(windows: Windows, parameters: Parameters) -> np.ndarray:
    """Nodes (W, L): states guessed, all else 0."""
    tag = parameters.vessel.sensors.position
    arm = np.array([tag.x_m, tag.y_m])
    z = np.zeros((windows.size[0], L))
    fixes = windows.fixes
    for i, (span, (t, starts)) in enumerate(zip(windows.spans, windows.grids, strict=True)):
        y_psi, y_r = _series(windows, span, PSI), _series(windows, span, RATE)
        at = t[starts]
        psi = np.interp(at, *y_psi)
        z[span, 2] = psi
        z[span, 5] = np.interp(at, *y_r) if len(y_r[0]) else np.interp(at, y_psi[0], np.gradient(y_psi[1], y_psi[0]))
        mine = fixes.run == i
        when = fixes.t_s[mine] - tag.latency_s
        heading = np.interp(when, *y_psi)
        place = fixes.place_m[mine] - _turned(heading, np.tile(arm, (len(when), 1)))
        reach = REACH * max(0.8, float(np.median(np.diff(when))))
        track = np.empty((len(at), 2, 2))
        local_line_fits(when, place, at, reach, track)
        z[span, :2] = track[:, 0]
        z[span, 3:5] = _turned(-psi, track[:, 1])
    return z


def _series(windows: Windows, span: slice, channel: int) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [s] and values of one measured channel of a run."""
    values, t = windows.y[span, :, channel], windows.t_s[span, :-1]
    known = np.isfinite(values)
    return t[known], values[known]


def _turned(psi: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """R(psi) vector for each row."""
    return np.stack(rotate(psi, vector[:, 0], vector[:, 1]), axis=1)


@kernel
def local_line_fits(t: np.ndarray, place: np.ndarray, at: np.ndarray, reach: float, track: np.ndarray) -> None:
    """Fill `track` (n, 2, 2), position [m] and velocity [m/s] at instants `at` (n,), from `place` (m, 2) at `t` (m,).

    At each instant the line p(t) = p + v (t - at) that minimises sum_j k_j |p(t_j) - place_j|^2, with weights
    k_j = 1 - |t_j - at| / far over all samples within `reach` [s], at least four. `t` must increase.
    """
    last = len(t) - 1
    for i in range(len(at)):
        # 1. The four nearest samples, then all within reach.
        first = after = np.searchsorted(t, at[i])
        for _ in range(4):
            if first > 0 and (after > last or at[i] - t[first - 1] <= t[after] - at[i]):
                first -= 1
            else:
                after += 1
        far = max(reach, 1.01 * max(abs(t[first] - at[i]), abs(t[after - 1] - at[i])))
        while first > 0 and at[i] - t[first - 1] < far:
            first -= 1
        while after <= last and t[after] - at[i] < far:
            after += 1
        # 2. Normal equations of the line: moments sum k s^power, right-hand sides sum k p and sum k s p.
        moments, sums = np.zeros(3), np.zeros((2, 2))
        for j in range(first, after):
            since = t[j] - at[i]
            weight = 1 - abs(since) / far
            for power in range(3):
                moments[power] += weight * since**power
            for axis in range(2):
                sums[0, axis] += weight * place[j, axis]
                sums[1, axis] += weight * since * place[j, axis]
        # 3. Their solution.
        determinant = moments[0] * moments[2] - moments[1] ** 2
        for axis in range(2):
            track[i, 0, axis] = (moments[2] * sums[0, axis] - moments[1] * sums[1, axis]) / determinant
            track[i, 1, axis] = (moments[0] * sums[1, axis] - moments[1] * sums[0, axis]) / determinant
