"""Gusts of the wind that the search found: V = V_w (1 + gustiness g), g a Gauss-Markov process of unit variance.

The force F(t) of the wind at its effective speed V_e along the motion is multiplied by V^2 / V_e^2, with

    V_e^2 = V_w^2 (1 + a),   variance of V^2 / V_e^2:  s^2 = (4 a + 2 a^2) / (1 + a)^2,   a = gustiness^2

The test is for a Gauss-Markov process of size s that acts by the pattern F(t), beside ambient noise in body axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.fitting.diagnose.stochastic_effects.ambient import SCALE as NUISANCE_SCALE
from sim.fitting.diagnose.stochastic_effects.ambient import fit_ambient, initial_noise, nats_over, with_noise_prior
from sim.fitting.diagnose.stochastic_effects.estimate import PosteriorPeak, fit_peak, normal_log_density
from sim.fitting.diagnose.stochastic_effects.process import NUISANCE, WHITE, log_likelihood
from sim.fitting.diagnose.stochastic_effects.residual_acceleration import ResidualAcceleration

STEP_S, BLOCK_S = 0.5, 100.0
SIZE, TIME = NUISANCE, NUISANCE + 1  # log s, log s of g
SIZE_PRIOR, TIME_PRIOR = (float(np.log(0.6)), 0.7), (float(np.log(8.0)), 0.8)  # assumed
OWN_SCALE = np.array([0.1, 0.2])
SMALLEST = 0.1  # gustiness; assumed
MEAN = 4  # steps over which the record is averaged
SKEW = 1.5  # factor on the standard error of s, for the skewness of squared wind; assumed
MOST_SIZE = 1.38  # s of a gustiness of 2, the upper limit


@dataclass(frozen=True)
class GustEstimate:
    """Posterior of [noise, log s, log gust time]; nats over a steady wind; `size`: s by moments of the record."""

    posterior: PosteriorPeak
    nats: float
    size: float

    @property
    def gust_time_s(self) -> float:
        """Time constant."""
        return float(np.exp(self.posterior.at[TIME]))


def gustiness_of(size: float) -> float:
    """Gustiness from the relative standard deviation s of the dynamic pressure: the inverse of s(a)."""
    s2 = min(size, MOST_SIZE) ** 2
    return float(np.sqrt(np.sqrt(2 / (2 - s2)) - 1))


def size_error(gust_time_s: float, span_s: float) -> float:
    """Relative standard error of s from a record of T: `SKEW` sqrt(T_g / 2 T)."""
    return SKEW * float(np.sqrt(gust_time_s / (2 * span_s)))


def fit_gusts(data: ResidualAcceleration, force: np.ndarray) -> GustEstimate:
    """Fit gusts of the wind whose steady force along the motion is `force` (T, 3, B) [N, N, N m]."""
    about = initial_noise(data)
    noise, height = fit_ambient(data, about)
    acts = data.pattern(force)

    def own(q: np.ndarray) -> np.ndarray:
        pattern = acts[:, :, None] * np.exp(q[:, SIZE])[:, None]
        nats = log_likelihood(data, q[:, :NUISANCE], pattern, np.exp(-q[:, TIME]), np.zeros(len(q)))
        return nats + normal_log_density(q[:, SIZE], *SIZE_PRIOR) + normal_log_density(q[:, TIME], *TIME_PRIOR)

    start = np.concatenate([noise, [SIZE_PRIOR[0], TIME_PRIOR[0]]])
    top = fit_peak(with_noise_prior(data, about, own), start, np.concatenate([NUISANCE_SCALE, OWN_SCALE]))
    return GustEstimate(top, nats_over(height, top), _shown(data, acts, np.exp(2 * top.at[WHITE])[:2]))


def _shown(data: ResidualAcceleration, acts: np.ndarray, white: np.ndarray) -> float:
    """Size s by moments: standard deviation of the residual along the pattern p, white variance subtracted.

    s^2 = sum((p . y - mean p . p)^2 - p^2 white) / sum((p . p)^2),   moving averages over `MEAN` steps
    """
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - slow, and few logs have a wind

    p, known = acts[:, :2], np.isfinite(data.y[:, :2])
    square = uniform_filter1d((p**2 * known).sum(axis=1), MEAN, axis=0)
    along = uniform_filter1d((p * np.nan_to_num(data.y[:, :2])).sum(axis=1), MEAN, axis=0)
    noise = uniform_filter1d((p**2 * known * white[:, None]).sum(axis=1), MEAN, axis=0) / MEAN
    mean = along.sum() / square.sum()
    total = ((along - mean * square) ** 2 - noise).sum() / (square**2).sum()
    return float(np.sqrt(max(total, 1e-6)))
