"""What naming the causes is worth on data that no fit has seen: open-loop errors of the readings, one-step likelihood.

Three models see the held-out logs: the base as given, the base refitted, the base with the causes. Each smooths them
with nothing free but the motion (its own nodes), which gives its one-step likelihood. From its own states every few
seconds it then runs open loop under the logged commands, without latent force, and what its sensors should say is
compared with what they said, h seconds later (over the second before):

    rms error by channel and horizon;   gain = 1 - rms(extended) / rms(refitted)

Readings, not states: nobody knows the true states, and a cause may sit in a sensor. Noise of the readings is in all
three alike. Intervals: bootstrap over stretches of `HORIZONS_S[-1]` seconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from companion.logs.runs.splits import part
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.converged_rollout import converged_rollout
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.posterior.readings import Readings
from sim.fitting.engine.noise import BIAS_AX, BIAS_AY, BIAS_R, LATENT, OFFSET, STATE, WANDER, Noise
from sim.fitting.engine.windows import PSI, RATE, SURGE, SWAY, Windows

HORIZONS_S = (5, 10, 20)
STRIDE_S = 5.0
WINDOWS_A_RUN = 2.2  # at least; a second at its beginning is not used
MOST_WINDOWS = 160  # of 20 s: enough for intervals, little enough for an hour's log
CHANNELS = {"position": "m", "heading": "deg", "yaw_rate": "deg/s", "surge_accel": "m/s^2", "sway_accel": "m/s^2"}
SLACKS = (100.0, 10.0, 1.0, 1.0, 1.0)
"""Steps of smoothing from the first guess on, and how much nodes may jump in each."""
BOOTSTRAPS = 1000
LATE_S = 0.5  # fixes of the first moments of a window show where the window before it ends; assumed
SHOWN = (0.5, 0.9)  # quantiles of the error of the windows that are drawn
MODELS = ("base", "refit", "extended")


@dataclass(frozen=True)
class ModelUnderTest:
    """One model: parameters of effects, and the noise that goes with them."""

    theta: ParameterValues
    noise: Noise


@dataclass(frozen=True)
class OpenLoopError:
    """Rms error of one channel at one horizon, of `MODELS`, each with its 95 % interval; gain against the refit."""

    horizon_s: int
    channel: str
    unit: str
    rms: dict[str, float]
    ci95: dict[str, tuple[float, float]]
    gain: float
    gain_ci95: tuple[float, float]
    windows: int


@dataclass(frozen=True)
class Replay:
    """One window as it was measured and as the models have it: fixes and what the tag should say then, (m, 2)."""

    log: str
    start_s: float
    fixes_m: np.ndarray
    tracks: dict[str, np.ndarray]


@dataclass(frozen=True)
class HeldOutScore:
    """`errors` by horizon and channel; `nats`: log likelihood of one step by model; typical windows to look at."""

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
    """Held-out `runs` under `models` (by `MODELS`). `training`: whose middle the effects refer to, and whose clock,

    which knows the logs of `runs` too. Raises StructuredFitError or RunError for a run that is too short.
    """
    near = _aligned(EffectPhysics(runs, vessel, 1.0, training.clock), training)
    of, cuts, window_s = _staggered(runs)
    far = _aligned(EffectPhysics(cuts, vessel, window_s, training.clock), training)
    fit, lines = PosteriorFit(near, effects, models["base"].noise), Readings(far)
    squares, nats, tracks = {}, {}, {}
    for name, model in models.items():
        smoothed, nats[name] = _smoothed(fit, model)
        squares[name], tracks[name] = _open_loop(lines, effects, model, _starts(near, far, of, smoothed))
    groups = _groups(far, of)
    samples = near.windows.samples() + len(near.windows.fixes.t_s)
    return HeldOutScore(_errors(squares, groups, seed), nats, samples, _replays(squares, tracks, far))


def _aligned(physics: EffectPhysics, training: EffectPhysics) -> EffectPhysics:
    """Middles as of the logs that were fitted."""
    physics.middle_s, physics.centre_m = training.middle_s, training.centre_m
    return physics


def _staggered(runs: Sequence[Run]) -> tuple[list[int], list[Run], float]:
    """Runs long enough for two windows of the longest horizon, each from its beginning and, as far as `MOST_WINDOWS`

    allows, from some seconds later on; whose each is; length of windows [s]. If none is long enough: all, cut shorter.
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


def _smoothed(fit: PosteriorFit, model: ModelUnderTest) -> tuple[LinearisationPoint, float]:
    """Nodes of greatest likelihood with the model's parameters as they are, and its log likelihood [nats]."""
    z, point, nats = fit.z0, None, -np.inf
    for slack in SLACKS:
        noise = fit.noise = replace(model.noise, slack=slack * model.noise.slack)
        point = fit.point(model.theta, z, (), point)
        dz, nats = fit.node_step(point, noise)
        z = point.z + dz
    assert point is not None
    return fit.point(model.theta, z, (), point), nats - _log_noise(fit, model.noise)


def _log_noise(fit: PosteriorFit, noise: Noise) -> float:
    """Sum of the logarithms of the white noise over all readings: models may differ in what noise they found."""
    known = np.isfinite(fit.physics.windows.y).sum(axis=(0, 1))
    return float(known @ np.log(noise.white)) + 2 * len(fit.physics.windows.fixes.t_s) * float(np.log(noise.fix_m))


def _starts(near: EffectPhysics, far: EffectPhysics, of: Sequence[int], smoothed: LinearisationPoint) -> np.ndarray:
    """Nodes (W, L) for the beginnings of long windows: states of the smoothed motion, biases of the nearest node."""
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
    """By channel rows of window, age [s] and error squared; what the tag should say, at each fix (m, 2)."""
    physics, windows = lines.physics, lines.windows
    with np.errstate(all="ignore"):
        state = converged_rollout(physics, effects, model.theta, z)
        error = lines.imu(effects, model.theta, state) - windows.y
        said = lines.tag(effects, model.theta, state)
    off = said - windows.fixes.place_m
    age = windows.t_s - windows.t_s[:, :1]
    error[..., PSI] += z[:, None, OFFSET] + z[:, None, WANDER] * np.exp(-age[:, :-1] / model.noise.wander_time_s)
    for channel, bias in ((RATE, BIAS_R), (SURGE, BIAS_AX), (SWAY, BIAS_AY)):
        error[..., channel] += z[:, None, bias]
    error[..., PSI] = (error[..., PSI] + np.pi) % (2 * np.pi) - np.pi
    error[..., [PSI, RATE]] = np.degrees(error[..., [PSI, RATE]])
    place, *others = CHANNELS
    of = _fix_windows(windows)
    rows = {place: np.column_stack([of, windows.fixes.t_s - windows.t_s[of, 0], (off**2).sum(axis=1)])}
    for channel, name in enumerate(others):
        w, k = np.nonzero(np.isfinite(windows.y[..., channel]))
        rows[name] = np.column_stack([w, age[w, k], error[w, k, channel] ** 2])
    return rows, said


def _fix_windows(windows: Windows) -> np.ndarray:
    """The window of each position sample, (m,)."""
    of = np.zeros(len(windows.fixes.t_s), dtype=int)
    for i, span in enumerate(windows.spans):
        mine = windows.fixes.run == i
        at = np.searchsorted(windows.t_s[span, 0], windows.fixes.t_s[mine], side="right") - 1
        of[mine] = span.start + np.maximum(at, 0)
    return of


def _groups(far: EffectPhysics, of: Sequence[int]) -> np.ndarray:
    """Of each window the stretch of its log in which it begins, (W,): windows of one stretch overlap."""
    windows = far.windows
    stretch = (windows.t_s[:, 0] // HORIZONS_S[-1]).astype(int)
    _, groups = np.unique(np.column_stack([np.array(of)[windows.run], stretch]), axis=0, return_inverse=True)
    return groups.ravel()


def _errors(
    squares: Mapping[str, Mapping[str, np.ndarray]], groups: np.ndarray, seed: int
) -> tuple[OpenLoopError, ...]:
    count = int(groups.max()) + 1
    draws = np.random.default_rng(seed).multinomial(count, np.full(count, 1 / count), BOOTSTRAPS)
    found = []
    for channel, unit in CHANNELS.items():
        for horizon in HORIZONS_S:
            sums, drawn = {}, {}
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
                drawn[name] = np.sqrt(draws @ total / np.maximum(draws @ n, 1))
            else:
                found.append(_error(horizon, channel, unit, sums, drawn, windows))
    return tuple(found)


def _error(
    horizon: int, channel: str, unit: str, rms: dict[str, float], drawn: dict[str, np.ndarray], windows: int
) -> OpenLoopError:
    def interval(values: np.ndarray) -> tuple[float, float]:
        low, high = np.quantile(values, (0.025, 0.975))
        return float(low), float(high)

    with np.errstate(all="ignore"):
        gain = 1 - rms["extended"] / rms["refit"]
        gains = np.nan_to_num(1 - drawn["extended"] / drawn["refit"])
    ci95 = {name: interval(values) for name, values in drawn.items()}
    return OpenLoopError(horizon, channel, unit, rms, ci95, gain, interval(gains), windows)


def _replays(
    squares: Mapping[str, Mapping[str, np.ndarray]], tracks: Mapping[str, np.ndarray], far: EffectPhysics
) -> tuple[Replay, ...]:
    """The windows whose position error under the refitted base is the median, and the 90 % quantile, or near it:

    they do not overlap, where there are such.
    """
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
