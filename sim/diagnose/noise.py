"""The noise card: white noise of the sensors from the residuals, the latent acceleration by evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.diagnose.effect import Effect
from sim.diagnose.fit import Fit
from sim.diagnose.linear import Point
from sim.identify.structured.fit import with_latent
from sim.identify.structured.noise import Noise

Q90 = 1.644854  # 90 % of a normal distribution lie within so many sigmas
WITHIN = (0.2, 10.0)  # of the stated noise: the residuals may say so much less or more; assumed
START = (0.02, 0.02, 0.03)  # latent acceleration to begin with [m/s^2, m/s^2, rad/s^2]; assumed
FLOOR = (5e-4, 5e-4, 5e-4)  # ambient: below this nothing is to be told [same units]; assumed
FACTORS = (10.0, 10**0.5, 10**0.25)


def whitened(noise: Noise, point: Point, stated: Noise) -> Noise:
    """White noise as the residuals' 90 % quantile shows it, which a few outliers do not move."""
    white = [
        _bounded(now, point.residuals[..., c], said)
        for c, (now, said) in enumerate(zip(noise.white, stated.white, strict=True))
    ]
    fix = _bounded(noise.fix_m, point.fix_residuals, stated.fix_m)
    return replace(noise, white=(white[0], white[1], white[2], white[3]), fix_m=fix)


def _bounded(sigma: float, residuals: np.ndarray, stated: float) -> float:
    known = np.abs(residuals[np.isfinite(residuals)])
    if not len(known):
        return sigma
    return float(np.clip(sigma * np.quantile(known, 0.9) / Q90, WITHIN[0] * stated, WITHIN[1] * stated))


def tuned_latent(fit: Fit, point: Point, chosen: Sequence[Effect], believed: frozenset[str]) -> Noise:
    """The latent acceleration of greatest evidence at a point: all axes together, then one by one, ever finer."""
    sigma = fit.sigma(chosen, believed)
    best = np.maximum(np.array(fit.noise.latent), FLOOR)

    def evidence(latent: np.ndarray) -> float:
        return fit.reduced(point, chosen, with_latent(fit.noise, latent)).evidence(sigma)

    value = evidence(best)
    for factor in FACTORS:
        for axes in (np.ones(3), *np.eye(3)):
            for power in (-1.0, 1.0):
                moved = True
                while moved:
                    trial = np.maximum(best * factor ** (power * axes), FLOOR)
                    moved = not np.allclose(trial, best) and (new := evidence(trial)) > value + 0.1
                    if moved:
                        best, value = trial, new
    return with_latent(fit.noise, best)
