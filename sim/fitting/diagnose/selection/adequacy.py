"""Adequacy: whether the model with its causes leaves a systematic residual, and what that depends on.

All groups of smooth functions (`residual_basis`) are free within tolerance bands beside the causes and the catalogue's
own bands, so that many small imperfections do not add up to a large one. For one group at a time

    nats = log p(data | this group's prior wide) - log p(data | all groups within their bands)

each at the best of a few latent accelerations and prior scales; log(number of scales) is subtracted for the choice. A
group whose nats reach the limit is a systematic residual, and so are more outlying fixes than chance explains. Nothing
else fails the check: autocorrelation and size of residuals and latent accelerations are reported for information, since
they change with the weather.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.fitting.diagnose.catalogue.effect import parameter_slices
from sim.fitting.diagnose.posterior.evidence import Prior, ReducedNormalEquations
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.noise import FLOOR, latent_scales
from sim.fitting.diagnose.report.findings import RIVAL_NATS, Adequacy, Check
from sim.fitting.diagnose.residual_basis import FunctionGroup, append_groups, groups_at
from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS, LEAST_EVIDENCE_NATS
from sim.fitting.diagnose.selection.greedy_selection import Selection
from sim.fitting.diagnose.selection.masking import NO_MASKING, Masking
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.fitting.diagnose.selection.residual_forces import autocorrelation
from sim.fitting.engine.noise import Noise

BAND = 0.05  # tolerance band over the size at which a function begins to matter; chosen on development cases
SCALES = (0.3, 1.0, 3.0, 10.0)  # wide prior over that size
ECHO = 0.2  # share of the best group's nats below which a group is taken to be masked by it; assumed
MIMIC = 3.0  # prior over that size of a group that stands in for a cause
AKIN = 0.5  # share of a cause's signature that a group must explain to put the cause's form in doubt; assumed
MANY = 3  # number of causes from which one group that explains as much is the simpler explanation; assumed
FAR_OUT, OFTEN = 4.0, 0.02  # sigmas of an outlier; limit of their share: in sound logs it is below 0.01
WHITE, UNIT, AMBIENT = 0.1, 1.1, 2.0  # autocorrelation, rms of residuals, latent over ambient: information; assumed


@dataclass(frozen=True)
class GroupEvidence:
    """Evidence of every group of functions beside the causes of a model.

    nats        gain of log evidence with each group's prior wide [nats], best first
    evidence    log evidence with all groups within their bands [nats]
    akin        by id of a cause, ids of the groups that can mimic its signature
    support     by id of a cause, nats for it over its absence while all groups are free within their bands
    limit       nats from which a group is a systematic residual
    """

    nats: tuple[tuple[FunctionGroup, float], ...]
    evidence: float
    akin: Mapping[str, frozenset[str]]
    support: Mapping[str, float]
    limit: float = DECISIVE_NATS

    @property
    def significant(self) -> tuple[FunctionGroup, ...]:
        """Groups that reach the limit, best first, without those that the best one masks."""
        least = max(self.limit, ECHO * self.nats[0][1])
        return tuple(group for group, nats in self.nats if nats >= least)

    def is_akin(self, cause: str, groups: Sequence[FunctionGroup]) -> bool:
        """Whether one of `groups` can mimic the signature of `cause` (id)."""
        return any(group.effect.id in self.akin.get(cause, frozenset()) for group in groups)


@dataclass(frozen=True)
class AdequacyJudgement:
    """The adequacy record, and ids of causes.

    doubtful     of the right kind, but a significant group can mimic them: their form is in doubt
    withdrawn    not to be named
    outdone      those of the withdrawn for all of which one group is the better explanation
    """

    adequacy: Adequacy
    doubtful: frozenset[str] = frozenset()
    withdrawn: frozenset[str] = frozenset()
    outdone: frozenset[str] = frozenset()


def group_evidence(
    fit: PosteriorFit, model: CandidateModel, causes: Sequence[str], masking: Masking = NO_MASKING
) -> GroupEvidence:
    """Evidence of all groups beside `causes` (ids of entries) at the fitted `model`; masked groups are left out."""
    # 1. Groups: as effects with hooks, or by node columns that the normal equations have already.
    every = [g for g in groups_at(fit.physics, model.point) if not g.effect.equation.startswith(masking.names)]
    if masking.within:
        every = [g.of_means(fit.physics, model.point, fit.effects) for g in every]
    hooked, on_nodes = ([g for g in every if (g.nodes is None) == whether] for whether in (True, False))
    groups, within = (*hooked, *on_nodes), [*model.free, *(g.effect for g in hooked)]
    fit.noise = model.noise
    point = fit.point(model.point.theta, model.point.z, within, model.point).without_columns()
    # 2. One linearisation with the columns of all groups; prior: tolerance bands.
    point = append_groups(point, on_nodes)
    free = [*within, *(g.effect for g in on_nodes)]
    size = np.concatenate([[p.prior for p in g.effect.parameters] for g in groups])
    own = fit.prior(model.free, frozenset(causes))
    start, zeros = len(own.sigma), np.zeros(len(size))
    prior = Prior(np.concatenate([own.sigma, BAND * size]), np.concatenate([own.mean, zeros]))
    # 3. At each latent acceleration: gain of each group at its best scale; support and mimics of the causes.
    best, before = np.full(len(groups), -np.inf), -np.inf
    akin: dict[str, frozenset[str]] = {}
    support: dict[str, float] = {}
    where = parameter_slices(model.free)
    for noise in latent_scales(model.noise):
        reduced = fit.reduced(point, free, noise)
        log_evidence, posterior = reduced.evidence(prior), reduced.posterior(prior)
        for i, at in enumerate(_at(groups, start)):
            wide = size[at.start - start : at.stop - start]
            tried = [posterior.under_prior(at, Prior.zero_mean(scale * wide))[0] for scale in SCALES]
            gain = max(tried) - np.log(len(SCALES))
            best[i] = max(best[i], log_evidence + gain)
        if log_evidence > before:
            before = log_evidence
            support = {id_: -posterior.nats_if_absent(where[id_]) for id_ in causes}
        akin = akin or {id_: _akin(reduced, where[id_], groups, start) for id_ in causes}
    order = np.argsort(-best)
    return GroupEvidence(
        tuple((groups[i].named(), float(best[i] - before)) for i in order), before, akin, support, masking.limit
    )


def _at(groups: Sequence[FunctionGroup], start: int) -> list[slice]:
    """Slice of the parameters of each group in the stacked vector, groups beginning at `start`."""
    ends = start + np.cumsum([len(g.effect.parameters) for g in groups])
    return [slice(int(end) - len(g.effect.parameters), int(end)) for g, end in zip(groups, ends, strict=True)]


def _akin(reduced: ReducedNormalEquations, cause: slice, groups: Sequence[FunctionGroup], start: int) -> frozenset[str]:
    """Ids of groups that explain the share `AKIN` of the signature of the cause at `cause`.

    With values w and information H, a group of prior precision L mimics w^T H_cg (H_gg + L)^-1 H_gc w of w^T H_cc w.
    """
    values = reduced.theta0[cause]
    whole = float(values @ reduced.H[cause, cause] @ values)
    mimics = []
    for group, at in zip(groups, _at(groups, start), strict=True):
        wide = np.array([MIMIC * p.prior for p in group.effect.parameters])
        cross = reduced.H[at, cause] @ values
        if cross @ np.linalg.solve(reduced.H[at, at] + np.diag(1 / wide**2), cross) >= AKIN * whole:
            mimics.append(group.effect.id)
    return frozenset(mimics)


def checks(evidence: GroupEvidence, model: CandidateModel, ambient: Noise | None) -> tuple[Check, ...]:
    """The best group of every word in `depends_on`, which decide; then checks for information."""
    best: dict[str, tuple[FunctionGroup, float]] = {}
    for group, nats in evidence.nats:
        best.setdefault(group.words[0].partition(":")[0], (group, nats))
    out = [
        Check(name=f"{group.effect.equation} [nats]", value=nats, limit=evidence.limit, passed=nats < evidence.limit)
        for group, nats in best.values()
    ]
    alike = {k: v for k, v in autocorrelation(model.point).items() if np.isfinite(v).all()}
    said = [(f"correlation of residuals, {k}", float(np.abs(v[:3]).max()), WHITE) for k, v in alike.items()]
    point = model.point
    for name, values in (("inertial", point.residuals), ("position", point.fix_residuals)):
        known = np.clip(values[np.isfinite(values)], -5, 5)
        if len(known):
            said.append((f"rms of {name} residuals, over one sigma", float(np.sqrt(np.mean(known**2))), UNIT))
    if ambient is not None:
        ratio = np.max(np.array(model.noise.latent) / np.maximum(np.array(ambient.latent), FLOOR))
        said.append(("latent acceleration over that of the reference log", float(ratio), AMBIENT))
    out += [Check(name=n, value=v, limit=limit, passed=v <= limit, decides=False) for n, v, limit in said]
    return tuple(out)


def adequacy(
    fit: PosteriorFit, selection: Selection, ambient: Noise | None, masking: Masking = NO_MASKING, known: bool = False
) -> AdequacyJudgement:
    """Check the final model of `selection`, and which of its causes may be named.

    1. A cause is withdrawn that has less than `LEAST_EVIDENCE_NATS` while the groups are free within their bands.
    2. All are withdrawn where one group, beside the base alone, explains more and is akin to none (they stood in for
       it), or where there are `MANY` causes and one group explains about as much (within `RIVAL_NATS`).
    3. The groups that remain significant, and outlying fixes, fail the check.

    `ambient`: noise of the reference log, if any; `masking`: masked groups; `known`: no cause is withdrawn.
    """
    model, causes = selection.final, [c.id for c in selection.causes]
    evidence = group_evidence(fit, model, causes, masking)
    withdrawn = {id_ for id_, nats in evidence.support.items() if nats < LEAST_EVIDENCE_NATS and not known}
    causes = [id_ for id_ in causes if id_ not in withdrawn]
    if withdrawn:
        model = model if causes else selection.base
        evidence = group_evidence(fit, model, causes, masking)
    first, outdone = evidence, frozenset()
    if causes and (evidence.significant or len(causes) >= MANY):
        first = group_evidence(fit, selection.base, [], masking)
        if not known and _stand_in(causes, evidence, first):
            outdone = frozenset(causes)
            withdrawn, causes, evidence, model = withdrawn | outdone, [], first, selection.base
    checked, variables = checks(evidence, model, ambient), depends_on(evidence, first)
    if not masking.outliers:
        out = outlier_check(model.point)
        checked, variables = (
            (out, *checked),
            variables if out.passed else tuple(dict.fromkeys((*variables, "position"))),
        )
    report = Adequacy(passed=not any(c.decides and not c.passed for c in checked), checks=checked, depends_on=variables)
    doubtful = frozenset(id_ for id_ in causes if evidence.is_akin(id_, evidence.significant))
    return AdequacyJudgement(report, doubtful, frozenset(withdrawn), outdone)


def _stand_in(causes: Sequence[str], evidence: GroupEvidence, first: GroupEvidence) -> bool:
    """Whether `causes` stand in for the best group beside the base alone (`first`); `evidence`: with them."""
    group, nats = first.nats[0]
    alone = first.evidence + nats - evidence.evidence
    akin = any(evidence.is_akin(id_, [group]) for id_ in causes)
    return (alone >= DECISIVE_NATS and not akin) or (alone > -RIVAL_NATS and len(causes) >= MANY)


def outlier_check(point: LinearisationPoint) -> Check:
    """Check of the share of fixes beyond `FAR_OUT` sigma, as without line of sight."""
    size = np.linalg.norm(point.fix_residuals, axis=1)
    share = float(np.mean(size[np.isfinite(size)] > FAR_OUT)) if np.isfinite(size).any() else 0.0
    return Check(name=f"share of fixes beyond {FAR_OUT:g} sigma", value=share, limit=OFTEN, passed=share < OFTEN)


def depends_on(evidence: GroupEvidence, first: GroupEvidence) -> tuple[str, ...]:
    """Words of the significant groups of `evidence`, ordered by their nats beside the base alone (`first`)."""
    nats = {group.effect.id: value for group, value in first.nats}
    groups = sorted(evidence.significant, key=lambda group: -nats.get(group.effect.id, -np.inf))
    return tuple(dict.fromkeys(word for group in groups for word in group.words))
