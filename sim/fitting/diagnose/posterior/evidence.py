"""What logs say of all parameters once the nodes are eliminated, and what any prior makes of it.

One linearisation with all columns gives H and b of all parameters; then the log evidence of any set m of effects is a
matter of a small matrix,

    log p(data | m) = const + 1/2 b^T (H + L_m)^-1 b - 1/2 log det(H + L_m) + 1/2 log det L_m

(L_m: prior precisions; means nil), which is exact as far as the logs are linear in the parameters (Laplace).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Prior:
    """Normal priors of parameters, each for itself: sigma (P,), mean (P,)."""

    sigma: np.ndarray
    mean: np.ndarray

    def cost(self, values: np.ndarray) -> float:
        """Of values (P,) [nats], but for what does not depend on them."""
        return 0.5 * float((((values - self.mean) / self.sigma) ** 2).sum())

    def slope(self, values: np.ndarray) -> np.ndarray:
        """Of the cost, (P,)."""
        return self.precision * (values - self.mean)

    @property
    def precision(self) -> np.ndarray:
        """1 / sigma^2, (P,)."""
        return 1 / self.sigma**2

    @staticmethod
    def zero_mean(sigma: np.ndarray) -> Prior:
        """Of mean nil."""
        return Prior(sigma, np.zeros_like(sigma))

    def part(self, at: slice) -> Prior:
        """Of some parameters."""
        return Prior(self.sigma[at], self.mean[at])


@dataclass(frozen=True)
class ReducedNormalEquations:
    """All parameters with the nodes eliminated: Hessian H (P, P) and b = -gradient (P,) of the data at theta0 (P,).

    `constant`: what the log evidence has beside [nats].
    """

    H: np.ndarray
    b: np.ndarray
    theta0: np.ndarray
    constant: float

    def evidence(self, prior: Prior) -> float:
        """Log evidence [nats]."""
        factor = np.linalg.cholesky(self.H + np.diag(prior.precision))
        half = np.linalg.solve(factor, self.b - prior.slope(self.theta0))
        value = self.constant - prior.cost(self.theta0) + 0.5 * float(half @ half)
        return value - float(np.log(np.diag(factor)).sum()) - float(np.log(prior.sigma).sum())

    def posterior(self, prior: Prior) -> Posterior:
        """Values and covariance."""
        C = np.linalg.inv(self.H + np.diag(prior.precision))
        return Posterior(self.theta0 + C @ (self.b - prior.slope(self.theta0)), C, prior)


@dataclass(frozen=True)
class Posterior:
    """All parameters: values (P,), covariance (P, P), and the prior that went into them."""

    values: np.ndarray
    covariance: np.ndarray
    prior: Prior

    def under_prior(self, at: slice, prior: Prior) -> tuple[float, np.ndarray, np.ndarray]:
        """Nats that the evidence gains with another prior on some parameters; their values and covariance then.

        With S, m of these parameters now, sigma, mu of a prior, L = S^-1 - Sigma_was^-1 is what the data say of them
        (all others free), h = S^-1 m - Sigma_was^-1 mu_was + Sigma^-1 mu, then C = (L + Sigma^-1)^-1, values C h, and
        the evidence is half of h^T C h + log det C - log det Sigma - mu^T Sigma^-1 mu, less the same as it was.
        """
        was, S, m = self.prior.part(at), self.covariance[at, at], self.values[at]
        known, nil = np.linalg.inv(S), np.zeros_like(m)
        h = known @ m - was.precision * was.mean + prior.precision * prior.mean
        C = np.linalg.inv(known - np.diag(was.precision) + np.diag(prior.precision))
        gain = h @ C @ h - m @ known @ m + _log_det(C) - _log_det(S) + 2 * float(np.log(was.sigma / prior.sigma).sum())
        return float(gain) / 2 + was.cost(nil) - prior.cost(nil), C @ h, C

    def nats_if_absent(self, at: slice) -> float:
        """Nats that the evidence gains with these parameters held at nil."""
        S, m, was = self.covariance[at, at], self.values[at], self.prior.part(at)
        gain = -m @ np.linalg.solve(S, m) - _log_det(S) + 2 * float(np.log(was.sigma).sum())
        return float(gain) / 2 + was.cost(np.zeros_like(m))


def _log_det(S: np.ndarray) -> float:
    return float(np.linalg.slogdet(S)[1])
