"""Windows cut from held-out runs: initial states, commands, and the reference motion to compare with.

The reference motion is the run's truth columns where it has them (simulated logs), else that of the smoother, which has
no vessel model. The initial state of a window is the reference at its start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.logs.runs.nearest import distance
from companion.logs.runs.run import Run
from sim.fitting.engine.smoothing import RATE_HZ, SmootherNoise, smooth
from sim.fitting.engine.thrust.forces import settings_at
from sim.fitting.engine.wind import is_measured, measured_wind
from sim.fitting.taylor.pipeline import held_commands
from sim.fitting.validate.protocol import STEP_S, Commands

BEFORE_S = 2.0
"""Length of the commands before a window, from which a model computes its initial thrust."""
MAX_GAP_S, SHORTEST_S = 2.5, 10.0
"""Longest gap in what the reference rests on, and shortest window; assumed."""
PER_SAMPLE = round(1 / (RATE_HZ * STEP_S))
"""Steps from one sample of the reference to the next."""
TRUTH = ("true_north_m", "true_east_m", "true_psi_rad", "true_u_m_s", "true_v_m_s", "true_r_rad_s")


@dataclass(frozen=True)
class Reference:
    """Reference motion: `x` (k, 6) [x y psi u v r] at `t_s` (k,), 10 Hz, NaN where unknown; psi unwrapped.

    `source`: where it comes from, as text; `samples_s`: stamps of the truth or of the positions that it rests on.
    """

    t_s: np.ndarray
    x: np.ndarray
    source: str
    samples_s: np.ndarray


def reference_motion(run: Run, noise: SmootherNoise) -> Reference:
    """Reference motion of a run: its truth if it has one, else smoothed with sensor `noise`.

    It is unknown further than `MAX_GAP_S` / 2 from every sample of the truth, or of the position.
    """
    if all(run.known(name) for name in TRUTH):
        t, values = run.samples(*TRUTH)
        grid = t[0] + np.arange(int((t[-1] - t[0]) * RATE_HZ + 1e-9) + 1) / RATE_HZ
        values[:, 2] = np.unwrap(values[:, 2])
        x = np.column_stack([np.interp(grid, t, c) for c in values.T])
        return Reference(grid, _near(x, grid, t), "the simulated truth", t)
    smoothed = smooth(run, noise)
    x = np.hstack([smoothed.eta, smoothed.nu])
    t_p = run.samples("north_m", "east_m")[0] - noise.latency_s
    return Reference(smoothed.t_s, _near(x, smoothed.t_s, t_p), "the smoothed measurements", t_p)


def _near(x: np.ndarray, t_s: np.ndarray, samples_s: np.ndarray) -> np.ndarray:
    """`x` (k, 6) at `t_s` (k,), NaN further than `MAX_GAP_S` / 2 from every one of `samples_s`."""
    return np.where(distance(samples_s, t_s)[:, None] > MAX_GAP_S / 2, np.nan, x)


@dataclass(frozen=True)
class HeldOutWindows:
    """m windows: `x0` (m, 6); `truth` (m, k + 1, 6), reference at 10 Hz, NaN beyond a window's end; `start_s` (m,)."""

    x0: np.ndarray
    truth: np.ndarray
    commands: Commands
    start_s: np.ndarray

    @property
    def horizon_s(self) -> float:
        """Length of the longest window [s]."""
        return (self.truth.shape[1] - 1) / RATE_HZ


def cut_held_out(
    run: Run,
    ref: Reference,
    nominal_v: float,
    *,
    horizon_s: float = 60.0,
    stride_s: float = 5.0,
    shortest_s: float = SHORTEST_S,
    inside: Sequence[tuple[float, float]] | None = None,
) -> HeldOutWindows:
    """Windows of up to `horizon_s` that start every `stride_s` within each interval of `inside` (None: the whole run).

    A window ends with its interval; it must last `shortest_s`, over which the reference is known. `nominal_v` [V]:
    voltage where the run has none. ValueError where no window fits.
    """
    # 1. First and last sample of each window.
    intervals = [(ref.t_s[0], ref.t_s[-1])] if inside is None else inside
    steps, shortest = round(horizon_s * RATE_HZ), round(shortest_s * RATE_HZ)
    starts, ends = [], []
    for low, high in intervals:
        first, last = np.searchsorted(ref.t_s, [low - 1e-9, high + 1e-9])
        for i in range(first, last - shortest, round(stride_s * RATE_HZ)):
            if np.isfinite(ref.x[i : i + shortest + 1]).all():
                starts.append(i)
                ends.append(min(last - 1, i + steps))
    if not starts:
        why = _why_none(ref, intervals, shortest_s)
        raise ValueError(f"{run.meta.source}: no window of {shortest_s:g} s fits into what is held out: {why}")
    # 2. Reference motion and commands.
    truth = np.full((len(starts), steps + 1, 6), np.nan)
    for w, (i, j) in enumerate(zip(starts, ends, strict=True)):
        truth[w, : j - i + 1] = ref.x[i : j + 1]
    start_s = ref.t_s[starts]
    return HeldOutWindows(truth[:, 0], truth, _commands(run, start_s, steps * PER_SAMPLE, nominal_v), start_s)


def _why_none(ref: Reference, intervals: Sequence[tuple[float, float]], shortest_s: float) -> str:
    """Why no window fits, in words."""
    if max(high - low for low, high in intervals) < shortest_s:
        return "none of its pieces lasts so long"
    inside = [ref.samples_s[(ref.samples_s >= low) & (ref.samples_s <= high)] for low, high in intervals]
    steps = np.concatenate([np.diff(t_s) for t_s in inside])
    if len(steps) and (usual_s := float(np.median(steps))) > MAX_GAP_S:
        return f"its positions are {usual_s:.3g} s apart, {MAX_GAP_S:g} s at most are needed"
    return f"its positions (or truth) are silent for more than {MAX_GAP_S:g} s in every {shortest_s:g} s of it"


def _commands(run: Run, start_s: np.ndarray, steps: int, nominal_v: float) -> Commands:
    """Pulse widths, volts, settings in force and measured wind at the middle of each step."""
    before = round(BEFORE_S / STEP_S)
    t = start_s[:, None] + (np.arange(-before, steps) + 0.5) * STEP_S
    pwm, volts = held_commands(run, t.ravel())
    pwm = pwm.reshape(*t.shape, -1)
    volts = np.where(np.isnan(volts), nominal_v, volts).reshape(t.shape)
    settings = settings_at(run, t[:, before:])
    wind_m_s = measured_wind(run, t[:, before:]) if is_measured(run) else None
    return Commands(pwm[:, before:], volts[:, before:], pwm[:, :before], settings, wind_m_s)


def concatenated(parts: Sequence[HeldOutWindows]) -> HeldOutWindows:
    """Windows of several runs of one boat as one set; all must have the same horizon."""
    return HeldOutWindows(
        np.concatenate([p.x0 for p in parts]),
        np.concatenate([p.truth for p in parts]),
        Commands(
            np.concatenate([p.commands.pwm_us for p in parts]),
            np.concatenate([p.commands.battery_v for p in parts]),
            np.concatenate([p.commands.before_us for p in parts]),
            _joined_settings([p.commands for p in parts]),
            _joined_wind([p.commands for p in parts]),
        ),
        np.concatenate([p.start_s for p in parts]),
    )


def _joined_wind(parts: Sequence[Commands]) -> np.ndarray | None:
    """Wind that any part has; NaN in the others."""
    if all(part.wind_m_s is None for part in parts):
        return None
    blank = [np.full((*part.battery_v.shape, 2), np.nan) for part in parts]
    return np.concatenate([b if p.wind_m_s is None else p.wind_m_s for p, b in zip(parts, blank, strict=True)])


def _joined_settings(parts: Sequence[Commands]) -> dict[str, np.ndarray]:
    """Settings that any part has; NaN (nominal) in the others."""
    names = sorted({name for part in parts for name in part.settings})
    blank = [np.full(part.battery_v.shape, np.nan) for part in parts]
    return {
        name: np.concatenate([part.settings.get(name, none) for part, none in zip(parts, blank, strict=True)])
        for name in names
    }
