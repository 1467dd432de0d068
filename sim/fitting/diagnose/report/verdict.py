"""Verdict: which causes the adequacy check supports, and whether held-out readings refute them."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.report import findings as record
from sim.fitting.diagnose.selection.adequacy import AdequacyJudgement
from sim.fitting.diagnose.selection.greedy_selection import Selection, Selector
from sim.fitting.diagnose.selection.held_out import JUDGED_S, HeldOutScore
from sim.fitting.diagnose.selection.masking import NO_MASKING, Masking
from sim.fitting.diagnose.selection.search import SearchResult
from sim.fitting.diagnose.vessel_edits.public_form import public_form, smallest_size
from sim.fitting.diagnose.vessel_edits.refitted_vessel import ReportedCause, cause_of, log_reference
from sim.fitting.engine.noise import Noise

FORM_DOUBT = 0.1
"""Sigma of a cause's form error over the smallest size worth a name: docs/diagnose.md."""
UNNEEDED = "small faults of other kinds, together, explain the same"
OUTDONE = "one kind of function of another nature explains more than all causes together, or as much as three"
FALLEN = "too small, or too unsure, beside the causes that are left"
HARMFUL = "readings of the held-out logs become worse"
UNPROVEN = "what is left over puts a form in doubt, and no reading of the held-out logs becomes surely better"
UNSUPPORTED = "no reading of the held-out logs is surely foretold better with it"
Adequate = Callable[[PosteriorFit, Selection, Noise | None, Masking, bool], AdequacyJudgement]
"""Adequacy check: of the fit, the selection, the reference log's noise, the masking, whether causes are known."""


@dataclass(frozen=True)
class DiagnosisVerdict:
    """Verdict on the causes of a selection.

    causes       those that are named
    confused     by name of a cause, named or not, its rivals within `RIVAL_NATS`
    withdrawn    by name of a withdrawn cause, the reason
    """

    selection: Selection
    causes: tuple[ReportedCause, ...]
    verdict: record.Verdict
    confused: dict[str, tuple[str, ...]]
    adequacy: record.Adequacy | None
    withdrawn: dict[str, str]


def conclude(
    fit: PosteriorFit, result: SearchResult, ambient: Noise | None, adequate: Adequate | None, seed: int, known: bool
) -> DiagnosisVerdict:
    """Verdict from the fitted logs: supported causes, their rivals, adequacy. `known`: no cause is withdrawn.

    `ambient`: noise of the reference log, if any; `adequate` None: no adequacy check; `seed`: of intervals.
    """
    withdrawn: dict[str, str] = {}
    doubtful: frozenset[str] = frozenset()
    adequacy_record: record.Adequacy | None = None
    if adequate:
        judgement, result, withdrawn = withdraw_unsupported(fit, result, ambient, adequate, known)
        doubtful, adequacy_record = judgement.doubtful, judgement.adequacy
    named = [replace(n, form_doubtful=n.form_doubtful or n.fitted in doubtful) for n in _reported(fit, result, seed)]
    same = {n.effect.name: n.effect.same_as for n in named}
    verdict, names, confused = record.verdict_of(list(same), result.rivals(fit), same, adequacy_record)
    causes = tuple(n for n in named if n.effect.name in names)
    return DiagnosisVerdict(result.selection, causes, verdict, confused, adequacy_record, withdrawn)


def withdraw_unsupported(
    fit: PosteriorFit, result: SearchResult, ambient: Noise | None, adequate: Adequate, known: bool
) -> tuple[AdequacyJudgement, SearchResult, dict[str, str]]:
    """Adequacy judgement, the result without withdrawn causes, and by name of these the reason.

    Repeated while the judgement was made beside a cause that has since fallen, or with the masking of one.
    """
    withdrawn: dict[str, str] = {}
    while True:
        before, masking = result, Masking.of(c.effect.name for c in result.causes)
        judgement = adequate(fit, result.selection, ambient, masking, known)
        if not judgement.withdrawn:
            return judgement, result, withdrawn
        result = before.without(fit, judgement.withdrawn)
        names = {c.effect.name for c in result.causes}
        why = {id_: OUTDONE if id_ in judgement.outdone else UNNEEDED for id_ in judgement.withdrawn}
        gone = {c.effect.name: why.get(c.fitted, FALLEN) for c in before.causes if c.effect.name not in names}
        withdrawn |= gone
        if FALLEN not in gone.values() and Masking.of(names) == masking:
            return judgement, result, withdrawn


def without_some(
    fit: PosteriorFit,
    result: SearchResult,
    verdict: DiagnosisVerdict,
    gone: Collection[str],
    ambient: Noise | None,
    adequate: Adequate | None,
    seed: int,
) -> DiagnosisVerdict:
    """`verdict` of `result` concluded anew without the causes `gone` (ids): held-out readings do not support them."""
    left = {c.id for c in verdict.selection.causes} - set(gone)
    others = {c.id for c in result.selection.causes} - left
    names = {c.effect.name for c in result.causes if c.fitted in gone}
    again = conclude(fit, result.without(fit, others), ambient, adequate, seed, False)
    return replace(again, withdrawn=verdict.withdrawn | dict.fromkeys(sorted(names), UNSUPPORTED) | again.withdrawn)


def without_causes(
    fit: PosteriorFit, verdict: DiagnosisVerdict, why: str, ambient: Noise | None, adequate: Adequate | None
) -> DiagnosisVerdict:
    """`verdict` with all causes withdrawn for the reason `why`: unknown, with the adequacy of the base."""
    withdrawn = verdict.withdrawn | {n.effect.name: why for n in verdict.causes}
    selection = Selector(fit).without(verdict.selection, {c.id for c in verdict.selection.causes})
    adequacy_record = adequate(fit, selection, ambient, NO_MASKING, False).adequacy if adequate else None
    return DiagnosisVerdict(selection, (), "unknown", {}, adequacy_record, withdrawn)


def held_out_objection(verdict: DiagnosisVerdict, held_out_score: HeldOutScore) -> str:
    """Reason to withdraw all causes by the held-out score, or empty.

    1. Any reading surely better (95 %) at `JUDGED_S`: none.
    2. Positions surely worse: `HARMFUL`.
    3. A systematic residual and a cause of doubtful form: `UNPROVEN`, since evidence in nats presumes the forms.
    """
    at_horizon = [e for e in held_out_score.errors if e.horizon_s == JUDGED_S]
    if any(e.gain_ci95[0] > 0 for e in at_horizon):
        return ""
    if any(e.channel == "position" and e.gain_ci95[1] < 0 for e in at_horizon):
        return HARMFUL
    predictable = all(n.fitted for n in verdict.causes)  # what chance does next no reading tells
    doubted = verdict.verdict == "partial" and any(n.form_doubtful for n in verdict.causes)
    return UNPROVEN if doubted and predictable else ""


def _reported(fit: PosteriorFit, result: SearchResult, seed: int) -> tuple[ReportedCause, ...]:
    """The accepted causes with public numbers, in order of evidence."""
    out = []
    for one in result.causes:
        effect, candidate = one.effect, one.candidate
        numbers = public_form(
            effect, candidate.values, _with_form_doubt(effect, candidate.covariance), log_reference(fit), seed
        )
        values = ", ".join(f"{k} {n.value:.4g}" for k, n in numbers.items())
        note = f"{effect.name}{f' ({values})' if values else ''} found by aritra diagnose"
        cause = cause_of(fit, effect, candidate.values, note)
        out.append(
            ReportedCause(candidate, effect, numbers, smallest_size(effect), cause, one.fitted, one.form_doubtful)
        )
    return tuple(out)


def _with_form_doubt(effect: Effect, covariance: np.ndarray) -> np.ndarray:
    """`covariance` plus the variance of the form error, `FORM_DOUBT` times the smallest sizes."""
    smallest_sizes = [p.smallest if np.isfinite(p.smallest) else 0.0 for p in effect.parameters]
    return covariance + np.diag((FORM_DOUBT * np.array(smallest_sizes)) ** 2)
