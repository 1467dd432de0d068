"""Held-out score of the causes: open-loop errors of predicted readings and one-step likelihood.

Three models are scored on held-out logs: the base as given, the base refitted, the base with the causes. Each smooths
them with nothing free but the nodes, which gives its one-step likelihood. From its own smoothed states every few
seconds it then runs open loop under the logged commands, without latent force; its predicted readings are compared with
the measured ones within the second before the horizon h:

    rms error by channel and horizon;   gain = 1 - rms(extended) / rms(refitted)

Readings are compared, not states, since true states are unknown and a cause may be in a sensor. The noise of the
readings is in all three alike. Intervals: bootstrap over blocks of `HORIZONS_S[-1]` seconds. Fewer than `LEAST_BLOCKS`
give too few draws; there Student's t over the blocks, by the jackknife on the logarithms of rms and of 1 - gain (Miller
1974); one block alone leaves them unbounded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import wrapped
from companion.logs.runs.run import Run
from companion.logs.runs.splits import part
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.converged_rollout import converged_rollout
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.posterior.readings import Readings
from sim.fitting.diagnose.selection.smoothed_logs import ModelUnderTest, smoothed
from sim.fitting.engine.noise import BIAS_AX, BIAS_AY, BIAS_R, LATENT, OFFSET, STATE, WANDER
from sim.fitting.engine.windows import PSI, RATE, SURGE, SWAY, Windows

HORIZONS_S = (5, 10, 20)
JUDGED_S = 10  # horizon by which causes are judged
STRIDE_S = 5.0
WINDOWS_A_RUN = 2.2  # least number of windows in a run; a second at its beginning is not used
MOST_WINDOWS = 160  # of 20 s: enough for intervals, few enough for an hour's log
CHANNELS = {"position": "m", "heading": "deg", "yaw_rate": "deg/s", "surge_accel": "m/s^2", "sway_accel": "m/s^2"}
BOOTSTRAPS, LEAST_BLOCKS = 1000, 6  # draws, and least number of blocks for a bootstrap; assumed
LATE_S = 0.5  # beginning of a window whose fixes belong to the window before, by latency; assumed
QUANTILES, SHOWN = (0.025, 0.975), (0.5, 0.9)  # of intervals; of the windows' position errors in the report
MODELS, COMPARED = ("base", "refit", "extended"), (("extended", "refit"), ("refit", "base"))


@dataclass(frozen=True)
class OpenLoopError:
    """Rms error of one channel at one horizon by model; gain of extended over refit, refit over base; 95 % intervals.

    From `windows` in `blocks` that count as independent; with one block the intervals are unbounded.
    """

    horizon_s: int
    channel: str
    unit: str
    rms: dict[str, float]
    ci95: dict[str, tuple[float, float]]
    gain: float
    gain_ci95: tuple[float, float]
    refit_gain_ci95: tuple[float, float]
    windows: int
    blocks: int


@dataclass(frozen=True)
class Replay:
    """One window for the report: measured fixes (m, 2) and by model the predicted ones (m, 2), NED [m]."""

    log: str
    start_s: float
    fixes_m: np.ndarray
    tracks: dict[str, np.ndarray]


@dataclass(frozen=True)
class HeldOutScore:
    """Errors by horizon and channel; one-step log likelihood by model [nats] of `samples` readings; windows to show."""

    errors: tuple[OpenLoopError, ...]
    nats: dict[str, float]
    samples: int
    replays: tuple[Replay, ...]


def score(
    runs: Sequence[Run],
    vessel: VesselFile,
    effects: Sequence[Effect],
    models: Mapping[str, ModelUnderTest],
    training: EffectPhysics,
    seed: int,
) -> HeldOutScore:
    """Score `models` (by name of `MODELS`) on held-out `runs`; `seed`: of the bootstrap.

    `training`: physics of the fitted logs, to whose centre and shared clock the effects' parameters refer.
    StructuredFitError or RunError where a run is too short.
    """
    near = _aligned(EffectPhysics(runs, vessel, 1.0, training.clock), training)
    of, cuts, window_s = _staggered(runs)
    far = _aligned(EffectPhysics(cuts, vessel, window_s, training.clock), training)
    fit, lines = PosteriorFit(near, effects, models["base"].noise), Readings(far)
    squares, nats, tracks = {}, {}, {}
    for name, model in models.items():
        point, nats[name] = smoothed(fit, model)
        squares[name], tracks[name] = _open_loop(lines, effects, model, _starts(near, far, of, point))
    groups = _groups(far, of)
    samples = near.windows.samples() + len(near.windows.fixes.t_s)
    return HeldOutScore(open_loop_errors(squares, groups, seed), nats, samples, _replays(squares, tracks, far))


def _aligned(physics: EffectPhysics, training: EffectPhysics) -> EffectPhysics:
    """`physics` with the centre and the middle of the clock of `training`."""
    physics.middle_s, physics.centre_m = training.middle_s, training.centre_m
    return physics


def _staggered(runs: Sequence[Run]) -> tuple[list[int], list[Run], float]:
    """Copies of the runs, staggered: index of each copy's run, copies, length of their windows [s].

    Each run of at least `WINDOWS_A_RUN` windows is taken from its beginning and, as far as `MOST_WINDOWS` allows, from
    later starts. Windows last the longest horizon, or less if no run is long enough.
    """
    longest = float(HORIZONS_S[-1])
    measured = [run.measured_s() for run in runs]
    lasts = np.array([t[-1] - t[0] for t in measured])
    window_s = min(longest, float(lasts.max()) / WINDOWS_A_RUN)
    starts = int(np.clip(MOST_WINDOWS // max(lasts.sum() / longest, 1), 1, longest / STRIDE_S))
    of, out = [], []
    for i, (run, t) in enumerate(zip(runs, measured, strict=True)):
        for k in range(starts):
            begin = float(t[0]) + k * window_s / starts
            if t[-1] - begin >= WINDOWS_A_RUN * window_s:
                of.append(i)
                out.append(part(run, begin, float(t[-1])) if k else run)
    return of, out, window_s


def _starts(near: EffectPhysics, far: EffectPhysics, of: Sequence[int], smoothed: LinearisationPoint) -> np.ndarray:
    """Nodes (W, L) at the beginnings of long windows: smoothed states, biases of the short window, latent zero.

    `of`: index of the run in `near` of each run in `far`.
    """
    long, short = far.windows, near.windows
    z = np.zeros((long.size[0], smoothed.z.shape[1]))
    for span, owner in zip(long.spans, of, strict=True):
        begin, mine = long.t_s[span, 0], short.spans[owner]
        t = short.t_s[mine].ravel()
        x = smoothed.state.x[mine].reshape(-1, 6)
        at = mine.start + np.clip(np.searchsorted(short.t_s[mine, 0], begin), 0, mine.stop - mine.start - 1)
        z[span] = smoothed.z[at]
        z[span, STATE] = np.column_stack([np.interp(begin, t, column) for column in x.T])
    z[:, LATENT] = 0.0
    return z


def _open_loop(
    lines: Readings, effects: Sequence[Effect], model: ModelUnderTest, z: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """By channel, rows of window, time since its beginning [s] and squared error; predicted fixes (m, 2) [m]."""
    physics, windows = lines.physics, lines.windows
    with np.errstate(all="ignore"):
        state = converged_rollout(physics, effects, model.theta, z)
        error = lines.imu(effects, model.theta, state) - windows.y
        said = lines.tag(effects, model.theta, state)
    age = windows.t_s - windows.t_s[:, :1]
    drift = z[:, None, OFFSET] + z[:, None, WANDER] * np.exp(-age[:, :-1] / model.noise.wander_time_s)
    error[..., PSI] = wrapped(error[..., PSI] + drift)
    for channel, bias in ((RATE, BIAS_R), (SURGE, BIAS_AX), (SWAY, BIAS_AY)):
        error[..., channel] += z[:, None, bias]
    error[..., [PSI, RATE]] = np.degrees(error[..., [PSI, RATE]])
    place, *others = CHANNELS
    of, off = _fix_windows(windows), said - windows.fixes.place_m
    rows = {place: np.column_stack([of, windows.fixes.t_s - windows.t_s[of, 0], (off**2).sum(axis=1)])}
    for channel, name in enumerate(others):
        w, k = np.nonzero(np.isfinite(windows.y[..., channel]))
        rows[name] = np.column_stack([w, age[w, k], error[w, k, channel] ** 2])
    return rows, said


def _fix_windows(windows: Windows) -> np.ndarray:
    """Index of the window of each position sample, (m,)."""
    of = np.zeros(len(windows.fixes.t_s), dtype=int)
    for i, span in enumerate(windows.spans):
        mine = windows.fixes.run == i
        at = np.searchsorted(windows.t_s[span, 0], windows.fixes.t_s[mine], side="right") - 1
        of[mine] = span.start + np.maximum(at, 0)
    return of


def _groups(far: EffectPhysics, of: Sequence[int]) -> np.ndarray:
    """Bootstrap block of each window, (W,): windows that begin in one block of a log overlap."""
    windows = far.windows
    stretch = (windows.t_s[:, 0] // HORIZONS_S[-1]).astype(int)
    _, groups = np.unique(np.column_stack([np.array(of)[windows.run], stretch]), axis=0, return_inverse=True)
    return groups.ravel()


def open_loop_errors(
    squares: Mapping[str, Mapping[str, np.ndarray]], groups: np.ndarray, seed: int
) -> tuple[OpenLoopError, ...]:
    """Rms errors by channel and horizon. `groups` (windows,): the block of each window.

    `squares`: model -> channel -> rows (k, 3) of window, time since its beginning [s], squared error. Draws of the
    bootstrap are multinomial counts of blocks.
    """
    count = int(groups.max()) + 1
    draws = np.random.default_rng(seed).multinomial(count, np.full(count, 1 / count), BOOTSTRAPS)
    found = []
    for channel, unit in CHANNELS.items():
        for horizon in HORIZONS_S:
            sums, blocks = {}, {}
            windows = 0
            for name, by_channel in squares.items():
                rows = by_channel[channel]
                rows = rows[(rows[:, 1] > horizon - 1) & (rows[:, 1] <= horizon)]
                windows = len(np.unique(rows[:, 0]))
                group = groups[rows[:, 0].astype(int)]
                n = np.bincount(group, minlength=count)
                total = np.bincount(group, weights=np.nan_to_num(rows[:, 2], nan=np.inf), minlength=count)
                if not n.sum():
                    break
                sums[name] = float(np.sqrt(total.sum() / n.sum()))
                blocks[name] = np.column_stack([total, n])
            else:
                found.append(_error(horizon, channel, unit, sums, blocks, draws, windows))
    return tuple(found)


def _error(
    horizon: int,
    channel: str,
    unit: str,
    rms: dict[str, float],
    blocks: Mapping[str, np.ndarray],
    draws: np.ndarray,
    windows: int,
) -> OpenLoopError:
    """`blocks` (count, 2): sum of squares and number of readings of each block, by model; `draws`: of the bootstrap."""
    known = blocks["refit"][:, 1] > 0
    count = int(known.sum())
    with np.errstate(all="ignore"):
        gain = 1 - rms["extended"] / rms["refit"]
        if count < LEAST_BLOCKS:
            logs = {name: _left_out(sums[known]) for name, sums in blocks.items()}
            ends = {name: np.exp(_student(values)) for name, values in logs.items()}
            gains = [1 - np.exp(_student(logs[a] - logs[b]))[::-1] for a, b in COMPARED]
        else:
            drawn = {name: np.sqrt(draws @ s[:, 0] / np.maximum(draws @ s[:, 1], 1)) for name, s in blocks.items()}
            ends = {name: np.quantile(values, QUANTILES) for name, values in drawn.items()}
            gains = [np.quantile(np.nan_to_num(1 - drawn[a] / drawn[b]), QUANTILES) for a, b in COMPARED]
    ci95 = {name: (float(e[0]), float(e[1])) for name, e in ends.items()}
    of_causes, of_refit = ((float(low), float(high)) for low, high in gains)
    return OpenLoopError(horizon, channel, unit, rms, ci95, gain, of_causes, of_refit, windows, count)


def _left_out(sums: np.ndarray) -> np.ndarray:
    """log rms of all blocks, then without each: (k + 1,); `sums` (k, 2): sum of squares and number of readings."""
    without = np.vstack([sums.sum(axis=0), sums.sum(axis=0) - sums])
    return np.log(without[:, 0] / without[:, 1]) / 2


def _student(values: np.ndarray) -> np.ndarray:
    """95 % interval by Student's t from the jackknife, (2,); `values` (k + 1,): of all k blocks, then without each."""
    k = len(values) - 1
    spread = np.sqrt((k - 1) * np.var(values[1:])) if np.isfinite(values).all() and k > 1 else np.inf
    return values[0] + np.array([-1.0, 1.0]) * stdtrit(max(k - 1, 1), QUANTILES[1]) * spread


def _replays(
    squares: Mapping[str, Mapping[str, np.ndarray]], tracks: Mapping[str, np.ndarray], far: EffectPhysics
) -> tuple[Replay, ...]:
    """Windows with position errors under the refitted base near the quantiles `SHOWN`, without overlap if possible."""
    rows = squares["refit"]["position"]
    W = far.windows.size[0]
    n = np.bincount(rows[:, 0].astype(int), minlength=W)
    mean = np.bincount(rows[:, 0].astype(int), weights=rows[:, 2], minlength=W) / np.maximum(n, 1)
    full = np.flatnonzero(n >= max(n.max() / 2, 1))
    order = full[np.argsort(mean[full])]
    of, source = _fix_windows(far.windows), [far.runs[i].meta.source for i in far.windows.run]
    begin, end = far.windows.t_s[:, 0], far.windows.t_s[:, -1]
    of = np.where(far.windows.fixes.t_s - begin[of] > LATE_S, of, -1)
    chosen: list[int] = []
    for share in SHOWN:
        near = order[np.argsort(np.abs(np.arange(len(order)) - int(share * (len(order) - 1))), kind="stable")]
        apart = [w for w in near if all(source[w] != source[c] or begin[w] >= end[c] or end[w] <= begin[c]
                                        for c in chosen)]  # fmt: skip
        chosen += [int(w) for w in apart[:1]]
    return tuple(
        Replay(
            source[w],
            float(begin[w]),
            far.windows.fixes.place_m[of == w],
            {name: said[of == w] for name, said in tracks.items()},
        )
        for w in chosen
    )
