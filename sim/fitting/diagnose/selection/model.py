"""Candidate models: sets of active effects, refitted to convergence, with the evidence for each.

All other entries of the catalogue that are always free stay within their tolerance bands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect, parameter_slices
from sim.fitting.diagnose.posterior.evidence import ReducedNormalEquations
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.noise import START, estimated_latent, estimated_white_noise, with_unknown_lean
from sim.fitting.diagnose.selection.candidate_score import Candidate, score_candidate
from sim.fitting.engine.noise import Noise
from sim.fitting.identify.structured_fit import with_latent

ROUNDS = 6  # of four steps each, in a refit
SAME = 0.1  # change of the logarithm of the latent acceleration at convergence
SHARES = (2.0, 1.0, 0.6, 0.4, 0.25)  # starts of a nonlinear effect over the value that its secant predicts


@dataclass
class CandidateModel:
    """A set of active effects, refitted.

    active      ids of the active effects
    point       linearisation at the optimum, without columns
    free        effects with free parameters: always free ones and the active ones
    own         normal equations of the parameters of `free`, nodes eliminated
    evidence    log evidence with all tolerance bands [nats]
    reduced     the same equations of the whole catalogue, once it is screened
    """

    active: frozenset[str]
    point: LinearisationPoint
    noise: Noise
    free: tuple[Effect, ...]
    own: ReducedNormalEquations
    evidence: float
    reduced: ReducedNormalEquations | None = None


class Refitter:
    """Fits sets of effects of the catalogue of `fit`."""

    def __init__(self, fit: PosteriorFit):
        self.fit = fit
        self.by_id = {e.id: e for e in fit.effects}
        self.always_free = [e for e in fit.effects if e.always_free]

    def base(self, stated: Noise | None = None) -> CandidateModel:
        """The vessel file's model refitted within all tolerance bands, with noise estimated in alternation.

        `stated`: initial noise (default: the fit's).
        """
        fit = self.fit
        stated = stated or fit.noise
        free, none = self.always_free, frozenset()
        point = self._coarse_fit(stated, {})
        for steps in (2, 1, 2):
            point = fit.solve(point.theta, point.z, free, none, steps=steps, before=point)
            fit.noise = estimated_white_noise(fit.noise, point, stated)
            if not fit.physics.levelled:
                fit.noise = with_unknown_lean(fit.noise)
            fit.noise = estimated_latent(fit, point)
            fit.count_degrees_of_freedom(point)
        return self._finish(frozenset(), point, free)

    def _coarse_fit(self, noise: Noise, theta: dict[str, np.ndarray]) -> LinearisationPoint:
        """Coarse fit from the measured motion with `theta` active, with loose ties of the windows at first."""
        fit, active = self.fit, frozenset(theta)
        few = [e for e in self.fit.effects if e.family == "base" or e.id in active]
        fit.noise = replace(noise, slack=100.0)
        point = fit.solve(theta, fit.z0, few, active, steps=1)
        fit.noise = replace(noise, slack=10.0)
        point = fit.solve(point.theta, point.z, few, active, steps=1, before=point)
        fit.noise = noise
        return point

    def refit(self, start: CandidateModel, active: frozenset[str], values: dict[str, np.ndarray]) -> CandidateModel:
        """Fit the set `active` to convergence from the model `start`, with `values` of newly active effects (by id).

        1. First step from `values`, or a coarse fit for an effect that is present as a whole.
        2. Gauss-Newton and the latent acceleration of most evidence, alternating until both are stationary.
        """
        fit = self.fit
        fit.noise = start.noise
        free = [*self.always_free, *(self.by_id[i] for i in sorted(active) if not self.by_id[i].always_free)]
        ids = {e.id for e in free}
        theta = {k: v for k, v in start.point.theta.items() if k in ids} | values
        if any(self.by_id[i].all_or_nothing for i in values):  # the present nodes are no start for such another boat
            point = self._coarse_fit(with_latent(start.noise, np.array(START)), {i: theta[i] for i in active})
        else:
            point = self._first_step(theta, values, start, free, active)
        point = fit.solve(point.theta, point.z, free, active, steps=4, tolerance=1.0, before=point)
        fit.noise = estimated_latent(fit, point)
        for _ in range(ROUNDS):
            point, there = fit.descend(point.theta, point.z, free, active, steps=4, tolerance=0.3, before=point)
            was, fit.noise = fit.noise, estimated_latent(fit, point)
            if there and np.abs(np.log(np.divide(fit.noise.latent, was.latent))).max() < SAME:
                break
        return self._finish(active, point, free)

    def _first_step(
        self,
        theta: dict[str, np.ndarray],
        values: dict[str, np.ndarray],
        start: CandidateModel,
        free: Sequence[Effect],
        active: frozenset[str],
    ) -> LinearisationPoint:
        """One step from `values`; of a nonlinear effect from the best of several `SHARES` of them."""
        tried = [self.by_id[i] for i in values]
        shares = SHARES if any(e.nonlinear for e in tried) else (1.0,)
        points = []
        for share in shares:
            guess = theta | {i: np.clip(share * v, *self.by_id[i].limits()) for i, v in values.items()}
            points.append(self.fit.solve(guess, start.point.z, free, active, steps=1, before=start.point))
        prior = self.fit.prior(free, active)
        costs = np.nan_to_num([self.fit.cost(p, free, prior) for p in points], nan=np.inf)
        best = int(np.argmin(costs))  # where none is finite: from the present model
        return points[best] if np.isfinite(costs[best]) else start.point

    def _finish(self, active: frozenset[str], point: LinearisationPoint, free: Sequence[Effect]) -> CandidateModel:
        """The candidate model at `point`, linearised anew: steps take small effects along an earlier motion."""
        point = self.fit.point(point.theta, point.z, free, point).without_columns()
        reduced = self.fit.reduced(point, free)
        evidence = reduced.evidence(self.fit.prior(free, active))
        return CandidateModel(active, point, self.fit.noise, tuple(free), reduced, evidence)

    def linearise_catalogue(self, model: CandidateModel) -> LinearisationPoint:
        """Linearise `model` with columns of the whole catalogue, set its `reduced`; the point, which is not kept."""
        fit = self.fit
        fit.noise = model.noise
        point = fit.point(model.point.theta, model.point.z, fit.effects, model.point).without_columns()
        model.reduced = fit.reduced(point, fit.effects)
        return point

    def score_active(self, model: CandidateModel, id_: str) -> Candidate:
        """Score of the active effect `id_` beside the other active ones."""
        within = self.fit.prior(model.free, model.active - {id_})
        return score_candidate(model.own.posterior(within), parameter_slices(model.free)[id_], self.by_id[id_])

    def start_values(self, model: CandidateModel, c: Candidate) -> np.ndarray:
        """Start of a refit within limits: the candidate's values, or those of the best of its `start_entries`."""
        effect = self.by_id[c.id]
        return np.clip(self._start_entry_values(model, effect) if effect.start_entries else c.values, *effect.limits())

    def _start_entry_values(self, model: CandidateModel, effect: Effect) -> np.ndarray:
        """Values of the best of the effect's `start_entries`, relative to its own `origin`."""
        assert effect.start_entries
        fit, starts = self.fit, effect.start_entries()
        fit.noise = model.noise
        free = [*model.free, *starts]
        reduced = fit.reduced(fit.point(model.point.theta, model.point.z, free, model.point), free)
        posterior, at = reduced.posterior(fit.prior(free, model.active)), parameter_slices(free)
        best = max(starts, key=lambda e: score_candidate(posterior, at[e.id], e).gain)
        moved = [best.origin.get(p.name, 0.0) - effect.origin.get(p.name, 0.0) for p in effect.parameters]
        return score_candidate(posterior, at[best.id], best).values * (np.array(moved) == 0) + np.array(moved)
