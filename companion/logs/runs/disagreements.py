"""Heading and yaw rate of one log that contradict each other: another unit, another sign."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from companion.logs.runs.run import LogProblem, Run

WINDOW_S, TURN_RAD, SLOPE_OFF = 2.0, 0.05, 0.3
"""Windows, least rms of what is turned in them, and how far off a ratio may be; assumed."""


def disagreeing(run: Run) -> Iterator[LogProblem]:
    """Change of heading against the integral of the yaw rate, over windows: their ratio shows wrong units and signs."""
    if not (run.known("psi_rad") and run.known("r_rad_s")):
        return
    slope = turn_ratio(run)
    if slope is None or abs(slope - 1.0) <= SLOPE_OFF:
        return
    hints: dict[str, Callable[[float], bool]] = {
        "; is r_rad_s in deg/s?": lambda k: abs(k * 57.3 - 1.0) < SLOPE_OFF,
        "; is one of them positive to port?": lambda k: abs(k + 1.0) < SLOPE_OFF,
    }
    hint = next((text for text, fits in hints.items() if fits(slope)), "")
    text = f"psi_rad turns {slope:.3g} times as far as r_rad_s says{hint}"
    yield LogProblem(kind="disagree", text=text)


def turn_ratio(run: Run) -> float | None:
    """Least-squares ratio of heading change to integrated yaw rate; None where the boat hardly turns."""
    t_psi, psi = run.samples("psi_rad")
    t_r, r = run.samples("r_rad_s")
    if len(t_psi) < 10 or len(t_r) < 10:
        return None
    turned = np.concatenate(([0.0], np.cumsum((r[1:] + r[:-1]) / 2 * np.diff(t_r))))
    windows = np.arange(max(t_psi[0], t_r[0]), min(t_psi[-1], t_r[-1]), WINDOW_S)
    if len(windows) < 3:
        return None
    heading = np.diff(np.interp(windows, t_psi, np.unwrap(psi)))
    rate = np.diff(np.interp(windows, t_r, turned))
    sound = np.abs(heading) < np.pi * 0.9
    heading, rate = heading[sound], rate[sound]
    if len(rate) < 3 or np.sqrt(np.mean(heading**2)) < TURN_RAD or np.sqrt(np.mean(rate**2)) < TURN_RAD / 2:
        return None
    rate, heading = rate - rate.mean(), heading - heading.mean()  # a gyroscope's bias is no disagreement
    weight = float(rate @ rate)
    return float(heading @ rate / weight) if weight > 0 else None
