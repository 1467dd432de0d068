"""Which effects the logs ask for: forward by evidence with refits to convergence, then backward.

Each is judged as a candidate beside those believed in, all other entries of the catalogue being free within their
tolerance bands.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from sim.diagnose.candidate import NATS, Candidate, beside
from sim.diagnose.effect import Effect, slices
from sim.diagnose.evidence import Reduced
from sim.diagnose.fit import Fit
from sim.diagnose.linear import Point
from sim.diagnose.noise import START, shares_of, tuned_latent, whitened
from sim.identify.structured.fit import with_latent
from sim.identify.structured.noise import Noise

REFIT = 3  # how many candidates a round refits
HOPEFUL = 3.0  # nats by the linearisation that a candidate must have to be refitted: it may tell less than is there
SIZED = 0.7  # of the smallest size that a candidate must seem to have to be refitted; assumed
LOCATED = 0.35  # the same of one of many places or times, which are seen smaller than they are; assumed
NEAR = 12.0  # nats behind the first within which a candidate is refitted
MOST = 4
ROUNDS = 6  # of four steps each, in a refit
SAME = 0.1  # of the logarithm of the latent acceleration: so small a change asks for no further round
ASTRAY = 1.2  # times the cost of the data before: a refit that ends there did not find its way
SHARES = (2.0, 1.0, 0.6, 0.4, 0.25)  # of the size that a secant promises, from which the search for a far effect starts
Say = Callable[[str, float], None]


@dataclass
class Model:
    """A set of believed effects, refitted: where it stands, and its evidence with all tolerance bands.

    `own`: over the parameters of `chosen`; `reduced`, once screened: over those of the whole catalogue.
    """

    believed: frozenset[str]
    point: Point
    noise: Noise
    chosen: tuple[Effect, ...]
    own: Reduced
    evidence: float
    reduced: Reduced | None = None


@dataclass
class Selection:
    """The path and its end. `ranking`: every candidate at the last step, best first."""

    base: Model
    final: Model
    causes: list[Candidate]
    ranking: list[Candidate]
    rivals: dict[str, list[tuple[str, float]]] = field(default_factory=dict)


class Selector:
    """Greedy search over one catalogue."""

    def __init__(self, fit: Fit, say: Say = lambda _text, _share: None):
        self.fit, self.say = fit, say
        self.named = [e for e in fit.effects if e.family != "base"]
        self.by_id = {e.id: e for e in fit.effects}
        self._at = slices(fit.effects)
        self.everyday = [e for e in fit.effects if e.everyday]

    def base(self, stated: Noise | None = None) -> Model:
        """The vessel file's model refitted within the tolerance of its coefficients, and the noise found on the way.

        `stated`: noise to begin with, if not the fit's.
        """
        fit = self.fit
        stated = stated or fit.noise
        chosen, none = self.everyday, frozenset()
        point = self._roughly(stated, {})
        for steps in (2, 1, 2):
            point = fit.solve(point.theta, point.z, chosen, none, steps=steps, before=point)
            fit.noise = whitened(fit.noise, point, stated)
            fit.noise = tuned_latent(fit, point)
            fit.settle(point)
        return self._finished(frozenset(), point, chosen)

    def _roughly(self, noise: Noise, theta: dict[str, np.ndarray]) -> Point:
        """From the measured motion towards that of a boat with `theta`, the ties of windows being loose at first."""
        fit, believed = self.fit, frozenset(theta)
        few = [e for e in self.fit.effects if e.family == "base" or e.id in believed]
        fit.noise = replace(noise, slack=100.0)
        point = fit.solve(theta, fit.z0, few, believed, steps=1)
        fit.noise = replace(noise, slack=10.0)
        point = fit.solve(point.theta, point.z, few, believed, steps=1, before=point)
        fit.noise = noise
        return point

    def refit(self, start: Model, believed: frozenset[str], values: dict[str, np.ndarray]) -> Model:
        """`believed` to convergence from `start`, with the latent acceleration found anew."""
        fit = self.fit
        fit.noise = start.noise
        chosen = [*self.everyday, *(self.by_id[i] for i in sorted(believed) if not self.by_id[i].everyday)]
        ids = {e.id for e in chosen}
        theta = {k: v for k, v in start.point.theta.items() if k in ids} | values
        if any(self.by_id[i].whole for i in values):  # another boat, to which this fit's numbers say little
            point = self._roughly(with_latent(start.noise, np.array(START)), {i: theta[i] for i in believed})
        else:
            point = self._first(theta, values, start, chosen, believed)
        point = fit.solve(point.theta, point.z, chosen, believed, steps=4, tolerance=1.0, before=point)
        fit.noise = tuned_latent(fit, point)
        for _ in range(ROUNDS):
            point, there = fit.descend(point.theta, point.z, chosen, believed, steps=4, tolerance=0.3, before=point)
            was, fit.noise = fit.noise, tuned_latent(fit, point)
            if there and np.abs(np.log(np.divide(fit.noise.latent, was.latent))).max() < SAME:
                break
        return self._finished(believed, point, chosen)

    def _first(
        self,
        theta: dict[str, np.ndarray],
        values: dict[str, np.ndarray],
        start: Model,
        chosen: Sequence[Effect],
        believed: frozenset[str],
    ) -> Point:
        """One step from `values`; of a far effect, which secants tell little of, from the best of several shares."""
        tried = [self.by_id[i] for i in values]
        shares = SHARES if any(e.far for e in tried) else (1.0,)
        points = []
        for share in shares:
            guess = theta | {i: np.clip(share * v, *self.by_id[i].limits()) for i, v in values.items()}
            points.append(self.fit.solve(guess, start.point.z, chosen, believed, steps=1, before=start.point))
        prior = self.fit.prior(chosen, believed)
        costs = np.nan_to_num([self.fit.cost(p, chosen, prior) for p in points], nan=np.inf)
        best = int(np.argmin(costs))  # of none that can be reckoned with: from nil
        return points[best] if np.isfinite(costs[best]) else start.point

    def _finished(self, believed: frozenset[str], point: Point, chosen: Sequence[Effect]) -> Model:
        """At `point` linearised anew: its steps took small effects as they were along the motion before."""
        point = self.fit.point(point.theta, point.z, chosen, point).judged_only()
        reduced = self.fit.reduced(point, chosen)
        evidence = reduced.evidence(self.fit.prior(chosen, believed))
        return Model(believed, point, self.fit.noise, tuple(chosen), reduced, evidence)

    def complete(self, model: Model) -> Point:
        """`model` linearised with the columns of every entry of the catalogue: too large to be kept."""
        fit = self.fit
        fit.noise = model.noise
        point = fit.point(model.point.theta, model.point.z, fit.effects, model.point).judged_only()
        model.reduced = fit.reduced(point, fit.effects)
        return point

    def screen(self, model: Model) -> list[Candidate]:
        """Every effect that is not yet believed in, at the best of a few latent accelerations, best first."""
        point = self.complete(model)
        found: dict[str, Candidate] = {}
        scores: dict[str, float] = {}
        believed = [self.by_id[i] for i in model.believed]
        said = {name for e in believed for name in (e.name, e.contains)}
        for noise in shares_of(model.noise):
            reduced = model.reduced if noise is model.noise else self.fit.reduced(point, self.fit.effects, noise)
            assert reduced is not None
            within = self.fit.prior(self.fit.effects, model.believed)
            posterior, evidence = reduced.posterior(within), reduced.evidence(within)
            for effect in self.named:
                if effect.name in said:
                    continue
                candidate = beside(posterior, self._at[effect.id], effect)
                if evidence + candidate.gain > scores.get(effect.id, -np.inf):
                    found[effect.id], scores[effect.id] = candidate, evidence + candidate.gain
        return sorted(found.values(), key=lambda c: -scores[c.id])

    def of(self, base: Model, names: Sequence[str]) -> Selection:
        """These causes and no others, however small: of variants of one name those that explain most.

        Of a value beyond its limits nothing is known of how small it may be.
        """
        model, ranking = base, self.screen(base)
        for name in names:
            best = next(c for c in ranking if self.by_id[c.id].name == name)
            model = self.refit(model, model.believed | {best.id}, {best.id: self._start(model, best)})
            ranking = self.screen(model)
        judged = [self._judged(model, id_) for id_ in sorted(model.believed)]
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
        nil = {i: np.zeros(len(self.by_id[i].parameters)) for i in gone if self.by_id[i].everyday}
        model = self.refit(selection.final, frozenset(kept), nil)
        causes = self._pruned(model)
        if fallen := set(kept) - {c.id for c in causes}:
            return self.without(replace(selection, final=model), fallen.union(gone))
        self.complete(model)
        return replace(selection, final=model, causes=causes, rivals=rivals)

    def _judged(self, model: Model, id_: str) -> Candidate:
        """One of those believed in, with the others in place."""
        within = self.fit.prior(model.chosen, model.believed - {id_})
        return beside(model.own.posterior(within), slices(model.chosen)[id_], self.by_id[id_])

    def run(self, base: Model | None = None) -> Selection:
        """From the base to the end."""
        base = model = base or self.base()
        ranking: list[Candidate] = []
        rivals: dict[str, list[tuple[str, float]]] = {}
        for round_ in range(MOST):
            ranking = self.screen(model)
            self.say(
                f"round {round_ + 1}: " + ", ".join(f"{c.id} {c.nats:.0f}" for c in ranking[:3]), 0.2 + 0.18 * round_
            )
            best, behind = self._best(model, ranking)
            if best is None:
                break
            added = next(iter(best.believed - model.believed))
            rivals[self.by_id[added].name] = behind
            model = best
        if model.reduced is None:
            self.complete(model)
        causes = self._pruned(model)
        return Selection(base, model, causes, ranking, rivals)

    def _best(self, model: Model, ranking: list[Candidate]) -> tuple[Model | None, list[tuple[str, float]]]:
        """The refitted candidate of greatest evidence if it is acceptable, and how far others are behind it [nats].

        If it is not, the special case that it contains may be: there is more to it, which adequacy will tell. Of those
        that then explain more, the acceptable ones are nil behind; the others could not be named themselves. What is a
        special case of the candidate is not believed in beside it: it makes room if the candidate explains that much
        more than it did.
        """
        tried = self._refitted(model, [c for c in ranking if c.nats >= HOPEFUL and c.size > SIZED])
        if not any(self._judged(m, id_).accepted for m, id_ in tried):
            located = [c for c in ranking if self.by_id[c.id].of and c.nats >= NATS]
            tried += self._refitted(model, [c for c in located if SIZED >= c.size > LOCATED])
        if not tried:
            return None, []
        tried.sort(key=lambda t: -t[0].evidence)
        sure = [m.point.cost <= ASTRAY * model.point.cost and self._judged(m, id_).accepted for m, id_ in tried]
        simpler = self.by_id[tried[0][1]].contains
        best = 0 if sure[0] else next((k for k, (_, i) in enumerate(tried) if self.by_id[i].name == simpler), 0)
        if not sure[best]:
            return None, []
        one = tried[best][0]
        others = [k for k in range(len(tried)) if k > best or (k < best and sure[k])]
        behind = [(self.by_id[tried[k][1]].name, max(one.evidence - tried[k][0].evidence, 0.0)) for k in others]
        return one, behind

    def _refitted(self, model: Model, hopeful: Sequence[Candidate]) -> list[tuple[Model, str]]:
        """`model` with each of the best few of `hopeful`, as far as that makes room."""
        tried: list[tuple[Model, str]] = []
        names: set[str] = set()
        for c in hopeful:
            name = self.by_id[c.id].name
            sure = any(self._judged(m, id_).accepted for m, id_ in tried)
            if name in names or len(tried) >= REFIT or (sure and hopeful[0].gain - c.gain > NEAR):
                continue
            names.add(name)
            with suppress(np.linalg.LinAlgError):  # a boat that would be thrown out of all bounds
                special = {i for i in model.believed if self.by_id[i].name == self.by_id[c.id].contains}
                believed = (model.believed - special) | {c.id}
                after = self.refit(model, believed, {c.id: self._start(model, c)})
                if makes_room(model, after):
                    tried.append((after, c.id))
        return tried

    def _start(self, model: Model, c: Candidate) -> np.ndarray:
        """Values within limits from which to refit: those of the best of an entry's `starts`, where it has any."""
        effect = self.by_id[c.id]
        return np.clip(self._nearer(model, effect) if effect.starts else c.values, *effect.limits())

    def _nearer(self, model: Model, effect: Effect) -> np.ndarray:
        assert effect.starts
        fit, starts = self.fit, effect.starts()
        fit.noise = model.noise
        chosen = [*model.chosen, *starts]
        reduced = fit.reduced(fit.point(model.point.theta, model.point.z, chosen, model.point), chosen)
        posterior, at = reduced.posterior(fit.prior(chosen, model.believed)), slices(chosen)
        best = max(starts, key=lambda e: beside(posterior, at[e.id], e).gain)
        moved = [best.origin.get(p.name, 0.0) - effect.origin.get(p.name, 0.0) for p in effect.parameters]
        return beside(posterior, at[best.id], best).values * (np.array(moved) == 0) + np.array(moved)

    def _pruned(self, model: Model) -> list[Candidate]:
        """What stands at the end, each judged with the others in place."""
        judged = [self._judged(model, id_) for id_ in sorted(model.believed)]
        return [c for c in judged if c.accepted]


def makes_room(before: Model, after: Model) -> bool:
    """Whether what is believed in before may go after: then that much more is explained, or nothing goes."""
    return before.believed <= after.believed or after.evidence - before.evidence >= NATS
