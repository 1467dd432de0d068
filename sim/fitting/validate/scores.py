"""Scores of open-loop simulations against the measured motion.

    e(h)   = simulated - measured, h seconds after the start of a window, over all windows that last that long
    NRMSE  = rms(e) / (max - min of measured),   R2 = 1 - sum e^2 / sum (measured - mean)^2      up to `SCORE_S`
    1 s residuals: errors of windows of 1 s, one second apart; white if the model has used all information in the data
                   (Ljung-Box test)

A run has diverged at h if by then it has been outside `SPREAD` times the box of measured speeds, or is not finite. One
value that is not finite makes an rms infinite; medians stay meaningful.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.geometry.frames import wrapped
from sim.fitting.engine.smoothing import RATE_HZ
from sim.fitting.validate.protocol import CHANNELS, Simulator
from sim.fitting.validate.windows import PER_SAMPLE, HeldOutWindows

HORIZONS_S = (1, 2, 5, 10, 20, 30, 45, 60)
SCORE_S = 30
"""NRMSE and R2 are over this first part of each window."""
SPREAD = 3.0  # factor on the box of speeds, about its middle, beyond which a run has diverged; assumed
LAGS = 10  # of the Ljung-Box test
SPEEDS = ("u", "v", "r")


@dataclass(frozen=True)
class SpeedBox:
    """Range of [u v r]: `low`, `high` (3,) [m/s, m/s, rad/s]."""

    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, nu: np.ndarray) -> SpeedBox:
        """The range of the finite rows of `nu` (..., 3)."""
        flat = nu.reshape(-1, 3)
        flat = flat[np.isfinite(flat).all(axis=1)]
        return cls(flat.min(axis=0), flat.max(axis=0))

    def left(self, nu: np.ndarray) -> np.ndarray:
        """Mask (...) of [u v r] (..., 3) outside the box enlarged `SPREAD` times about its middle; NaN is outside."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        return np.asarray(~(np.abs(nu - middle) <= SPREAD * half).all(axis=-1))


@dataclass(frozen=True)
class Whiteness:
    """Test of one channel's 1 s residuals: lag-1 correlation, Ljung-Box p over `LAGS` lags, number of residuals."""

    lag1: float
    p: float
    n: int


@dataclass(frozen=True)
class Score:
    """Scores of one model on one set of windows. Arrays are over `horizons_s`, dictionaries by channel.

    count        windows that last that long; diverged: share of them that have diverged
    rms          of the error; median, p90: quantiles of its size
    nrmse, r2    of u, v, r
    white        whiteness of the 1 s residuals of u, v, r; empty if not tested
    """

    name: str
    horizons_s: tuple[int, ...]
    count: np.ndarray
    diverged: np.ndarray
    rms: dict[str, np.ndarray]
    median: dict[str, np.ndarray]
    p90: dict[str, np.ndarray]
    nrmse: dict[str, float]
    r2: dict[str, float]
    white: dict[str, Whiteness]


def simulated(model: Simulator, windows: HeldOutWindows) -> np.ndarray:
    """The model's states at the instants of `windows.truth`, same shape."""
    return model.simulate(windows.x0, windows.commands)[:, ::PER_SAMPLE]


def errors(states: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Errors by channel (m, k, 5) of states (m, k, 6): NaN where nothing was measured, inf where states are not finite.

    Position errors are distances; heading errors are in [-pi, pi).
    """
    e = states - truth
    out = np.concatenate([np.hypot(e[..., 0], e[..., 1])[..., None], e[..., 2:]], axis=-1)
    out[..., 1] = wrapped(out[..., 1])
    return np.where(np.isnan(truth[..., :1]), np.nan, np.where(np.isnan(out), np.inf, out))


def score(
    model: Simulator, windows: HeldOutWindows, box: SpeedBox, second_windows: HeldOutWindows | None = None
) -> tuple[Score, np.ndarray]:
    """Score of the model, and its states (m, k, 6). `second_windows`: windows of 1 s, 1 s apart, for whiteness."""
    states = simulated(model, windows)
    e = errors(states, windows.truth)
    reach = np.isfinite(windows.truth[..., 0])
    gone = np.maximum.accumulate(box.left(states[..., 3:]), axis=1)
    horizons = tuple(h for h in HORIZONS_S if h <= windows.horizon_s and reach[:, round(h * RATE_HZ)].any())
    at = [round(h * RATE_HZ) for h in horizons]
    parts = [np.abs(e[reach[:, i], i]) for i in at]
    with np.errstate(over="ignore"):
        rms = np.array([np.sqrt((part**2).mean(axis=0)) for part in parts])
    median = np.array([np.quantile(part, 0.5, axis=0, method="lower") for part in parts])
    p90 = np.array([np.quantile(part, 0.9, axis=0, method="higher") for part in parts])
    nrmse, r2 = _fit(e[:, : SCORE_S * round(RATE_HZ) + 1, 2:], windows.truth[:, : SCORE_S * round(RATE_HZ) + 1, 3:])
    return Score(
        name=model.name,
        horizons_s=horizons,
        count=np.array([reach[:, i].sum() for i in at]),
        diverged=np.array([gone[reach[:, i], i].mean() for i in at]),
        rms=dict(zip(CHANNELS, rms.T, strict=True)),
        median=dict(zip(CHANNELS, median.T, strict=True)),
        p90=dict(zip(CHANNELS, p90.T, strict=True)),
        nrmse=nrmse,
        r2=r2,
        white={} if second_windows is None else whiteness(model, second_windows),
    ), states


def _fit(e: np.ndarray, truth: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
    """NRMSE and R2 of u, v, r over everything measured; R2 is -inf where a simulation is not finite."""
    nrmse, r2 = {}, {}
    for i, name in enumerate(SPEEDS):
        y = truth[..., i]
        y, d = y[np.isfinite(y)], e[..., i][np.isfinite(y)]
        with np.errstate(over="ignore"):
            square = float((d**2).mean())
        nrmse[name] = float(np.sqrt(square) / np.ptp(y))
        r2[name] = 1.0 - square / float(y.var())
    return nrmse, r2


def whiteness(model: Simulator, windows: HeldOutWindows) -> dict[str, Whiteness]:
    """Ljung-Box test of the errors of u, v, r after one second; windows in order of time."""
    from statsmodels.stats.diagnostic import acorr_ljungbox  # noqa: PLC0415 - two seconds to import

    e = errors(simulated(model, windows), windows.truth)[:, round(RATE_HZ), 2:]
    e = e[np.isfinite(e).all(axis=1)]
    out = {}
    for i, name in enumerate(SPEEDS):
        d = e[:, i] - e[:, i].mean()
        p = float(acorr_ljungbox(d, lags=[LAGS])["lb_pvalue"].iloc[0])
        out[name] = Whiteness(float((d[1:] * d[:-1]).sum() / (d**2).sum()), p, len(d))
    return out


def best_baseline(scores: Sequence[Score], baselines: Sequence[str], channel: str, horizon_s: int) -> float:
    """Smallest rms error of a channel at a horizon among the models named `baselines`."""
    return min(s.rms[channel][s.horizons_s.index(horizon_s)] for s in scores if s.name in baselines)
