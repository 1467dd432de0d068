"""Laplace evidence of any prior on the parameters, from normal equations with the nodes eliminated.

One linearisation with all Jacobian columns gives the Hessian H (P, P) and b = -gradient (P,) of all parameters. With
prior precisions L_m (diagonal; means zero) of a model m the log evidence is

    log p(data | m) = const + 1/2 b^T (H + L_m)^-1 b - 1/2 log det(H + L_m) + 1/2 log det L_m        [nats]

which is exact as far as the data are linear in the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Prior:
    """Independent normal priors of P parameters: sigma (P,), mean (P,)."""

    sigma: np.ndarray
    mean: np.ndarray

    def cost(self, values: np.ndarray) -> float:
        """Negative log density of `values` (P,) up to a constant [nats]."""
        return 0.5 * float((((values - self.mean) / self.sigma) ** 2).sum())

    def slope(self, values: np.ndarray) -> np.ndarray:
        """Gradient of `cost`, (P,)."""
        return self.precision * (values - self.mean)

    @property
    def precision(self) -> np.ndarray:
        """1 / sigma^2, (P,)."""
        return 1 / self.sigma**2

    @staticmethod
    def zero_mean(sigma: np.ndarray) -> Prior:
        """Prior of mean zero."""
        return Prior(sigma, np.zeros_like(sigma))

    def part(self, at: slice) -> Prior:
        """Prior of the parameters `at`."""
        return Prior(self.sigma[at], self.mean[at])


@dataclass(frozen=True)
class ReducedNormalEquations:
    """Normal equations of the parameters: Hessian H (P, P) and b = -gradient (P,) of the data cost at theta0 (P,).

    `constant`: terms of the log evidence that do not depend on the parameters' prior [nats].
    """

    H: np.ndarray
    b: np.ndarray
    theta0: np.ndarray
    constant: float

    def evidence(self, prior: Prior) -> float:
        """Log evidence under `prior` [nats], by a Cholesky factor of H + L."""
        factor = np.linalg.cholesky(self.H + np.diag(prior.precision))
        half = np.linalg.solve(factor, self.b - prior.slope(self.theta0))
        value = self.constant - prior.cost(self.theta0) + 0.5 * float(half @ half)
        return value - float(np.log(np.diag(factor)).sum()) - float(np.log(prior.sigma).sum())

    def posterior(self, prior: Prior) -> Posterior:
        """Posterior mean and covariance under `prior`."""
        C = np.linalg.inv(self.H + np.diag(prior.precision))
        return Posterior(self.theta0 + C @ (self.b - prior.slope(self.theta0)), C, prior)


@dataclass(frozen=True)
class Posterior:
    """Posterior of all parameters: mean `values` (P,), `covariance` (P, P), and the prior it was computed with."""

    values: np.ndarray
    covariance: np.ndarray
    prior: Prior

    def under_prior(self, at: slice, prior: Prior) -> tuple[float, np.ndarray, np.ndarray]:
        """Gain of log evidence [nats] with another `prior` on k parameters `at`; their values (k,), covariance (k, k).

        With marginal mean m, covariance S and present prior (mu_0, Sigma_0), the data's information on them, all others
        free, is L = S^-1 - Sigma_0^-1. Under a prior (mu, Sigma)

            h = S^-1 m - Sigma_0^-1 mu_0 + Sigma^-1 mu,   C = (L + Sigma^-1)^-1,   values = C h
            2 log p = h^T C h + log det C - log det Sigma - mu^T Sigma^-1 mu + const

        and the gain is the difference of log p to that of the present prior.
        """
        present, S, m = self.prior.part(at), self.covariance[at, at], self.values[at]
        S_inv, zeros = np.linalg.inv(S), np.zeros_like(m)
        h = S_inv @ m - present.precision * present.mean + prior.precision * prior.mean
        C = np.linalg.inv(S_inv - np.diag(present.precision) + np.diag(prior.precision))
        gain = (
            h @ C @ h - m @ S_inv @ m + _log_det(C) - _log_det(S) + 2 * float(np.log(present.sigma / prior.sigma).sum())
        )
        return float(gain) / 2 + present.cost(zeros) - prior.cost(zeros), C @ h, C

    def nats_if_absent(self, at: slice) -> float:
        """Gain of log evidence with the parameters `at` held at zero [nats]."""
        S, m, present = self.covariance[at, at], self.values[at], self.prior.part(at)
        gain = -m @ np.linalg.solve(S, m) - _log_det(S) + 2 * float(np.log(present.sigma).sum())
        return float(gain) / 2 + present.cost(np.zeros_like(m))


def _log_det(S: np.ndarray) -> float:
    return float(np.linalg.slogdet(S)[1])
