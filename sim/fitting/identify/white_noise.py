"""White noise of the sensors, estimated from the residuals of a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.fitting.engine.linearise import HUBER, Linearised
from sim.fitting.engine.noise import Noise

Q90 = 1.644854  # 90 % of a normal distribution lie within this many sigmas
COLOURED = 0.2  # lag-1 correlation of residuals from which their sigma is enlarged
FACTORS = (0.3, 10.0)  # bounds of an estimated white noise, times the stated one; assumed


def white_from_residuals(noise: Noise, at: Linearised, stated: Noise) -> tuple[Noise, float]:
    """The noise with white noise estimated from the residuals, and the largest relative change of a sigma.

    From the 90 % quantile of the residuals, which a few outliers do not move; within `FACTORS` of the `stated` noise.
    n residuals of lag-1 correlation rho carry the information of n (1 - rho) / (1 + rho) independent ones (first-order
    autoregression): their sigma is enlarged to match.
    """
    white = tuple(
        _bounded(now, at.residuals[..., c].ravel(), said)
        for c, (now, said) in enumerate(zip(noise.white, stated.white, strict=True))
    )
    fix = _bounded(noise.fix_m, at.fix_residuals, stated.fix_m)
    change = np.array([*white, fix]) / np.array([*noise.white, noise.fix_m]) - 1
    psi, r, ax, ay = white
    return replace(noise, white=(psi, r, ax, ay), fix_m=fix), float(np.abs(change).max())


def _bounded(sigma: float, whitened: np.ndarray, stated: float) -> float:
    """Sigma of one channel from its residuals in order of time, (m,) or (m, 2), whitened with the present `sigma`."""
    known = whitened[np.isfinite(whitened).reshape(len(whitened), -1).all(axis=1)]
    if not len(known):
        return sigma
    rho = lag1_correlation(known)
    share = np.sqrt((1 + rho) / (1 - rho)) if rho > COLOURED + 2 / np.sqrt(len(known)) else 1.0
    estimate = sigma * share * np.quantile(np.abs(known), 0.9) / Q90
    return float(np.clip(estimate, FACTORS[0] * stated, FACTORS[1] * stated))


def lag1_correlation(residuals: np.ndarray) -> float:
    """Lag-1 autocorrelation of whitened residuals (m,) or (m, 2) about zero, each clipped to `HUBER` sigmas."""
    r = np.clip(residuals, -HUBER, HUBER)
    return float(np.clip((r[1:] * r[:-1]).sum() / max((r * r).sum(), 1e-12), -0.99, 0.99))
