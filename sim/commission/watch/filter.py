"""Belief about the watched parameters, and its update by the normal likelihood of one mission.

Belief N(m, P) of x (n,), mission's likelihood in terms of theta = A x:

    -log p(log | x) = 1/2 x^T L x - h^T x + constant,   L = A^T Lambda A,  h = A^T eta
    P' = (I + P L)^-1 P,   m' = m + P' (h - L m)
    log p(log) = -1/2 log det(I + P L) + h^T m - 1/2 m^T L m + 1/2 (h - L m)^T P' (h - L m) + constant      [nats]

The constant depends on the mission alone: differences between beliefs are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Likelihood:
    """A mission's likelihood of theta: precision Lambda (B, B), eta (B,)."""

    precision: np.ndarray
    eta: np.ndarray

    def weighed(self, scale: float, error: np.ndarray) -> Likelihood:
        """The same with covariance `scale` Lambda^-1 + diag(`error`), error (B,) variances; Lambda may be singular."""
        B = len(self.eta)
        mix = np.linalg.solve(scale * np.eye(B) + self.precision * error, np.column_stack([self.precision, self.eta]))
        precision = mix[:, :B]
        return Likelihood((precision + precision.T) / 2, mix[:, B])

    def through(self, A: np.ndarray) -> Likelihood:
        """The likelihood of x where theta = A x, A (B, n)."""
        return Likelihood(A.T @ self.precision @ A, A.T @ self.eta)

    def log_ratio(self, one: np.ndarray, other: np.ndarray) -> float:
        """log p(log | theta = one) - log p(log | theta = other) [nats]."""
        return self._value(one) - self._value(other)

    def _value(self, theta: np.ndarray) -> float:
        return float(self.eta @ theta - 0.5 * theta @ self.precision @ theta)


@dataclass(frozen=True)
class Belief:
    """Normal belief: mean (n,), covariance (n, n); log_p: log probability of the missions so far [nats]."""

    mean: np.ndarray
    covariance: np.ndarray
    log_p: float = 0.0

    def later(self, variance: np.ndarray) -> Belief:
        """The belief a mission later: `variance` (n,) added to each entry, by which old missions are forgotten."""
        return Belief(self.mean, self.covariance + np.diag(variance), self.log_p)

    def after(self, seen: Likelihood) -> Belief:
        """The belief after a mission."""
        opened = np.eye(len(self.mean)) + self.covariance @ seen.precision
        covariance = np.linalg.solve(opened, self.covariance)
        covariance = (covariance + covariance.T) / 2
        r = seen.eta - seen.precision @ self.mean
        gain = seen.eta @ self.mean - 0.5 * self.mean @ seen.precision @ self.mean + 0.5 * r @ covariance @ r
        log_p = self.log_p + float(gain) - 0.5 * float(np.linalg.slogdet(opened)[1])
        return Belief(self.mean + covariance @ r, covariance, log_p)

    def with_step(self, sigma: float) -> Belief:
        """The belief with one more entry, the size of a change: mean 0, `sigma`."""
        n = len(self.mean)
        covariance = np.zeros((n + 1, n + 1))
        covariance[:n, :n], covariance[n, n] = self.covariance, sigma**2
        return Belief(np.append(self.mean, 0.0), covariance, self.log_p)

    def through(self, A: np.ndarray) -> Belief:
        """The belief about A x."""
        return Belief(A @ self.mean, A @ self.covariance @ A.T, self.log_p)

    def surprise(self, seen: Likelihood) -> float:
        """Squared innovation of a mission over its expectation: 1 on average where all assumptions hold."""
        values, vectors = np.linalg.eigh(seen.precision)
        kept = values > 1e-9 * values[-1]
        root = vectors[:, kept] * np.sqrt(values[kept])
        e = (vectors[:, kept].T @ (seen.eta - seen.precision @ self.mean)) / np.sqrt(values[kept])
        S = np.eye(len(e)) + root.T @ self.covariance @ root
        return float(e @ np.linalg.solve(S, e)) / len(e)
