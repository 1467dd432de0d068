"""Maximum, covariance and Laplace evidence of a log posterior that is evaluated in batches of hypotheses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

BatchedLogPosterior = Callable[[np.ndarray], np.ndarray]
"""Log posteriors [nats] of parameters (h, k): (h,)."""
REACH = 1e-3  # step of first differences in units of each parameter's scale
FTOL = 3e-6  # relative tolerance: some tenths of a nat
REACH_2 = 0.05  # step of second differences, same units
LOG_2PI = float(np.log(2 * np.pi))


def normal_log_density(x: Any, mean: Any, sigma: Any) -> np.ndarray:
    """Log density of a normal distribution."""
    return -0.5 * ((x - mean) / sigma) ** 2 - np.log(sigma) - LOG_2PI / 2


@dataclass(frozen=True)
class PosteriorPeak:
    """Maximum of a log posterior: `at` (k,), height [nats], covariance (k, k), Laplace log evidence [nats]."""

    at: np.ndarray
    height: float
    covariance: np.ndarray
    evidence: float


def maximise(f: BatchedLogPosterior, start: np.ndarray, scale: np.ndarray, steps: int = 40) -> tuple[np.ndarray, float]:
    """Local maximum by L-BFGS-B in units of `scale` (k,), and its height; a gradient is one batch of 2 k + 1."""
    k = len(start)
    probes = np.concatenate([np.zeros((1, k)), REACH * np.eye(k), -REACH * np.eye(k)])

    def negative(unit: np.ndarray) -> tuple[float, np.ndarray]:
        values = f(start + scale * (unit + probes))
        gradient = (values[1 : k + 1] - values[k + 1 :]) / (2 * REACH)
        return -float(values[0]), -gradient

    found = minimize(negative, np.zeros(k), jac=True, method="L-BFGS-B", options={"maxiter": steps, "ftol": FTOL})
    return start + scale * found.x, -float(found.fun)


def fit_peak(f: BatchedLogPosterior, start: np.ndarray, scale: np.ndarray, steps: int = 40) -> PosteriorPeak:
    """Maximum from `start` (k,) with covariance from second differences and log evidence

    height + k / 2 log 2 pi - 1/2 log det H,   H = -d2 log p in units of `scale`.
    """
    at, height = maximise(f, start, scale, steps)
    H = -curvature(f, at, scale)
    values, vectors = np.linalg.eigh(H)
    values = np.maximum(values, 0.1)  # directions without information: sigma of at most about 3 scales
    inverse = vectors / values @ vectors.T
    k = len(at)
    evidence = height + k / 2 * LOG_2PI - 0.5 * float(np.log(values).sum()) + float(np.log(scale).sum())
    return PosteriorPeak(at, height, inverse * np.outer(scale, scale), evidence)


def curvature(f: BatchedLogPosterior, at: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Second derivatives (k, k) in units of `scale`, in one batch."""
    k = len(at)
    i, j = np.triu_indices(k)
    e = REACH_2 * np.eye(k)
    probes = np.concatenate([e[i] + e[j], e[i] - e[j], -e[i] + e[j], -e[i] - e[j]])
    v = f(at + scale * probes).reshape(4, -1)
    out = np.empty((k, k))
    out[i, j] = out[j, i] = (v[0] - v[1] - v[2] + v[3]) / (4 * REACH_2**2)
    return out
