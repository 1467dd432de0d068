"""Distinguishability of causes by the logs, as findings report it, and the manoeuvre to fly where it is poor."""

from __future__ import annotations

from dataclasses import dataclass

from companion.core.configuration.site_file import Site
from companion.core.excitation.file import Excitation, excitation_toml
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.report import findings as record
from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS, LEAST_EVIDENCE_NATS
from sim.fitting.diagnose.selection.greedy_selection import Selection
from sim.fitting.diagnose.selection.identifiability import MEDIUM, PairwiseEvidence, pairwise_evidence
from sim.fitting.diagnose.selection.manoeuvre import (
    ENOUGH,
    NOTHING,
    ConfusedPairs,
    ManoeuvrePlan,
    ManoeuvrePlanner,
    nats_needed,
)

ASKED = 12  # pairs for which a manoeuvre is looked for, worst first
SAID = 3  # pairs that no manoeuvre would tell apart, in the sentence
LISTED = 5  # pairs above the line that findings have all the same


@dataclass(frozen=True)
class Distinguishability:
    """Evidence of all pairs, the record for findings, and the manoeuvre if one was planned."""

    pairwise: PairwiseEvidence
    record: record.Identifiability
    plan: ManoeuvrePlan | None = None

    @property
    def file(self) -> str:
        """The manoeuvre as an excitation file; empty where there is none."""
        if self.plan is None or self.plan.excitation is None:
            return ""
        return excitation_toml(self.plan.excitation, f"By `aritra diagnose`.\n{self.record.manoeuvre}")


def distinguishability(
    fit: PosteriorFit,
    selection: Selection,
    *,
    library: Excitation | None = None,
    site: Site | None = None,
    always: bool = False,
) -> Distinguishability:
    """Pairwise evidence beside the causes of `selection`, at the final model's noise.

    A manoeuvre is planned from `library` for close pairs with a named cause; with `always` else for the worst other
    pairs, else for causes that the logs could not have shown. Planning takes some seconds.
    """
    final = selection.final
    assert final.reduced is not None
    evidence = pairwise_evidence(fit, final.reduced.H, final.active)
    pairs = _close_pairs(fit, selection, evidence)
    if always and not pairs:
        alone = zip(evidence.names, evidence.nothing, strict=True)
        pairs = evidence.confused or [(n, NOTHING, float(nats)) for n, nats in alone if nats < LEAST_EVIDENCE_NATS]
    plan = None
    if library is not None and pairs:
        plan = ManoeuvrePlanner(fit, final.reduced.H, final.active, final.noise, site).plan(library, pairs[:ASKED])
    return Distinguishability(evidence, _record(evidence, plan), plan)


def _close_pairs(fit: PosteriorFit, selection: Selection, evidence: PairwiseEvidence) -> list[tuple[str, str, float]]:
    """Pairs of a named cause and a rival that the logs do not separate, rivals of the selection first.

    Nats grow with the square of the size: a cause larger than `MEDIUM` is separated by more than the medium one.
    """
    names = {e.id: e.name for e in fit.effects}
    size = {names[c.id]: c.size for c in selection.causes}
    near = {(a, b) for a, rivals in selection.rivals.items() for b, behind in rivals if behind < record.RIVAL_NATS}
    pairs = [p for p in evidence.pairs() if p[0] in size]
    close = [p for p in pairs if p[:2] in near and p[2] < ENOUGH]
    return close + [
        p
        for p in pairs
        if p[2] < DECISIVE_NATS and p[2] * (size[p[0]] / MEDIUM) ** 2 < DECISIVE_NATS and p not in close
    ]


def _record(evidence: PairwiseEvidence, plan: ManoeuvrePlan | None) -> record.Identifiability:
    shown = {n for n, nats in zip(evidence.names, evidence.nothing, strict=True) if nats >= DECISIVE_NATS}
    others = [p for p in evidence.pairs() if p[0] in shown and p[2] >= DECISIVE_NATS][:LISTED]
    return record.Identifiability(
        pairs=tuple(record.Pair(a=a, b=b, nats=nats) for a, b, nats in (*evidence.confused, *others)),
        nothing={n: float(nats) for n, nats in zip(evidence.names, evidence.nothing, strict=True)},
        manoeuvre=manoeuvre_sentence(plan) if plan is not None else "",
        manoeuvre_file=record.MANOEUVRE if plan is not None and plan.excitation is not None else "",
        manoeuvre_pairs=tuple(record.Pair(a=a, b=b, nats=nats) for a, b, _, nats in plan.pairs) if plan else (),
    )


def manoeuvre_sentence(plan: ManoeuvrePlan) -> str:
    """Sentence for findings: pairs that these logs cannot separate, the manoeuvre that would, pairs that none would."""
    separated = [p for p in plan.pairs if p[3] >= nats_needed(p[1])]
    sentences = []
    if separated and plan.excitation is not None:
        what = ", ".join(dict.fromkeys(s.name for s in plan.excitation.segments))
        least = min(p[3] for p in separated)
        sentences.append(
            f"These logs {_cannot([p[:3] for p in separated])}; {plan.duration_s:.0f} s of {what} would "
            f"(estimated {'at least ' if len(separated) > 1 else ''}{least:.0f} nats): {record.MANOEUVRE}."
        )
    failed = [*plan.unreachable, *(p for p in plan.pairs if p[3] < nats_needed(p[1]))]
    if failed:
        most, pairs = max(0.0, *(p[3] for p in failed)), " nor ".join(_tell(a, b) for a, b, _, _ in failed[:SAID])
        sentences.append(f"No manoeuvre of the library would {pairs} (at most {int(most)} nats).")
    return " ".join(sentences)


def _cannot(pairs: ConfusedPairs) -> str:
    return "cannot " + " nor ".join(f"{_tell(a, b)} ({max(nats, 0):.0f} nats)" for a, b, nats in pairs)


def _tell(a: str, b: str) -> str:
    return f"tell {a} from {b}" if b != NOTHING else f"show {a} of medium size"
