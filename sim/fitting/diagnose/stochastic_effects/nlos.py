"""Fixes without line of sight: a share of them lies further from one anchor, by an exponential extra distance.

    e = fix - tag:   (1 - share) p_usual(e + c n) + share (N * Exp)(e . n + c; sigma, extra) N(e x n; sigma)

n: unit vector from the anchor to the tag; c: displacement of the fitted track by these fixes; p_usual: isotropic
normal with a small share of larger sigma. Tested against p_usual alone. Exponential plus normal: Grushka (1972), Anal.
Chem. 44, 1733.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, log_expit, log_ndtr, logit

from companion.logs.runs.run import Run
from sim.fitting.diagnose.stochastic_effects.estimate import (
    LOG_2PI,
    BatchedLogPosterior,
    PosteriorPeak,
    fit_peak,
    normal_log_density,
)

SIGMA, FEW, LARGER, SHARE, EXTRA, SHIFT = range(6)  # log m, logit, log, logit, log m, m
EVERYDAY, OWN = slice(0, 3), slice(3, 6)
SCALE = np.array([0.01, 0.2, 0.1, 0.1, 0.1, 0.003])
FEW_PRIOR, LARGER_PRIOR = (float(logit(0.01)), 1.5), (float(np.log(5.0)), 0.7)  # of sigma; assumed
SHARE_PRIOR, EXTRA_PRIOR, SHIFT_SIGMA_M = (float(logit(0.08)), 1.0), (float(np.log(0.7)), 0.8), 0.05  # assumed
BOX_MARGIN = 0.25  # margin of the corners that stand for unknown anchors, over the box of positions; assumed


@dataclass(frozen=True)
class BlockedAnchor:
    """Hypothesis that one anchor is out of sight: posterior of the parameters above, nats over usual errors alone.

    `number`: the anchor's name where that is a number, else its index; `line_of_sight` (m,): probability of each fix.
    """

    anchor: str
    number: int
    place_m: tuple[float, float]
    posterior: PosteriorPeak
    nats: float
    line_of_sight: np.ndarray

    @property
    def share(self) -> float:
        """Share of fixes without line of sight."""
        return float(expit(self.posterior.at[SHARE]))


def anchors_of(runs: Sequence[Run], places_m: np.ndarray) -> dict[str, tuple[float, float]]:
    """North and east of the anchors [m]: from the logs, else corners round the positions `places_m` (m, 2)."""
    known = {name: (a[0], a[1]) for run in runs for name, a in run.meta.anchors_m.items()}
    if known:
        return known
    low, high = places_m.min(axis=0), places_m.max(axis=0)
    margin = BOX_MARGIN * float((high - low).max())
    (n0, e0), (n1, e1) = low - margin, high + margin
    return {"south-west": (n0, e0), "north-west": (n1, e0), "north-east": (n1, e1), "south-east": (n0, e1)}


def fit_anchors(
    e: np.ndarray, places_m: np.ndarray, fix_m: float, anchors: Mapping[str, tuple[float, float]]
) -> list[BlockedAnchor]:
    """One hypothesis an anchor, the best first. `e`: fix minus tag (m, 2), `places_m`: fixes (m, 2), `fix_m`: sigma."""
    usual = _everyday(e, fix_m)
    found = []
    for i, (name, anchor) in enumerate(anchors.items()):
        away = places_m - e - np.array(anchor)
        n = away / np.maximum(np.linalg.norm(away, axis=1), 1e-6)[:, None]
        along, across = (e * n).sum(axis=1), e[:, 1] * n[:, 0] - e[:, 0] * n[:, 1]

        def f(q: np.ndarray, along: np.ndarray = along, across: np.ndarray = across) -> np.ndarray:
            return np.logaddexp(*_parts(q, along, across)).sum(axis=1) + _prior(q, fix_m)

        top = fit_peak(f, _start(f, usual), SCALE)
        seen, hidden = _parts(top.at[None], along, across)
        place = (float(anchor[0]), float(anchor[1]))
        number = int(name) if name.isdecimal() else i
        found.append(BlockedAnchor(name, number, place, top, top.evidence - usual.evidence, expit(seen - hidden)[0]))
    return sorted(found, key=lambda b: -b.nats)


def _parts(q: np.ndarray, along: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log densities (h, m) of fixes with and without line of sight, each times its share."""
    share, extra, sigma, c = q[:, [SHARE]], np.exp(q[:, [EXTRA]]), np.exp(q[:, [SIGMA]]), q[:, [SHIFT]]
    seen = log_expit(-share) + _usual(q, (along + c) ** 2 + across**2)
    rate, s = sigma / extra, (along + c) / sigma
    late = -q[:, [EXTRA]] - rate * s + rate**2 / 2 + log_ndtr(s - rate)
    return seen, log_expit(share) + late + normal_log_density(across, 0.0, sigma)


def _usual(q: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Log density of a usual error by its square: isotropic normal with a small share of larger sigma."""
    few = log_expit(q[:, [FEW]]) + _round(squares, q[:, [SIGMA]] + q[:, [LARGER]])
    return np.logaddexp(few, log_expit(-q[:, [FEW]]) + _round(squares, q[:, [SIGMA]]))


def _round(squares: np.ndarray, log_sigma: np.ndarray) -> np.ndarray:
    """Log density of an isotropic normal distribution in the plane."""
    return -0.5 * squares * np.exp(-2 * log_sigma) - 2 * log_sigma - LOG_2PI


def _usual_prior(q: np.ndarray, sigma_m: float) -> np.ndarray:
    noise = normal_log_density(q[:, SIGMA], np.log(sigma_m), 0.5)
    return noise + normal_log_density(q[:, FEW], *FEW_PRIOR) + normal_log_density(q[:, LARGER], *LARGER_PRIOR)


def _prior(q: np.ndarray, sigma_m: float) -> np.ndarray:
    own = normal_log_density(q[:, SHARE], *SHARE_PRIOR) + normal_log_density(q[:, EXTRA], *EXTRA_PRIOR)
    return _usual_prior(q, sigma_m) + own + normal_log_density(q[:, SHIFT], 0.0, SHIFT_SIGMA_M)


def _everyday(e: np.ndarray, sigma_m: float) -> PosteriorPeak:
    """Posterior of the usual errors' parameters, all fixes having line of sight."""
    squares = (e**2).sum(axis=1)

    def f(q: np.ndarray) -> np.ndarray:
        return _usual(q, squares).sum(axis=1) + _usual_prior(q, sigma_m)

    return fit_peak(f, np.array([np.log(sigma_m), FEW_PRIOR[0], LARGER_PRIOR[0]]), SCALE[EVERYDAY])


def _start(f: BatchedLogPosterior, usual: PosteriorPeak) -> np.ndarray:
    """Best start of a grid over share and extra, with usual errors as fitted and with few large ones."""
    few = [usual.at, np.array([usual.at[SIGMA], FEW_PRIOR[0], LARGER_PRIOR[0]])]
    grid = np.array([
        [*q, logit(share), np.log(extra), 0.0] for q in few for share in (0.02, 0.1) for extra in (0.3, 0.7, 1.5)
    ])  # fmt: skip
    return grid[int(f(grid).argmax())]
