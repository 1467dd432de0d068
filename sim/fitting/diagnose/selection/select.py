"""Which effects the logs ask for: forward by evidence with refits to convergence, then backward.

Each is judged as a candidate beside those believed in, all other entries of the catalogue being free within their
tolerance bands.
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

REFIT = 3  # how many candidates a round refits
HOPEFUL = 3.0  # nats by the linearisation that a candidate must have to be refitted: it may tell less than is there
SIZED = 0.7  # of the smallest size that a candidate must seem to have to be refitted; assumed
LOCATED = 0.35  # the same of one of many places or times, which are seen smaller than they are; assumed
NEAR = 12.0  # nats behind the first within which a candidate is refitted
MOST = 4
ASTRAY = 1.2  # times the cost of the data before: a refit that ends there did not find its way
Progress = Callable[[str, float], None]
Rivals = dict[str, list[tuple[str, float]]]
"""By name of a cause what could stand in its place, by name, and how many nats less that explains."""


@dataclass
class Selection:
    """The path and its end. `ranking`: every candidate at the last step, best first."""

    base: CandidateModel
    final: CandidateModel
    causes: list[Candidate]
    ranking: list[Candidate]
    rivals: Rivals = field(default_factory=dict)


class Selector(Refitter):
    """Greedy search over one catalogue."""

    def __init__(self, fit: PosteriorFit, say: Progress = lambda _text, _share: None):
        super().__init__(fit)
        self.say = say
        self.named = [e for e in fit.effects if e.family != "base"]
        self._at = parameter_slices(fit.effects)

    def screen(self, model: CandidateModel) -> list[Candidate]:
        """Every effect that is not yet believed in, at the best of a few latent accelerations, best first."""
        point = self.linearise_catalogue(model)
        found: dict[str, Candidate] = {}
        scores: dict[str, float] = {}
        active = [self.by_id[i] for i in model.active]
        said = {name for e in active for name in (e.name, e.contains)}
        for noise in latent_scales(model.noise):
            reduced = model.reduced if noise is model.noise else self.fit.reduced(point, self.fit.effects, noise)
            assert reduced is not None
            within = self.fit.prior(self.fit.effects, model.active)
            posterior, evidence = reduced.posterior(within), reduced.evidence(within)
            for effect in self.named:
                if effect.name in said:
                    continue
                candidate = score_candidate(posterior, self._at[effect.id], effect)
                if evidence + candidate.gain > scores.get(effect.id, -np.inf):
                    found[effect.id], scores[effect.id] = candidate, evidence + candidate.gain
        return sorted(found.values(), key=lambda c: -scores[c.id])

    def fit_causes(self, base: CandidateModel, names: Sequence[str]) -> Selection:
        """These causes and no others, however small: of variants of one name those that explain most.

        Of a value beyond its limits nothing is known of how small it may be.
        """
        model, ranking = base, self.screen(base)
        for name in names:
            best = next(c for c in ranking if self.by_id[c.id].name == name)
            model = self.refit(model, model.active | {best.id}, {best.id: self.start_values(model, best)})
            ranking = self.screen(model)
        judged = [self.score_active(model, id_) for id_ in sorted(model.active)]
        return Selection(base, model, [replace(c, lower=max(c.lower, 0.0)) for c in judged], ranking)

    def without(self, selection: Selection, gone: Collection[str]) -> Selection:
        """`selection` with the causes `gone` (ids) taken back, and the others refitted.

        Those that do not stand without them go as well.
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
        """From the base to the end."""
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
        """The refitted candidate of greatest evidence if it is acceptable, and how far others are behind it [nats].

        If it is not, the special case that it contains may be: there is more to it, which adequacy will tell. Of those
        that then explain more, the acceptable ones are nil behind; the others could not be named themselves. What is a
        special case of the candidate is not believed in beside it: it makes room if the candidate explains that much
        more than it did.

        Of many places or times, one at which an impossible value explains most is chance: what has neither place nor
        time, is acceptable, and explains nearly as much (`DECISIVE_NATS`) is taken before it.
        """
        tried = self._refit_best(model, [c for c in ranking if c.nats >= HOPEFUL and c.size > SIZED])
        if not any(self.score_active(m, id_).accepted for m, id_ in tried):
            located = [c for c in ranking if self.by_id[c.id].variant_of and c.nats >= DECISIVE_NATS]
            tried += self._refit_best(model, [c for c in located if SIZED >= c.size > LOCATED])
        if not tried:
            return None, []
        tried.sort(key=lambda t: -t[0].evidence)
        judged = [self.score_active(m, id_) for m, id_ in tried]
        found = [m.point.cost <= ASTRAY * model.point.cost for m, _ in tried]
        sure = [there and c.accepted for there, c in zip(found, judged, strict=True)]
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
        """Which of `tried`, best first, may be taken: see `_best_addition`."""
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

    def _refit_best(self, model: CandidateModel, hopeful: Sequence[Candidate]) -> list[tuple[CandidateModel, str]]:
        """`model` with each of the best few of `hopeful`, as far as that makes room."""
        tried: list[tuple[CandidateModel, str]] = []
        names: set[str] = set()
        for c in hopeful:
            name = self.by_id[c.id].name
            sure = any(self.score_active(m, id_).accepted for m, id_ in tried)
            if name in names or len(tried) >= REFIT or (sure and hopeful[0].gain - c.gain > NEAR):
                continue
            names.add(name)
            with suppress(np.linalg.LinAlgError):  # a boat that would be thrown out of all bounds
                special = {i for i in model.active if self.by_id[i].name == self.by_id[c.id].contains}
                active = (model.active - special) | {c.id}
                after = self.refit(model, active, {c.id: self.start_values(model, c)})
                if justifies_removal(model, after):
                    tried.append((after, c.id))
        return tried

    def _accepted_causes(self, model: CandidateModel) -> list[Candidate]:
        """What stands at the end, each judged with the others in place."""
        judged = [self.score_active(model, id_) for id_ in sorted(model.active)]
        return [c for c in judged if c.accepted]

    def _rescore_rivals(self, model: CandidateModel, rivals: Rivals) -> Rivals:
        """`rivals`, those that were near when their cause was taken judged anew beside what is believed in now."""
        ids = {self.by_id[i].name: i for i in model.active}
        found = {
            name: [
                (other, self._nats_behind(model, ids[name], other) if near < RIVAL_NATS and other not in ids else near)
                for other, near in others
            ]
            for name, others in rivals.items()
            if name in ids
        }
        self.fit.noise = model.noise
        return found

    def _nats_behind(self, model: CandidateModel, id_: str, other: str) -> float:
        """How many nats less `model` explains with the effect named `other` in the place of `id_`, at least nil."""
        with suppress(np.linalg.LinAlgError):  # a boat that would be thrown out of all bounds
            left = self.refit(model, model.active - {id_}, self._zero_values([id_]))
            best = next((c for c in self.screen(left) if self.by_id[c.id].name == other), None)
            if best is not None:
                instead = self.refit(left, left.active | {best.id}, {best.id: self.start_values(left, best)})
                return max(model.evidence - instead.evidence, 0.0)
        return np.inf

    def _zero_values(self, ids: Collection[str]) -> dict[str, np.ndarray]:
        """Values at which to begin without what was believed: its tolerance band stays."""
        return {i: np.zeros(len(self.by_id[i].parameters)) for i in ids if self.by_id[i].always_free}


def justifies_removal(before: CandidateModel, after: CandidateModel) -> bool:
    """Whether what is believed in before may go after: then that much more is explained, or nothing goes."""
    return before.active <= after.active or after.evidence - before.evidence >= DECISIVE_NATS
