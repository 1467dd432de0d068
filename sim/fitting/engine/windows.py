"""Runs cut into windows that can be integrated side by side: stamps, measurements, position fixes, commands.

Time steps are the data's own stamps (heading, yaw rate, specific force), with more put in where they lie further than
`MAX_STEP_S` apart. All windows have the same number of steps; what a window does not need has h = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import GRAVITY_M_S2
from companion.logs.runs.apply_sensor_errors import calibrated
from companion.logs.runs.decimate import Decimated
from companion.logs.runs.run import Run
from companion.logs.runs.unwrap import unwrapped
from sim.fitting.engine.thrust.battery import commands_of, pulses_of
from sim.fitting.engine.thrust.history import ThrustCommands

CHANNELS = ("psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2")
PSI, RATE, SURGE, SWAY = range(4)
MAX_STEP_S = 0.05  # yaw, the fastest motion, has a time constant of about 2 s, thrusters 0.1 s
LEVEL_S = 0.3  # roll and pitch are averaged over so long before they level specific force: their noise would add to it
SETTLE_S = 1.0  # after the first command: what the thrusters did before is not in the log, and forgotten by then
EDGE_S = 0.5  # fixes so near an end of a run are left out, whatever the latency turns out to be
LEAST_FIXES = 4


class StructuredFitError(ValueError):
    """A run cannot be fitted: which, and why."""


@dataclass(frozen=True)
class Fixes:
    """Position samples: stamp [s], north and east [m], shape (m, 2), and the run they are of."""

    t_s: np.ndarray
    place_m: np.ndarray
    run: np.ndarray


@dataclass(frozen=True)
class Windows:
    """All runs, cut up. W windows of K steps; window w of run `run[w]` begins at node w.

    t_s (W, K + 1), h_s (W, K), y (W, K, 4) by CHANNELS with NaN where nothing was measured, first (W,): the window
    that opens a run. By run: `commands`, `spans` (slice of windows), `grids` (t_s of all steps, start index of each
    window), `around_s` (w, K + 1, n: what is measured at a node is a mean of samples so far from it).
    """

    t_s: np.ndarray
    h_s: np.ndarray
    y: np.ndarray
    run: np.ndarray
    first: np.ndarray
    fixes: Fixes
    commands: tuple[ThrustCommands, ...]
    spans: tuple[slice, ...]
    grids: tuple[tuple[np.ndarray, np.ndarray], ...]
    around_s: tuple[np.ndarray, ...]

    @property
    def size(self) -> tuple[int, int]:
        """Windows W and steps K."""
        return self.h_s.shape[0], self.h_s.shape[1]

    def before(self, when_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Window and step before the instants (m,) at which the fixes were taken."""
        w, k = np.empty(len(when_s), dtype=int), np.empty(len(when_s), dtype=int)
        for i, (span, (t, starts)) in enumerate(zip(self.spans, self.grids, strict=True)):
            mine = self.fixes.run == i
            step = np.clip(np.searchsorted(t, when_s[mine], side="right") - 1, 0, len(t) - 2)
            own = np.searchsorted(starts, step, side="right") - 1
            w[mine], k[mine] = own + span.start, step - starts[own]
        return w, k

    def tied(self) -> tuple[np.ndarray, np.ndarray]:
        """Windows that another of the same run follows (T,), and how long each lasts [s] (T,)."""
        at = np.flatnonzero(~np.append(self.first[1:], True))
        return at, self.t_s[at, -1] - self.t_s[at, 0]

    def within(self, span: slice, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Middles of the steps of some windows (w, K), and those of `count` parts of them, relative (w, K, count)."""
        h_s = self.h_s[span]
        parts = (np.arange(count) + 0.5) / count - 0.5
        return self.t_s[span, :-1] + h_s / 2, h_s[..., None] * parts

    def samples(self) -> int:
        """How many instants carry a measurement of heading, rate or force."""
        return int(np.isfinite(self.y).any(axis=2).sum())


def cut_windows(
    runs: Sequence[Run],
    vessel: VesselFile,
    window_s: float,
    *,
    tied: bool = True,
    offsets_s: Sequence[float] = (0.0,),
    max_step_s: float = MAX_STEP_S,
    means: Sequence[Decimated] = (),
) -> Windows:
    """Runs as windows of about `window_s`. Raises StructuredFitError for a run without heading or position.

    Not `tied`: every window opens a run of its own. `offsets_s`: each run is cut once for each, begun so much later.
    Steps are at most `max_step_s` long. `means`: what the samples of each run are means of.
    """
    if not runs:
        raise StructuredFitError("no run to fit")
    runs = [calibrated(run, vessel) for run in runs]
    laid = [(run, offset) for run in runs for offset in offsets_s]
    pieces = [_grid(run, window_s, offset, max_step_s) for run, offset in laid]
    runs = [run for run, _ in laid]
    K = max(int(np.diff(np.append(starts, len(t) - 1)).max()) for t, _, starts in pieces)
    t_all, y_all, owner, first, spans, around = [], [], [], [], [], []
    for i, (t, y, starts) in enumerate(pieces):
        ends = np.append(starts[1:], len(t) - 1)
        index = np.minimum(starts[:, None] + np.arange(K + 1), ends[:, None])
        values = y[index[:, :K]]
        values[np.arange(K) >= (ends - starts)[:, None]] = np.nan
        spans.append(slice(len(owner), len(owner) + len(starts)))
        t_all.append(t[index])
        around.append(_around(t, means[i // len(offsets_s)] if means else None)[index])
        y_all.append(values)
        owner += [i] * len(starts)
        first += [True] + [not tied] * (len(starts) - 1)
    t_s = np.concatenate(t_all)
    return Windows(
        t_s=t_s,
        h_s=np.diff(t_s, axis=1),
        y=np.concatenate(y_all),
        run=np.array(owner),
        first=np.array(first),
        fixes=_fixes(laid),
        commands=tuple(commands_of(pulses_of(run, vessel), vessel) for run in runs),
        spans=tuple(spans),
        grids=tuple((t, starts) for t, _, starts in pieces),
        around_s=tuple(around),
    )


def _grid(run: Run, window_s: float, offset_s: float, max_step_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, measurements (n, 4) and the starts of windows of one run."""
    name, begin = run.meta.source, _begin_s(run) + offset_s
    channels = [run.samples(c) if run.known(c) else (np.empty(0), np.empty(0)) for c in CHANNELS]
    channels[PSI] = unwrapped(run)
    channels = _levelled(run, channels)
    channels = [(t[t >= begin], v[t >= begin]) for t, v in channels]
    stamps = np.unique(np.concatenate([t for t, _ in channels]))
    lasts_s = float(stamps[-1] - stamps[0]) if len(stamps) else 0.0
    if lasts_s < 2 * window_s:
        raise StructuredFitError(
            f"{name}: {lasts_s:.1f} s with heading and commands is too short; two windows of {window_s:g} s are needed"
        )
    extra = [np.linspace(a, b, int(np.ceil((b - a) / max_step_s)) + 1)[1:-1] for a, b in _gaps(stamps, max_step_s)]
    t = np.unique(np.concatenate([stamps, *extra]))
    y = np.full((len(t), len(CHANNELS)), np.nan)
    for i, (at, values) in enumerate(channels):
        y[np.searchsorted(t, at), i] = values
    count = max(2, round((t[-1] - t[0]) / window_s))
    starts = np.searchsorted(t, t[0] + np.arange(count) * (t[-1] - t[0]) / count)
    return t, y, np.unique(starts)


def _around(t_s: np.ndarray, means: Decimated | None) -> np.ndarray:
    """How far the samples of the mean at each of the instants (m,) are from it, (m, n); nil where there is none."""
    if means is None or not len(means.t_s):
        return np.zeros((len(t_s), 1))
    at = np.minimum(np.searchsorted(means.t_s, t_s), len(means.t_s) - 1)
    return np.where((means.t_s[at] == t_s)[:, None], means.around_s[at], 0.0)


def _gaps(t: np.ndarray, most_s: float) -> list[tuple[float, float]]:
    wide = np.flatnonzero(np.diff(t) > most_s * 1.001)
    return [(float(t[i]), float(t[i + 1])) for i in wide]


def _levelled(run: Run, channels: list[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Specific force with gravity taken out by roll and pitch; a boat heels by a share of what accelerates it."""
    if not (run.known("phi_rad") and run.known("theta_rad")):
        return channels
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - slow, and few logs tell roll and pitch

    t_tilt, tilt = run.samples("phi_rad", "theta_rad")
    across = max(1, round(LEVEL_S / float(np.median(np.diff(t_tilt)))))
    tilt = uniform_filter1d(tilt, across, axis=0, mode="nearest")
    out = list(channels)
    for i, sign, column in ((SURGE, -1.0, 1), (SWAY, 1.0, 0)):
        t, a = channels[i]
        out[i] = (t, a + sign * GRAVITY_M_S2 * np.sin(np.interp(t, t_tilt, tilt[:, column])))
    return out


def _fixes(laid: Sequence[tuple[Run, float]]) -> Fixes:
    """Position samples of all runs, but for those at the very ends."""
    found = [usable_fixes(run, offset_s) for run, offset_s in laid]
    owners = [np.full(len(t), i) for i, (t, _) in enumerate(found)]
    return Fixes(np.concatenate([t for t, _ in found]), np.concatenate([p for _, p in found]), np.concatenate(owners))


def usable_fixes(run: Run, offset_s: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and places (m, 2) of the positions of a run that a fit can use. Raises StructuredFitError for too few."""
    first, (t, place) = _begin_s(run) + offset_s, run.samples("north_m", "east_m")
    inside = inside_edges(t, first, run.samples("psi_rad")[0][-1])
    if inside.sum() < LEAST_FIXES:
        raise StructuredFitError(
            f"{run.meta.source}: {inside.sum()} positions while heading and commands are known; "
            f"the fit needs at least {LEAST_FIXES}"
        )
    return t[inside], place[inside]


def inside_edges(fixes_s: np.ndarray, begin_s: float, end_s: float) -> np.ndarray:
    """Which positions lie between these by more than `EDGE_S`."""
    return (fixes_s > begin_s + EDGE_S) & (fixes_s < end_s - EDGE_S)


def _begin_s(run: Run) -> float:
    """When heading is known and commands have been for long enough."""
    name = run.meta.source
    if not run.known("psi_rad") or not run.known("north_m"):
        raise StructuredFitError(f"{name}: the fit needs psi_rad and north_m, east_m; at least one is blank")
    commands = run.commands()[0]
    if not len(commands):
        raise StructuredFitError(f"{name}: the fit needs commands; at no time all of {_pulses(run)} are known")
    return float(max(commands[0] + SETTLE_S, run.samples("psi_rad")[0][0]))


def _pulses(run: Run) -> str:
    return ", ".join(f"pwm_{name}" for name in run.thrusters)
