"""Headings and positions that jump: single ones that are off, and resets, after which they stay elsewhere.

An EKF that starts anew, another yaw source, a fix of another kind: what comes after a reset has another heading or
another origin than what came before. A sensor's slip comes back; it is left to the fit, which weighs it down.
Thresholds are assumed.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.core.geometry.frames import wrapped
from companion.logs.runs.run import LogProblem, Run
from companion.logs.runs.unwrap import SILENT_S, integrated

JUMP_M_S, JUMP_M = 3.0, 1.0
"""No small boat moves as fast as this between two fixes."""
BACK, AROUND, AROUND_S, FEW_STEPS = 0.5, 5, 2.0, 4
"""A reset is a jump of which more than this share is left between the medians of so many fixes, and of so long, before
and after, beside what the boat moves meanwhile; and between the fix before and the second after, the second before and
the one after: a single one that is off comes back at once, however the boat turns in five seconds. A boat that moves so
fast that a few of its steps are as long is taken to go on as it went before, or goes after."""
TURNED_RAD, TURNED_RAD_S, SIGMAS = 0.2, 0.3, 10.0
"""Least jump of the heading beside the integrated yaw rate: so much, for each second between samples so much more (what
the integral of a slow gyro misses), and so many sigmas of what other steps differ, by the median."""
SETTLED_S = 1.0
"""Before and after a jump of the heading medians are taken over so long: what is held, late or a slip comes back."""
FACTORS = tuple(sign * unit for unit in (1.0, np.pi / 180.0) for sign in (1.0, -1.0))
"""What the yaw rate may have to be multiplied with: its unit and sign are asked for elsewhere."""
FEWEST = 10


def jumps(run: Run) -> Iterator[LogProblem]:
    """Moves between two fixes that no small boat makes."""
    t_s, places, at = _jumping(run)
    for i in at:
        step_m, step_s = float(np.linalg.norm(places[i + 1] - places[i])), float(t_s[i + 1] - t_s[i])
        text = f"the position jumps by {step_m:.1f} m in {step_s:.2f} s"
        yield LogProblem(kind="jump", text=text, t_s=float(t_s[i]), length_s=step_s)


def resets(run: Run) -> list[LogProblem]:
    """Jumps after which heading or position stays elsewhere, by time."""
    found = []
    for t_s, length_s, rad in _heading_resets(run):
        text = (
            f"psi_rad jumps by {np.degrees(rad):.0f} degrees at {t_s:.1f} s, the yaw rate does not: the heading is "
            "wrong before or after. A fit is cut there, but takes both: export the log and leave one out"
        )
        found.append(LogProblem(kind="heading jump", text=text, t_s=t_s, length_s=length_s))
    for t_s, length_s, metres in _position_resets(run):
        text = (
            f"north_m, east_m jump by {metres:.1f} m at {t_s:.1f} s and stay there, as of another origin: a fit is cut "
            "there, as at a pause"
        )
        found.append(LogProblem(kind="position jump", text=text, t_s=t_s, length_s=length_s))
    return sorted(found, key=lambda problem: problem.t_s or 0.0)


def reset_intervals(run: Run) -> list[tuple[float, float]]:
    """From the last sample before each reset to the first after it [s], by time."""
    return sorted((t, t + n) for found in (_heading_resets(run), _position_resets(run)) for t, n, _ in found)


def _jumping(run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps and places of all fixes, and the indices of those before a jump."""
    if not run.known("north_m"):
        return np.empty(0), np.empty((0, 2)), np.empty(0, dtype=int)
    t_s, places = run.samples("north_m", "east_m")
    step_m, step_s = np.linalg.norm(np.diff(places, axis=0), axis=1), np.diff(t_s)
    return t_s, places, np.flatnonzero((step_m > JUMP_M) & (step_m > JUMP_M_S * step_s))


def _position_resets(run: Run) -> list[tuple[float, float, float]]:
    """Stamp before, length [s] and size [m] of each."""
    t_s, places, at = _jumping(run)
    found = []
    n = max(AROUND, round(AROUND_S / float(np.median(np.diff(t_s))))) if len(at) else AROUND
    for i in at:
        first, last = i + 1 - n, i + 1 + n
        if first < 0 or last > len(t_s):
            continue
        steps = np.delete(np.diff(places[first:last], axis=0) / np.diff(t_s[first:last])[:, None], n - 1, axis=0)
        parts = ((t_s[k : k + n], places[k : k + n]) for k in (first, i + 1))
        (before_s, before), (after_s, after) = ((np.median(t), np.median(p, axis=0)) for t, p in parts)
        beyond = after - before - np.median(steps, axis=0) * (after_s - before_s)
        jump = places[i + 1] - places[i]
        size = float(np.linalg.norm(jump))
        speed_m_s = float(np.median(np.linalg.norm(steps, axis=1)))
        slow = size > FEW_STEPS * speed_m_s * (t_s[i + 1] - t_s[i])
        near_m = []
        for a, b, outer in ((i - 1, i + 1, i - 2), (i, i + 2, i + 2)):
            step = (places[outer + 1] - places[outer]) / (t_s[outer + 1] - t_s[outer])
            along_m_s = speed_m_s if slow else float(step @ jump / size)
            near_m.append((places[b] - places[a]) @ jump / size - along_m_s * (t_s[b] - t_s[a]))
        if min(beyond @ jump / size, *near_m) > BACK * size:
            found.append((float(t_s[i]), float(t_s[i + 1] - t_s[i]), size))
    return found


def _heading_resets(run: Run) -> list[tuple[float, float, float]]:
    """Stamp before, length [s] and size [rad] of each."""
    if not (run.known("psi_rad") and run.known("r_rad_s")):
        return []
    (t_s, psi), (t_r, r) = run.samples("psi_rad"), run.samples("r_rad_s")
    if min(len(t_s), len(t_r)) < FEWEST:
        return []
    # 1. What the heading turns beyond the yaw rate in each step, without the rate's bias.
    turned = np.diff(np.interp(t_s, t_r, integrated(r, t_r)))
    lasts_s = np.diff(t_s)
    silent_s = np.interp(t_s, t_r[1:], np.diff(t_r))
    steps_s = np.maximum(lasts_s, silent_s[1:])
    inside = (t_s[:-1] >= t_r[0]) & (t_s[1:] <= t_r[-1]) & (steps_s <= SILENT_S)
    if inside.sum() < FEWEST:
        return []
    beyond = min((wrapped(np.diff(psi) - k * turned) for k in FACTORS), key=lambda e: float(np.median(np.abs(e))))
    beyond = np.where(inside, beyond - float(np.median((beyond / lasts_s)[inside])) * lasts_s, 0.0)
    # 2. Steps far beyond all others, of which most is still there after a second.
    sigma = 1.48 * float(np.median(np.abs(beyond[inside])))
    apart = np.append(0.0, np.cumsum(beyond))
    found = []
    for i in np.flatnonzero(np.abs(beyond) > np.maximum(TURNED_RAD + TURNED_RAD_S * steps_s, SIGMAS * sigma)):
        before = apart[np.searchsorted(t_s, t_s[i] - SETTLED_S) : i + 1]
        after = apart[i + 1 : np.searchsorted(t_s, t_s[i + 1] + SETTLED_S, "right")]
        stays = float(np.median(after) - np.median(before))
        if stays / beyond[i] > BACK and abs(stays) > TURNED_RAD:
            found.append((float(t_s[i]), float(lasts_s[i]), float(beyond[i])))
    return found
