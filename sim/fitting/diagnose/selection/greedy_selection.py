"""Greedy selection of causes: forward by evidence with refits to convergence, then backward elimination.

Every candidate is scored beside the active effects, all other entries of the catalogue being free within their
tolerance bands. A round: screen all by the linearisation, refit the best `REFIT`, add the best that is acceptable.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from sim.fitting.diagnose.catalogue.effect import parameter_slices
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import latent_scales
from sim.fitting.diagnose.report.findings import RIVAL_NATS
from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS, Candidate, score_candidate
from sim.fitting.diagnose.selection.model import CandidateModel, Refitter

REFIT = 3  # candidates refitted in a round
HOPEFUL = 3.0  # least nats by the linearisation for a refit: it may underestimate the evidence
SIZED = 0.7  # least size by the linearisation, over the smallest worth a name, for a refit; assumed
LOCATED = 0.35  # the same for a variant of place or time, whose size is underestimated away from the true one; assumed
NEAR = 12.0  # nats behind the first candidate within which others are refitted beside an accepted one
MOST = 4  # most causes
ASTRAY = 1.2  # data cost over that before above which a refit did not converge
Progress = Callable[[str, float], None]
Rivals = dict[str, list[tuple[str, float]]]
"""By name of a cause, names of rivals and how many nats less each explains in its place."""


@dataclass
class Selection:
    """Base model, final model, its causes and their rivals. `ranking`: all candidates at the last step, best first."""

    base: CandidateModel
    final: CandidateModel
    causes: list[Candidate]
    ranking: list[Candidate]
    rivals: Rivals = field(default_factory=dict)


class Selector(Refitter):
    """Greedy selection over the catalogue of `fit`; `say`: text and share done."""

    def __init__(self, fit: PosteriorFit, say: Progress = lambda _text, _share: None):
        super().__init__(fit)
        self.say = say
        self.named = [e for e in fit.effects if e.family != "base"]
        self._at = parameter_slices(fit.effects)

    def screen(self, model: CandidateModel) -> list[Candidate]:
        """Score of every effect that is not active, at the best of a few latent accelerations, best first."""
        point = self.linearise_catalogue(model)
        best: dict[str, Candidate] = {}
        scores: dict[str, float] = {}
        active = [self.by_id[i] for i in model.active]
        excluded_names = {name for e in active for name in (e.name, e.contains)}
        for noise in latent_scales(model.noise):
            reduced = model.reduced if noise is model.noise else self.fit.reduced(point, self.fit.effects, noise)
            assert reduced is not None
            within = self.fit.prior(self.fit.effects, model.active)
            posterior, evidence = reduced.posterior(within), reduced.evidence(within)
            for effect in self.named:
                if effect.name in excluded_names:
                    continue
                candidate = score_candidate(posterior, self._at[effect.id], effect)
                if evidence + candidate.gain > scores.get(effect.id, -np.inf):
                    best[effect.id], scores[effect.id] = candidate, evidence + candidate.gain
        return sorted(best.values(), key=lambda c: -scores[c.id])

    def fit_causes(self, base: CandidateModel, names: Sequence[str]) -> Selection:
        """Fit the causes `names` and no others, however small, each by its best variant.

        A value beyond its limits has a lower limit of size of 0.
        """
        model, ranking = base, self.screen(base)
        for name in names:
            best = next(c for c in ranking if self.by_id[c.id].name == name)
            model = self.refit(model, model.active | {best.id}, {best.id: self.start_values(model, best)})
            ranking = self.screen(model)
        judged = [self.score_active(model, id_) for id_ in sorted(model.active)]
        return Selection(base, model, [replace(c, lower=max(c.lower, 0.0)) for c in judged], ranking)

    def without(self, selection: Selection, gone: Collection[str]) -> Selection:
        """`selection` with the causes `gone` (ids) withdrawn and the others refitted.

        Causes that are no longer accepted without them are withdrawn as well.
        """
        kept = [c.id for c in selection.causes if c.id not in gone]
        names = {self.by_id[i].name for i in kept}
        rivals = {name: others for name, others in selection.rivals.items() if name in names}
        if not kept:
            return replace(selection, final=selection.base, causes=[], rivals=rivals)
        model = self.refit(selection.final, frozenset(kept), self._zero_values(gone))
        causes = self._accepted_causes(model)
        if fallen := set(kept) - {c.id for c in causes}:
            return self.without(replace(selection, final=model), fallen.union(gone))
        self.linearise_catalogue(model)
        return replace(selection, final=model, causes=causes, rivals=self._rescore_rivals(model, rivals))

    def run(self, base: CandidateModel | None = None) -> Selection:
        """Forward selection from `base` (default: a fit of it), up to `MOST` causes, then backward elimination."""
        base = model = base or self.base()
        ranking: list[Candidate] = []
        rivals: Rivals = {}
        added = ""
        for round_ in range(MOST):
            ranking = self.screen(model)
            self.say(
                f"round {round_ + 1}: " + ", ".join(f"{c.id} {c.nats:.0f}" for c in ranking[:3]), 0.2 + 0.18 * round_
            )
            best, behind = self._best_addition(model, ranking)
            if best is None:
                break
            added = self.by_id[next(iter(best.active - model.active))].name
            rivals[added] = behind
            model = best
        if model.reduced is None:
            self.linearise_catalogue(model)
        earlier = {name: others for name, others in rivals.items() if name != added}
        return Selection(
            base, model, self._accepted_causes(model), ranking, rivals | self._rescore_rivals(model, earlier)
        )

    def _best_addition(
        self, model: CandidateModel, ranking: list[Candidate]
    ) -> tuple[CandidateModel | None, list[tuple[str, float]]]:
        """The best acceptable refitted candidate, or None, and by name how far others are behind it [nats].

        1. Refit candidates with enough nats and size; if none is accepted, also smaller variants of place or time.
        2. Order by evidence; accepted are those that converged and may be named.
        3. Take the first acceptable one, see `_first_acceptable`. Accepted candidates of more evidence are 0 behind;
           others of more evidence could not be named and are no rivals.

        A special case of a candidate is not active beside it: see `justifies_removal`.
        """
        tried = self._refit_best(model, [c for c in ranking if c.nats >= HOPEFUL and c.size > SIZED])
        if not any(self.score_active(m, id_).accepted for m, id_ in tried):
            located = [c for c in ranking if self.by_id[c.id].variant_of and c.nats >= DECISIVE_NATS]
            tried += self._refit_best(model, [c for c in located if SIZED >= c.size > LOCATED])
        if not tried:
            return None, []
        tried.sort(key=lambda t: -t[0].evidence)
        judged = [self.score_active(m, id_) for m, id_ in tried]
        converged_refits = [m.point.cost <= ASTRAY * model.point.cost for m, _ in tried]
        sure = [converged and c.accepted for converged, c in zip(converged_refits, judged, strict=True)]
        best = self._first_acceptable(tried, judged, sure)
        if best is None:
            return None, []
        one = tried[best][0]
        others = [k for k in range(len(tried)) if k > best or (k < best and sure[k])]
        behind = [(self.by_id[tried[k][1]].name, max(one.evidence - tried[k][0].evidence, 0.0)) for k in others]
        return one, behind

    def _first_acceptable(
        self, tried: Sequence[tuple[CandidateModel, str]], judged: Sequence[Candidate], sure: Sequence[bool]
    ) -> int | None:
        """Index of the candidate of `tried` (best first) to take; `sure`: whether each is accepted and converged.

        1. The first if it is accepted.
        2. Else the special case that it contains, if accepted: adequacy then finds what is missing.
        3. Else, where the first is a variant of place or time with an impossible value (chance, of so many variants),
           the first accepted effect without place or time within `DECISIVE_NATS`.
        """
        if sure[0]:
            return 0
        effects = [self.by_id[id_] for _, id_ in tried]
        names = [e.name for e in effects]
        if effects[0].contains in names:
            special = names.index(effects[0].contains)
            return special if sure[special] else None
        if not effects[0].variant_of or np.isfinite(judged[0].lower):
            return None
        behind = [tried[0][0].evidence - m.evidence for m, _ in tried]
        near = (k for k, e in enumerate(effects) if behind[k] < DECISIVE_NATS and not e.variant_of)
        return next((k for k in near if sure[k]), None)

    def _refit_best(self, model: CandidateModel, candidates: Sequence[Candidate]) -> list[tuple[CandidateModel, str]]:
        """`model` with each of the best of `candidates` added, by id; a special case of the candidate is removed."""
        tried: list[tuple[CandidateModel, str]] = []
        names: set[str] = set()
        for c in candidates:
            name = self.by_id[c.id].name
            sure = any(self.score_active(m, id_).accepted for m, id_ in tried)
            if name in names or len(tried) >= REFIT or (sure and candidates[0].gain - c.gain > NEAR):
                continue
            names.add(name)
            with suppress(np.linalg.LinAlgError):  # the motion diverged
                special = {i for i in model.active if self.by_id[i].name == self.by_id[c.id].contains}
                active = (model.active - special) | {c.id}
                after = self.refit(model, active, {c.id: self.start_values(model, c)})
                if justifies_removal(model, after):
                    tried.append((after, c.id))
        return tried

    def _accepted_causes(self, model: CandidateModel) -> list[Candidate]:
        """Active effects that are accepted, each scored beside the others."""
        judged = [self.score_active(model, id_) for id_ in sorted(model.active)]
        return [c for c in judged if c.accepted]

    def _rescore_rivals(self, model: CandidateModel, rivals: Rivals) -> Rivals:
        """`rivals`, of which those within `RIVAL_NATS` are scored anew beside the effects active now."""
        ids = {self.by_id[i].name: i for i in model.active}
        rescored = {
            name: [
                (other, self._nats_behind(model, ids[name], other) if near < RIVAL_NATS and other not in ids else near)
                for other, near in others
            ]
            for name, others in rivals.items()
            if name in ids
        }
        self.fit.noise = model.noise
        return rescored

    def _nats_behind(self, model: CandidateModel, id_: str, other: str) -> float:
        """Evidence of `model` over that with the effect named `other` in place of `id_`, at least 0 [nats]."""
        with suppress(np.linalg.LinAlgError):  # the motion diverged
            left = self.refit(model, model.active - {id_}, self._zero_values([id_]))
            best = next((c for c in self.screen(left) if self.by_id[c.id].name == other), None)
            if best is not None:
                instead = self.refit(left, left.active | {best.id}, {best.id: self.start_values(left, best)})
                return max(model.evidence - instead.evidence, 0.0)
        return np.inf

    def _zero_values(self, ids: Collection[str]) -> dict[str, np.ndarray]:
        """Start values of zero for the `ids` that stay free within their tolerance bands."""
        return {i: np.zeros(len(self.by_id[i].parameters)) for i in ids if self.by_id[i].always_free}


def justifies_removal(before: CandidateModel, after: CandidateModel) -> bool:
    """Whether `after` may drop active effects of `before`: it drops none, or gains `DECISIVE_NATS`."""
    return before.active <= after.active or after.evidence - before.evidence >= DECISIVE_NATS
