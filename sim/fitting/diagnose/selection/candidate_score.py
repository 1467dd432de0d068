"""Score of one candidate effect beside the active ones, and whether it may be named.

A candidate is accepted where its log evidence exceeds that of its absence by `LEAST_EVIDENCE_NATS` and that of its
tolerance band by `LEAST_GAIN_NATS`, and where the lower 95 % limit of its size exceeds the smallest size worth a name.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.evidence import Posterior, Prior

LEAST_EVIDENCE_NATS = 9.0  # nats, eight thousand to one: hundreds of cases had nothing false above 5 (ADR 16)
DECISIVE_NATS = 12.0  # for one of two explanations over the other
LEAST_GAIN_NATS = 1.5  # nats over the tolerance band: four to one
BEYOND = 2.0  # standard errors by which a value may seem to be beyond its limits
Z95 = 1.644854  # one-sided


@dataclass(frozen=True)
class Candidate:
    """Score of one effect beside the active ones.

    nats, gain            log evidence over its absence, and over its tolerance band [nats]
    values, covariance    (k,), (k, k) of its parameters while it is active
    size, lower           size over the smallest worth a name, and its lower 95 % limit (one-sided)
    """

    id: str
    nats: float
    gain: float
    values: np.ndarray
    covariance: np.ndarray
    size: float
    lower: float

    @property
    def accepted(self) -> bool:
        """Whether it may be named: evidence, gain over the band, and lower limit of size are sufficient."""
        return self.nats >= LEAST_EVIDENCE_NATS and self.gain >= LEAST_GAIN_NATS and self.lower > 1.0


def score_candidate(posterior: Posterior, at: slice, effect: Effect) -> Candidate:
    """Score of `effect`, whose parameters are `at` in `posterior`, where it is within its tolerance band."""
    gain, values, C = posterior.under_prior(at, Prior(*effect.wide_prior()))
    size = effect.size(values)
    lower = size - Z95 * _size_se(effect, values, C) if _possible(effect, values, C) else -np.inf
    return Candidate(effect.id, gain - posterior.nats_if_absent(at), gain, values, C, size, lower)


def _possible(effect: Effect, values: np.ndarray, C: np.ndarray) -> bool:
    """Whether the values are within their limits, or beyond by at most `BEYOND` standard errors, and the essential one
    surely above zero (95 %).
    """
    for i, parameter in enumerate(effect.parameters):
        if parameter.name == effect.essential and values[i] <= Z95 * np.sqrt(C[i, i]):
            return False
    slack = BEYOND * np.sqrt(np.diag(C))
    lower, upper = effect.limits()
    return bool(((values >= lower - slack) & (values <= upper + slack)).all())


def _size_se(effect: Effect, values: np.ndarray, C: np.ndarray) -> float:
    """Standard error of the size: along the vector, or of the largest parameter."""
    scale = np.array([p.smallest for p in effect.parameters])
    v, cov = values / scale, C / np.outer(scale, scale)
    if effect.vector and np.linalg.norm(v) > 0:
        direction = v / np.linalg.norm(v)
        return float(np.sqrt(direction @ cov @ direction))
    i = int(np.abs(v).argmax())
    return float(np.sqrt(cov[i, i]))
