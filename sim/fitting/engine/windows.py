"""Logs cut into windows that can be integrated side by side: stamps, measurements, position fixes, commands.

The fit is a multiple-shooting problem. Window w of W begins at a node: the state there is an unknown of the fit, and
the model carries it over K steps to the end of the window.

    run      |----- window 0 -----|----- window 1 -----|---  ..
    node     z_0                  z_1                  z_2
    steps    t_0 t_1 t_2 ..  t_K  t_0 ..

The steps are the stamps of the inertial data (heading, yaw rate, specific force), with more put in between wherever two
stamps are further apart than `MAX_STEP_S`. All windows have K steps, so that they fit into one array; a window with
fewer stamps ends in steps of length 0. Positions are no steps: they are compared between them (`sensors`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import GRAVITY_M_S2
from companion.logs.runs.apply_sensor_errors import calibrated
from companion.logs.runs.decimate import Decimated
from companion.logs.runs.on_time import on_time
from companion.logs.runs.run import Run
from companion.logs.runs.unwrap import unwrapped
from sim.fitting.engine.thrust.battery import commands_of, pulses_of
from sim.fitting.engine.thrust.history import ThrustCommands
from sim.fitting.engine.wind import mean_wind

CHANNELS = ("psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2")
"""Columns of the measurements `Windows.y`; their indices follow."""
PSI, RATE, SURGE, SWAY = range(4)
MAX_STEP_S = 0.05  # yaw, the fastest motion, has a time constant of about 2 s, thrusters 0.1 s
LEVEL_S = 0.3  # roll and pitch are averaged over this time before they level specific force: less of their noise in it
SETTLE_S = 1.0  # left out after the first command: thrust from before the log has decayed by then
EDGE_S = 0.5  # fixes this close to an end of a run are left out, so that no latency moves them out of the run
LEAST_FIXES = 4


class StructuredFitError(ValueError):
    """A run cannot be fitted. The text names the run and the reason."""


@dataclass(frozen=True)
class Fixes:
    """Position samples of all runs: `t_s` (m,) stamps, `place_m` (m, 2) north and east of the tag, `run` (m,) index."""

    t_s: np.ndarray
    place_m: np.ndarray
    run: np.ndarray


@dataclass(frozen=True)
class Windows:
    """All runs, cut into W windows of K steps; window w begins at node w.

    By window:
    t_s       (W, K + 1) stamps of the steps [s], on the clock of the run
    h_s       (W, K) step lengths [s], 0 beyond the end of a short window
    y         (W, K, 4) measurements in the order of `CHANNELS`, NaN where nothing was measured
    run       (W,) index of the run
    first     (W,) whether the window opens a run (then its node has a prior instead of a predecessor)
    wind_m_s  (W, 2) mean of the measured wind, north and east of where it comes from, NaN where none was measured

    By run, one entry each:
    commands  steady thruster forces over time
    spans     slice of its windows
    grids     stamps of all its steps (k,), and the index of the first step of each window
    around_s  (w, K + 1, n) offsets [s] of the n samples that were averaged into the measurement at that instant

    `fixes`: the position samples of all runs.
    """

    t_s: np.ndarray
    h_s: np.ndarray
    y: np.ndarray
    run: np.ndarray
    first: np.ndarray
    wind_m_s: np.ndarray
    fixes: Fixes
    commands: tuple[ThrustCommands, ...]
    spans: tuple[slice, ...]
    grids: tuple[tuple[np.ndarray, np.ndarray], ...]
    around_s: tuple[np.ndarray, ...]

    @property
    def size(self) -> tuple[int, int]:
        """Number of windows W, and of steps K in each."""
        return self.h_s.shape[0], self.h_s.shape[1]

    def before(self, when_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Index of the window and of the step at or before `when_s` (m,), the times at which the fixes were taken."""
        w, k = np.empty(len(when_s), dtype=int), np.empty(len(when_s), dtype=int)
        for i, (span, (t, starts)) in enumerate(zip(self.spans, self.grids, strict=True)):
            mine = self.fixes.run == i
            step = np.clip(np.searchsorted(t, when_s[mine], side="right") - 1, 0, len(t) - 2)
            own = np.searchsorted(starts, step, side="right") - 1
            w[mine], k[mine] = own + span.start, step - starts[own]
        return w, k

    def tied(self) -> tuple[np.ndarray, np.ndarray]:
        """Windows (T,) that are followed by another of the same run, and their duration [s] (T,).

        Between such a window and the next the fit has a continuity condition, a tie.
        """
        at = np.flatnonzero(~np.append(self.first[1:], True))
        return at, self.t_s[at, -1] - self.t_s[at, 0]

    def samples(self) -> int:
        """Number of instants at which heading, yaw rate or specific force was measured."""
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
    """Windows of about `window_s` [s] from all runs. Raises StructuredFitError for a run without heading or position.

    tied        neighbouring windows of a run are tied by continuity; False: every window stands for itself
    offsets_s   each run is cut once for each offset, beginning that much later: overlapping windows
    max_step_s  longest step of integration
    means       by run: of which samples its measurements are means (`decimate`)
    """
    if not runs:
        raise StructuredFitError("no run to fit")

    # 1. Steps, measurements and window starts of each run at each offset.
    runs = [calibrated(on_time(run), vessel) for run in runs]
    laid = [(run, offset) for run in runs for offset in offsets_s]
    pieces = [_grid(run, window_s, offset, max_step_s) for run, offset in laid]
    runs = [run for run, _ in laid]

    # 2. All windows have as many steps as the longest; beyond its end a shorter one repeats its last stamp (h = 0).
    K = max(int(np.diff(np.append(starts, len(t) - 1)).max()) for t, _, starts in pieces)
    t_all, y_all, owner, first, spans, around, wind = [], [], [], [], [], [], []
    for i, (t, y, starts) in enumerate(pieces):
        ends = np.append(starts[1:], len(t) - 1)
        index = np.minimum(starts[:, None] + np.arange(K + 1), ends[:, None])
        values = y[index[:, :K]]
        values[np.arange(K) >= (ends - starts)[:, None]] = np.nan
        spans.append(slice(len(owner), len(owner) + len(starts)))
        t_all.append(t[index])
        around.append(_around(t, means[i // len(offsets_s)] if means else None)[index])
        y_all.append(values)
        wind.append(mean_wind(runs[i], t[index]))
        owner += [i] * len(starts)
        first += [True] + [not tied] * (len(starts) - 1)
    t_s = np.concatenate(t_all)
    return Windows(
        t_s=t_s,
        h_s=np.diff(t_s, axis=1),
        y=np.concatenate(y_all),
        run=np.array(owner),
        first=np.array(first),
        wind_m_s=np.concatenate(wind),
        fixes=_fixes(laid),
        commands=tuple(commands_of(pulses_of(run, vessel), vessel) for run in runs),
        spans=tuple(spans),
        grids=tuple((t, starts) for t, _, starts in pieces),
        around_s=tuple(around),
    )


def _grid(run: Run, window_s: float, offset_s: float, max_step_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps of the steps (n,) [s], measurements (n, 4) by `CHANNELS`, and index of the first step of each window."""
    # 1. The measured channels from the beginning on: heading without jumps, specific force without gravity.
    name, begin = run.meta.source, begin_s(run) + offset_s
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
    # 2. Their stamps, with more between where a step would be too long.
    extra = [np.linspace(a, b, int(np.ceil((b - a) / max_step_s)) + 1)[1:-1] for a, b in _gaps(stamps, max_step_s)]
    t = np.unique(np.concatenate([stamps, *extra]))
    y = np.full((len(t), len(CHANNELS)), np.nan)
    for i, (at, values) in enumerate(channels):
        y[np.searchsorted(t, at), i] = values
    # 3. Windows of equal duration; each begins at the first stamp after its time.
    count = max(2, round((t[-1] - t[0]) / window_s))
    starts = np.searchsorted(t, t[0] + np.arange(count) * (t[-1] - t[0]) / count)
    return t, y, np.unique(starts)


def _around(t_s: np.ndarray, means: Decimated | None) -> np.ndarray:
    """Offsets [s] (m, n) of the samples averaged at each of the instants `t_s` (m,); 0 where there is no mean."""
    if means is None or not len(means.t_s):
        return np.zeros((len(t_s), 1))
    at = np.minimum(np.searchsorted(means.t_s, t_s), len(means.t_s) - 1)
    return np.where((means.t_s[at] == t_s)[:, None], means.around_s[at], 0.0)


def _gaps(t: np.ndarray, most_s: float) -> list[tuple[float, float]]:
    """Neighbouring stamps that are more than `most_s` apart (0.1 % of rounding aside)."""
    wide = np.flatnonzero(np.diff(t) > most_s * 1.001)
    return [(float(t[i]), float(t[i + 1])) for i in wide]


def _levelled(run: Run, channels: list[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Specific force without the share of gravity that roll and pitch turn into its axes, where both were logged.

    A boat heels with its own acceleration, so that this is no constant bias.
    """
    gravity, axes = _gravity(run), {SURGE: 0, SWAY: 1}
    return [(t, a - gravity(t)[axes[i]]) if i in axes else (t, a) for i, (t, a) in enumerate(channels)]


def _gravity(run: Run) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Function of time [s]: gravity in a_x, a_y [m/s^2], g sin(theta), -g sin(phi); 0 where these were not logged."""
    if not is_levelled(run):
        return lambda t_s: (np.zeros_like(t_s), np.zeros_like(t_s))
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - slow to import, and few logs hold roll and pitch

    t_tilt, tilt = run.samples("phi_rad", "theta_rad")
    across = max(1, round(LEVEL_S / float(np.median(np.diff(t_tilt)))))
    tilt = uniform_filter1d(tilt, across, axis=0, mode="nearest")

    def gravity(t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phi, theta = (np.interp(t_s, t_tilt, each) for each in tilt.T)
        return GRAVITY_M_S2 * np.sin(theta), -GRAVITY_M_S2 * np.sin(phi)

    return gravity


def is_levelled(run: Run) -> bool:
    """Whether roll and pitch were logged, by which specific force is levelled."""
    return run.known("phi_rad") and run.known("theta_rad")


def reads_lean(run: Run) -> bool:
    """Whether specific force was logged without roll and pitch: a boat that leans reads gravity as acceleration."""
    return run.known(CHANNELS[SURGE]) and not is_levelled(run)


def _fixes(laid: Sequence[tuple[Run, float]]) -> Fixes:
    """Usable position samples of all runs; index of the run as in `laid`."""
    fixes = [usable_fixes(run, offset_s) for run, offset_s in laid]
    owners = [np.full(len(t), i) for i, (t, _) in enumerate(fixes)]
    return Fixes(np.concatenate([t for t, _ in fixes]), np.concatenate([p for _, p in fixes]), np.concatenate(owners))


def usable_fixes(run: Run, offset_s: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (m,) [s] and positions (m, 2) [m] that a fit can use: those away from the ends of the inertial data.

    Raises StructuredFitError for fewer than `LEAST_FIXES`.
    """
    first, (t, place) = begin_s(run) + offset_s, run.samples("north_m", "east_m")
    inside = inside_edges(t, first, run.samples("psi_rad")[0][-1])
    if inside.sum() < LEAST_FIXES:
        raise StructuredFitError(
            f"{run.meta.source}: {inside.sum()} positions while heading and commands are known; "
            f"the fit needs at least {LEAST_FIXES}"
        )
    return t[inside], place[inside]


def inside_edges(fixes_s: np.ndarray, begin_s: float, end_s: float) -> np.ndarray:
    """Mask (m,) of the stamps that are more than `EDGE_S` after `begin_s` and before `end_s`."""
    return (fixes_s > begin_s + EDGE_S) & (fixes_s < end_s - EDGE_S)


def begin_s(run: Run) -> float:
    """Start of what can be fitted [s]: heading is known, and commands have been for `SETTLE_S`.

    Raises StructuredFitError where heading, positions or commands are missing.
    """
    name = run.meta.source
    if not run.known("psi_rad") or not run.known("north_m"):
        raise StructuredFitError(f"{name}: the fit needs psi_rad and north_m, east_m; at least one is blank")
    commands = run.commands()[0]
    if not len(commands):
        raise StructuredFitError(f"{name}: the fit needs commands; at no time all of {_pulses(run)} are known")
    return float(max(commands[0] + SETTLE_S, run.samples("psi_rad")[0][0]))


def _pulses(run: Run) -> str:
    return ", ".join(f"pwm_{name}" for name in run.thrusters)
