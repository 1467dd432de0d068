"""Detection limits: from which size on these logs would have shown an effect that is absent.

The effect's own block of the covariance, all others within their tolerance bands, gives the information J of the data
on its amplitudes. In units of the smallest size worth a name, along the direction of least information,
se = lambda_min(J)^-1/2, a true size s is accepted on average where

    s^2 / (2 se^2) - sum log(prior / se) >= 9 nats      and     s - 1.64 se >= 1
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect, parameter_slices
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.selection.candidate_score import LEAST_EVIDENCE_NATS, Z95
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.fitting.diagnose.vessel_edits.public_form import smallest_size

BLIND = 1000.0  # limit over the smallest size worth a name beyond which logs show nothing of an effect


def detection_limits(fit: PosteriorFit, model: CandidateModel) -> dict[str, tuple[float, str]]:
    """By name of every effect that is not active, the detection limit in public units and the unit.

    Of variants the least limit; effects that these logs show at no size (of a sensor they do not have) are left out.
    """
    assert model.reduced is not None
    C = model.reduced.posterior(fit.prior(fit.effects, model.active)).covariance
    at = parameter_slices(fit.effects)
    least_limits: dict[str, tuple[float, Effect]] = {}
    for effect, share in _limits(fit, model, C, at):
        if effect.name not in least_limits or share < least_limits[effect.name][0]:
            least_limits[effect.name] = (share, effect)
    return {name: smallest_size(effect, share) for name, (share, effect) in least_limits.items() if share < BLIND}


def _limits(
    fit: PosteriorFit, model: CandidateModel, C: np.ndarray, at: dict[str, slice]
) -> Iterator[tuple[Effect, float]]:
    """Effect and detection limit over its smallest size, for each effect that is not active; C (P, P): covariance."""
    active_names = {e.name for e in fit.effects if e.id in model.active}
    for effect in fit.effects:
        if effect.family == "base" or effect.name in active_names or effect.nonlinear:
            continue
        sure = np.flatnonzero([np.isfinite(p.smallest) for p in effect.parameters])
        index = np.arange(at[effect.id].start, at[effect.id].stop)[sure]
        smallest_sizes = np.array([effect.parameters[i].smallest for i in sure])
        prior = np.array([effect.parameters[i].prior for i in sure])
        J = np.linalg.inv(C[np.ix_(index, index)]) - np.diag(1 / effect.tolerance()[sure] ** 2)
        J = np.outer(smallest_sizes, smallest_sizes) * J
        se = 1 / np.sqrt(max(float(np.linalg.eigvalsh(J).min()), 1e-12))
        price = LEAST_EVIDENCE_NATS + float(np.maximum(np.log(prior / smallest_sizes / se), 0.0).sum())
        yield effect, max(1 + Z95 * se, se * float(np.sqrt(2 * price)))
