"""Held-out logs smoothed by a model under test: nothing is free but the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues
from sim.fitting.engine.noise import Noise

SLACKS = (100.0, 10.0, 1.0, 1.0, 1.0)
"""By step of smoothing from the initial guess, factor on the slack of the ties."""
MORE_STEPS, SETTLED_NATS = 30, 1.0  # at most, after these; decrease of the cost at which smoothing has converged
PARTS_OF_A_STEP = (1.0, 0.5, 0.25, 0.1, 0.03)


@dataclass(frozen=True)
class ModelUnderTest:
    """One model: parameters theta of effects, and its noise."""

    theta: ParameterValues
    noise: Noise


def smoothed(fit: PosteriorFit, model: ModelUnderTest) -> tuple[LinearisationPoint, float]:
    """Smoothed nodes with the model's parameters fixed, and its one-step log likelihood [nats].

    A model that is far off, as a first guess may be, needs more steps than `SLACKS`, and shorter ones.
    """
    point, nats = fit.point(model.theta, fit.z0, ()), -np.inf
    for step, slack in enumerate((*SLACKS, *[1.0] * MORE_STEPS), start=1):
        fit.noise = replace(model.noise, slack=slack * model.noise.slack)
        dz, nats = fit.node_step(point, fit.noise)
        point, fell = _downhill(fit, model, point, dz)
        if step >= len(SLACKS) and fell < SETTLED_NATS:
            break
    return point, nats - _log_noise(fit, model.noise)


def _downhill(
    fit: PosteriorFit, model: ModelUnderTest, point: LinearisationPoint, dz: np.ndarray
) -> tuple[LinearisationPoint, float]:
    """The point after the step `dz` (W, L), or the largest part of it by which the cost falls; by how many nats."""
    before = fit.nodes_cost(point, fit.noise)
    for share in PARTS_OF_A_STEP:
        with np.errstate(all="ignore"):  # the motion may diverge
            after = fit.point(model.theta, point.z + share * dz, (), point)
            fell = before - fit.nodes_cost(after, fit.noise)
        if fell >= 0:
            return after, fell
    return point, 0.0


def _log_noise(fit: PosteriorFit, noise: Noise) -> float:
    """Sum of log sigma over all readings [nats]: the models' white noise may differ."""
    known = np.isfinite(fit.physics.windows.y).sum(axis=(0, 1))
    return float(known @ np.log(noise.white)) + 2 * len(fit.physics.windows.fixes.t_s) * float(np.log(noise.fix_m))
