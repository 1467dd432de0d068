"""Ambient noise of the residual accelerations: initial estimate, prior, maximum; evidence of a process beside it."""

from __future__ import annotations

import numpy as np

from sim.fitting.diagnose.stochastic_effects.estimate import (
    BatchedLogPosterior,
    PosteriorPeak,
    maximise,
    normal_log_density,
)
from sim.fitting.diagnose.stochastic_effects.process import AMBIENT, NUISANCE, TIME, WHITE, log_likelihood
from sim.fitting.diagnose.stochastic_effects.residual_acceleration import ResidualAcceleration

AMBIENT_TIME_S = 4.0  # prior, within a factor of 2.7; assumed
SIZES_SIGMA = 1.5  # of the logarithm of all other parameters, about their rough values
SCALE = np.array([0.2] * 6 + [0.3])


def initial_noise(data: ResidualAcceleration) -> np.ndarray:
    """Initial nuisance parameters (7,): white noise from differences, ambient noise from the remaining variance."""
    quick = np.maximum(_spread(np.diff(data.y, axis=0)) / np.sqrt(2), 1e-6)
    slow = _spread(data.y)
    out = np.empty(NUISANCE)
    out[WHITE] = np.log(0.8 * quick)
    out[AMBIENT] = np.log(0.7 * np.sqrt(np.maximum(slow**2 - quick**2, (0.3 * quick) ** 2)))
    out[2] -= np.log(2.0)  # a rate over some 2 s, as an acceleration
    out[TIME] = np.log(AMBIENT_TIME_S)
    return out


def _spread(y: np.ndarray) -> np.ndarray:
    """Standard deviation of each channel of y (T, 3, B), (3,); of one that was never measured a small one, assumed."""
    channels = (values[np.isfinite(values)] for values in np.moveaxis(y, 1, 0))
    return np.array([values.std() if len(values) else 1e-3 for values in channels])


def noise_log_prior(nuisance: np.ndarray, about: np.ndarray) -> np.ndarray:
    """Log prior (h,) of nuisance parameters (h, 7) about the initial values `about` (7,)."""
    sizes = normal_log_density(nuisance[:, :TIME], about[:TIME], SIZES_SIGMA).sum(axis=1)
    return sizes + normal_log_density(nuisance[:, TIME], np.log(AMBIENT_TIME_S), 1.0)


def fit_ambient(data: ResidualAcceleration, about: np.ndarray, steps: int = 15) -> tuple[np.ndarray, float]:
    """Maximum of the nuisance parameters (7,) without any process, and its log posterior [nats]."""
    T, _, B = data.y.shape

    def f(q: np.ndarray) -> np.ndarray:
        one = np.ones(len(q))
        return log_likelihood(data, q, np.zeros((T, 3, len(q), B)), one, one) + noise_log_prior(q, about)

    return maximise(f, about, SCALE, steps)


def nats_over(calm_height: float, with_process: PosteriorPeak) -> float:
    """Log evidence of a process over ambient noise alone [nats].

    Laplace over the process's own parameters, which follow the nuisance ones: peak difference + 1/2 log det(2 pi C).
    """
    own = with_process.covariance[NUISANCE:, NUISANCE:]
    _, log_det = np.linalg.slogdet(2 * np.pi * own)
    return with_process.height - calm_height + 0.5 * float(log_det)


def with_noise_prior(data: ResidualAcceleration, about: np.ndarray, own: BatchedLogPosterior) -> BatchedLogPosterior:
    """Log posterior of [nuisance, own parameters] (h, 7 + k); `own`: the same without the nuisance's prior."""
    return lambda q: own(q) + noise_log_prior(q[:, :NUISANCE], about)
