"""Errors of open-loop simulations against what the boat did.

    e(h)   = simulated - measured, h seconds after the start of a window, over all windows that reach so far
    NRMSE  = rms(e) / (max - min of measured),   R2 = 1 - sum e^2 / sum (measured - mean)^2      up to `SCORE_S`
    1 s residuals of windows one second apart: white if the model has taken from the data what there is (Ljung-Box)

A run counts as diverged at h if it has by then been outside `SPREAD` times the box of measured speeds, or is not
finite; a value that is not finite makes an rms infinite: medians stay meaningful.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.fitting.engine.smoothing import RATE_HZ
from sim.fitting.validate.protocol import CHANNELS, Simulator
from sim.fitting.validate.windows import PER_SAMPLE, HeldOutWindows

HORIZONS_S = (1, 2, 5, 10, 20, 30, 45, 60)
SCORE_S = 30
"""NRMSE and R2 are over the first 30 s of each window."""
SPREAD = 3.0
LAGS = 10
SPEEDS = ("u", "v", "r")


@dataclass(frozen=True)
class SpeedBox:
    """Range of [u v r], `low`, `high` (3,) [m/s, m/s, rad/s]."""

    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, nu: np.ndarray) -> SpeedBox:
        """The range of the finite rows of `nu` (..., 3)."""
        flat = nu.reshape(-1, 3)
        flat = flat[np.isfinite(flat).all(axis=1)]
        return cls(flat.min(axis=0), flat.max(axis=0))

    def left(self, nu: np.ndarray) -> np.ndarray:
        """Has [u v r] (..., 3) left the box blown up `SPREAD` times about its middle? NaN has. Shape (...)."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        return np.asarray(~(np.abs(nu - middle) <= SPREAD * half).all(axis=-1))


@dataclass(frozen=True)
class Whiteness:
    """Of one channel's 1 s residuals: correlation of neighbours, Ljung-Box p over `LAGS` lags, their number."""

    lag1: float
    p: float
    n: int


@dataclass(frozen=True)
class Score:
    """One model on one set of windows. Arrays over `horizons_s`; dictionaries by channel.

    `count`: windows that reach so far; `diverged`: share of them; `median`, `p90`: of |e|.
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
    """Errors by channel, shape (m, k, 5): NaN where nothing was measured, inf where the simulation is gone."""
    e = states - truth
    out = np.concatenate([np.hypot(e[..., 0], e[..., 1])[..., None], e[..., 2:]], axis=-1)
    out[..., 1] = (out[..., 1] + np.pi) % (2 * np.pi) - np.pi
    return np.where(np.isnan(truth[..., :1]), np.nan, np.where(np.isnan(out), np.inf, out))


def score(
    model: Simulator, windows: HeldOutWindows, box: SpeedBox, second_windows: HeldOutWindows | None = None
) -> tuple[Score, np.ndarray]:
    """The model's score and its states. `second_windows`: windows of 1 s, 1 s apart, in order, for whiteness."""
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
    """NRMSE and R2 of u, v, r over everything measured; -inf as R2 where a run is gone."""
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
    """Ljung-Box test of the errors of u, v, r one second on, windows in order of time."""
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
    """Smallest rms among the models named `baselines`, at a horizon."""
    return min(s.rms[channel][s.horizons_s.index(horizon_s)] for s in scores if s.name in baselines)
