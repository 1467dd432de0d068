"""Identifiability: each cause at medium size as the truth, each rival as an explanation of it.

From the Hessian H (P, P) of all parameters, nodes eliminated, a cause a of true parameters w gives b = H w. With every
always free effect s within its tolerance band of covariance S,

    K = H - H_:s (H_ss + S^-1)^-1 H_s:          information on each parameter beside the bands
    nats(D) = -1/2 w^T K (1 + D K)^-1 w - 1/2 log det (1 + D K)     D: prior variances beyond the bands

and nats(a, b) is that of "a present, b absent" less that of "b present, a absent", over the parameters of the two. The
expected data are noise-free: no simulation. Limits of parameters are ignored, so a rival may explain more than it
could and the figures are on the low side. Of a vector the worst direction counts; of an effect's variants, as a truth
the one with most evidence, as a rival the one that explains best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect, parameter_slices
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS, LEAST_EVIDENCE_NATS

MEDIUM = 4.0  # medium size over the smallest size worth a name


@dataclass(frozen=True)
class PairwiseEvidence:
    """Expected log evidence of n causes of medium size.

    nats       (n, n) of the truth (row) over each rival (column) [nats]; NaN for itself and its equivalence class
    nothing    (n,) of the truth over "nothing is there" [nats]
    """

    names: tuple[str, ...]
    nats: np.ndarray
    nothing: np.ndarray

    def pairs(self) -> list[tuple[str, str, float]]:
        """All pairs: truth, rival, nats; the weakest first."""
        known = np.argwhere(np.isfinite(self.nats))
        rows = [(self.names[i], self.names[j], float(self.nats[i, j])) for i, j in known]
        return sorted(rows, key=lambda p: p[2])

    @property
    def confused(self) -> list[tuple[str, str, float]]:
        """Pairs below `DECISIVE_NATS` whose truth has as much over nothing; weakest first, each two names once."""
        shown = {n for n, nats in zip(self.names, self.nothing, strict=True) if nats >= DECISIVE_NATS}
        out: dict[frozenset[str], tuple[str, str, float]] = {}
        for a, b, nats in self.pairs():
            if nats < DECISIVE_NATS and a in shown:
                out.setdefault(frozenset((a, b)), (a, b, nats))
        return list(out.values())

    @property
    def hidden(self) -> list[str]:
        """Names of causes that the log could not have named at medium size."""
        return [n for n, nats in zip(self.names, self.nothing, strict=True) if nats < LEAST_EVIDENCE_NATS]


@dataclass(frozen=True)
class EffectBlocks:
    """Parameters of n effects, padded to (n, width).

    index, prior, band, medium    place in H, prior variance, band variance, medium size; padding: index 0, zeros
    vector                        (n,) whether the first two are components of a vector
    """

    index: np.ndarray
    prior: np.ndarray
    band: np.ndarray
    medium: np.ndarray
    vector: np.ndarray


def pairwise_evidence(
    fit: PosteriorFit,
    H: np.ndarray,
    active: frozenset[str] = frozenset(),
    effects: Sequence[Effect] = (),
    only: Sequence[str] = (),
) -> PairwiseEvidence:
    """Pairwise evidence from the Hessian H (P, P) of all parameters of `effects` (default: those of `fit`).

    `active`: ids of effects that are present; `only`: names to compare (default: all).
    """
    # 1. Information beside the always free effects.
    every = tuple(effects) or fit.effects
    sigma = fit.prior(every, active).sigma
    always = np.concatenate([np.full(len(e.parameters), e.always_free or e.id in active) for e in every])
    sigma = np.where(always, sigma, 0.0)
    mine = [e for e in every if e.family != "base" and (not only or e.name in only)]
    K, blocks = marginal_information(H, sigma), _blocks(mine, parameter_slices(every), sigma)
    # 2. Each variant against its own absence; the best variant of each name is its truth.
    names = tuple(dict.fromkeys(e.name for e in mine))
    of = np.array([names.index(e.name) for e in mine])
    alone, nothing = _alone(K, blocks), np.full(len(names), -np.inf)
    np.maximum.at(nothing, of, alone)
    shown = [int(np.flatnonzero(of == i)[alone[of == i].argmax()]) for i in range(len(names))]
    # 3. Each truth against all variants of other names and classes; the best variant of a rival counts.
    pairs = np.stack([np.repeat(shown, len(mine)), np.tile(np.arange(len(mine)), len(names))])
    pairs = pairs[:, _distinct(mine, *pairs)]
    nats = np.full((len(names), len(names)), np.inf)
    np.minimum.at(nats, (of[pairs[0]], of[pairs[1]]), _between(K, blocks, pairs))
    return PairwiseEvidence(names, np.where(np.isfinite(nats), nats, np.nan), nothing)


def marginal_information(H: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """K = H - H_:s (H_ss + S^-1)^-1 H_s: (P, P) for nuisances s with `sigma` (P,) > 0."""
    nuisances = np.flatnonzero(sigma > 0)
    factor = np.linalg.cholesky(H[np.ix_(nuisances, nuisances)] + np.diag(1 / sigma[nuisances] ** 2))
    half = np.linalg.solve(factor, H[nuisances])
    return H - half.T @ half


def _blocks(effects: Sequence[Effect], at: dict[str, slice], sigma: np.ndarray) -> EffectBlocks:
    """All effects, one row each; `sigma` (P,) of the nuisances."""
    width = max(len(e.parameters) for e in effects)
    index = np.zeros((len(effects), width), dtype=int)
    prior, band, medium = (np.zeros((len(effects), width)) for _ in range(3))
    for i, e in enumerate(effects):
        k = len(e.parameters)
        index[i, :k] = np.arange(at[e.id].start, at[e.id].stop)
        prior[i, :k] = [p.prior**2 + p.mean**2 for p in e.parameters]
        band[i, :k] = sigma[at[e.id]] ** 2
        medium[i, :k] = [_medium(p.smallest, p.lower, p.upper) for p in e.parameters]
    return EffectBlocks(index, prior, band, medium, np.array([e.vector for e in effects]))


def _medium(smallest: float, lower: float, upper: float) -> float:
    """Medium size of a parameter within its limits; zero for a place or time."""
    return min(MEDIUM * smallest, max(upper, -lower)) if np.isfinite(smallest) else 0.0


def _distinct(effects: Sequence[Effect], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Indices of the pairs (a, b) of different names and equivalence classes."""
    one = [{e.name, *e.same_as} for e in effects]
    distinct = np.array([[x.name not in other and y.name not in mine for y, other in zip(effects, one, strict=True)]
                      for x, mine in zip(effects, one, strict=True)])  # fmt: skip
    return np.flatnonzero(distinct[a, b])


def _alone(K: np.ndarray, blocks: EffectBlocks) -> np.ndarray:
    """Each effect against its own absence, (n,)."""
    Q, price = _gain(_parts(K, blocks.index, blocks.prior > 0), blocks.prior - blocks.band, -blocks.band)
    return _least(Q, price, blocks.medium, blocks.vector)


def _between(K: np.ndarray, blocks: EffectBlocks, pairs: np.ndarray) -> np.ndarray:
    """The first of each pair (2, m) against the second, (m,)."""
    a, width = pairs[0], blocks.index.shape[1]
    index = blocks.index[pairs].swapaxes(0, 1).reshape(len(a), 2 * width)
    variance = blocks.prior[pairs].swapaxes(0, 1).reshape(len(a), 2 * width)
    band = blocks.band[pairs].swapaxes(0, 1).reshape(len(a), 2 * width)
    first = np.arange(2 * width) < width
    Q, price = _gain(_parts(K, index, variance > 0), variance * first - band, variance * ~first - band)
    return _least(Q[:, :width, :width], price, blocks.medium[a], blocks.vector[a])


def _parts(K: np.ndarray, index: np.ndarray, real: np.ndarray) -> np.ndarray:
    """Blocks (m, k, k) of K (P, P) at `index` (m, k); zero at padding."""
    return K[index[:, :, None], index[:, None, :]] * (real[:, :, None] & real[:, None, :])


def _gain(K: np.ndarray, one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gain of variances `one` over `other` (m, k): Q (m, k, k) and price (m,) with nats = w^T Q w - price."""
    found = []
    for D in (one, other):
        weight = np.eye(K.shape[1]) + D[:, :, None] * K
        found.append((K @ np.linalg.inv(weight), np.linalg.slogdet(weight)[1]))
    (A, log_a), (B, log_b) = found
    return (B - A) / 2, (log_a - log_b) / 2


def _least(Q: np.ndarray, price: np.ndarray, medium: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Least nats (m,): over directions of a vector, else over the parameters alone."""
    Q = medium[:, :, None] * (Q + Q.swapaxes(1, 2)) / 2 * medium[:, None, :]
    each = np.where(medium > 0, np.diagonal(Q, axis1=1, axis2=2), np.inf).min(axis=1)
    of_vector = np.linalg.eigvalsh(Q[:, :2, :2])[:, 0]
    return np.where(vector, of_vector, each) - price
