"""Models to choose from: sets of believed effects, refitted to convergence, and the evidence for each.

All other entries of the catalogue are free within their tolerance bands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect, parameter_slices
from sim.fitting.diagnose.posterior.evidence import ReducedNormalEquations
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.noise import START, estimated_latent, estimated_white_noise
from sim.fitting.diagnose.selection.candidate_score import Candidate, score_candidate
from sim.fitting.engine.noise import Noise
from sim.fitting.identify.structured_fit import with_latent

ROUNDS = 6  # of four steps each, in a refit
SAME = 0.1  # of the logarithm of the latent acceleration: so small a change asks for no further round
SHARES = (2.0, 1.0, 0.6, 0.4, 0.25)  # of the size that a secant promises, from which the search for a far effect starts


@dataclass
class CandidateModel:
    """A set of believed effects, refitted: where it stands, and its evidence with all tolerance bands.

    `own`: over the parameters of `free`; `reduced`, once screened: over those of the whole catalogue.
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
        """The vessel file's model refitted within the tolerance of its coefficients, and the noise found on the way.

        `stated`: noise to begin with, if not the fit's.
        """
        fit = self.fit
        stated = stated or fit.noise
        free, none = self.always_free, frozenset()
        point = self._coarse_fit(stated, {})
        for steps in (2, 1, 2):
            point = fit.solve(point.theta, point.z, free, none, steps=steps, before=point)
            fit.noise = estimated_white_noise(fit.noise, point, stated)
            fit.noise = estimated_latent(fit, point)
            fit.count_degrees_of_freedom(point)
        return self._finish(frozenset(), point, free)

    def _coarse_fit(self, noise: Noise, theta: dict[str, np.ndarray]) -> LinearisationPoint:
        """From the measured motion towards that of a boat with `theta`, the ties of windows being loose at first."""
        fit, active = self.fit, frozenset(theta)
        few = [e for e in self.fit.effects if e.family == "base" or e.id in active]
        fit.noise = replace(noise, slack=100.0)
        point = fit.solve(theta, fit.z0, few, active, steps=1)
        fit.noise = replace(noise, slack=10.0)
        point = fit.solve(point.theta, point.z, few, active, steps=1, before=point)
        fit.noise = noise
        return point

    def refit(self, start: CandidateModel, active: frozenset[str], values: dict[str, np.ndarray]) -> CandidateModel:
        """`active` to convergence from `start`, with the latent acceleration found anew."""
        fit = self.fit
        fit.noise = start.noise
        free = [*self.always_free, *(self.by_id[i] for i in sorted(active) if not self.by_id[i].always_free)]
        ids = {e.id for e in free}
        theta = {k: v for k, v in start.point.theta.items() if k in ids} | values
        if any(self.by_id[i].all_or_nothing for i in values):  # another boat, to which this fit's numbers say little
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
        """One step from `values`; of a far effect, which secants tell little of, from the best of several shares."""
        tried = [self.by_id[i] for i in values]
        shares = SHARES if any(e.nonlinear for e in tried) else (1.0,)
        points = []
        for share in shares:
            guess = theta | {i: np.clip(share * v, *self.by_id[i].limits()) for i, v in values.items()}
            points.append(self.fit.solve(guess, start.point.z, free, active, steps=1, before=start.point))
        prior = self.fit.prior(free, active)
        costs = np.nan_to_num([self.fit.cost(p, free, prior) for p in points], nan=np.inf)
        best = int(np.argmin(costs))  # of none that can be reckoned with: from nil
        return points[best] if np.isfinite(costs[best]) else start.point

    def _finish(self, active: frozenset[str], point: LinearisationPoint, free: Sequence[Effect]) -> CandidateModel:
        """At `point` linearised anew: its steps took small effects as they were along the motion before."""
        point = self.fit.point(point.theta, point.z, free, point).without_columns()
        reduced = self.fit.reduced(point, free)
        evidence = reduced.evidence(self.fit.prior(free, active))
        return CandidateModel(active, point, self.fit.noise, tuple(free), reduced, evidence)

    def linearise_catalogue(self, model: CandidateModel) -> LinearisationPoint:
        """`model` linearised with the columns of every entry of the catalogue: too large to be kept."""
        fit = self.fit
        fit.noise = model.noise
        point = fit.point(model.point.theta, model.point.z, fit.effects, model.point).without_columns()
        model.reduced = fit.reduced(point, fit.effects)
        return point

    def score_active(self, model: CandidateModel, id_: str) -> Candidate:
        """One of those believed in, with the others in place."""
        within = self.fit.prior(model.free, model.active - {id_})
        return score_candidate(model.own.posterior(within), parameter_slices(model.free)[id_], self.by_id[id_])

    def start_values(self, model: CandidateModel, c: Candidate) -> np.ndarray:
        """Values within limits from which to refit: those of the best of an entry's `starts`, where it has any."""
        effect = self.by_id[c.id]
        return np.clip(self._start_entry_values(model, effect) if effect.start_entries else c.values, *effect.limits())

    def _start_entry_values(self, model: CandidateModel, effect: Effect) -> np.ndarray:
        assert effect.start_entries
        fit, starts = self.fit, effect.start_entries()
        fit.noise = model.noise
        free = [*model.free, *starts]
        reduced = fit.reduced(fit.point(model.point.theta, model.point.z, free, model.point), free)
        posterior, at = reduced.posterior(fit.prior(free, model.active)), parameter_slices(free)
        best = max(starts, key=lambda e: score_candidate(posterior, at[e.id], e).gain)
        moved = [best.origin.get(p.name, 0.0) - effect.origin.get(p.name, 0.0) for p in effect.parameters]
        return score_candidate(posterior, at[best.id], best).values * (np.array(moved) == 0) + np.array(moved)
