"""Search for all causes of one set of logs: selection over the catalogue, and tests for stochastic causes.

1. base model   2. fixes without line of sight, which are down-weighted from here on   3. selection   4. waves, gusts
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.catalogue.sensors import WITH_THE_MOTION
from sim.fitting.diagnose.catalogue.stochastic import GUSTY_WIND, NLOS, WAVES, effects
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.selection.candidate_score import Candidate
from sim.fitting.diagnose.selection.greedy_selection import Progress, Selection, Selector
from sim.fitting.diagnose.stochastic_effects import StochasticCause, has_accelerations, nlos_cause, stochastic_causes


@dataclass(frozen=True)
class AcceptedCause:
    """One accepted cause. `fitted`: id of the entry that represents it in the fit (empty: none).

    `form_doubtful`: the family is right, the functional form is in doubt.
    """

    effect: Effect
    candidate: Candidate
    fitted: str
    form_doubtful: bool = False


@dataclass(frozen=True)
class SearchResult:
    """The selection, and all causes in order of evidence."""

    selection: Selection
    causes: tuple[AcceptedCause, ...]

    def rivals(self, fit: PosteriorFit) -> dict[str, list[tuple[str, float]]]:
        """By name of a cause, its rivals and how many nats each is behind. A part or whole of another cause is none."""
        called = {c.fitted: c.effect.name for c in self.causes if c.fitted}
        found: dict[str, list[tuple[str, float]]] = {}
        for fitted, rivals in self.selection.rivals.items():
            name = called.get(fitted, fitted)
            others = [c.effect for c in self.causes if c.effect.name != name]
            parts, wholes = {e.contains for e in others}, {e.name for e in others}
            present = parts | {e.name for e in fit.effects if e.contains in wholes}
            found[name] = [(called.get(rival, rival), behind) for rival, behind in rivals if rival not in present]
        return found

    def without(self, fit: PosteriorFit, gone: Collection[str]) -> SearchResult:
        """The result with the causes `gone` (ids of entries of the fit) withdrawn, and the others refitted."""
        selection = Selector(fit).without(self.selection, gone)
        now = {c.id: c for c in selection.causes}
        kept = [c for c in self.causes if not c.fitted or c.fitted in now]
        return SearchResult(selection, tuple(replace(c, candidate=now[c.fitted]) if c.effect.id == c.fitted else c
                                      for c in kept))  # fmt: skip


def search_causes(
    fit: PosteriorFit,
    without: Sequence[str] = (),
    known_causes: Sequence[str] = (),
    say: Progress = lambda _text, _share: None,
) -> SearchResult:
    """All causes that can be named from the logs of `fit`. `without`: names of stochastic causes not to test.

    `known_causes`: names of causes that are present for sure; no others are searched. ValueError for an unknown name,
    or for a cause that no sensor of these logs shows.
    """
    selector = Selector(fit, say)
    entry_names = _entries(fit, known_causes)
    base = selector.base()
    if not has_accelerations(base) and (
        blind := [name for name in known_causes if name in (WAVES.name, GUSTY_WIND.name)]
    ):
        raise ValueError(f"believe {blind[0]!r}: accelerations alone show it, and these logs have none")
    nlos = nlos_cause(fit, base) if NLOS.name not in without else None
    if nlos is not None and (nlos.candidate.accepted or NLOS.name in known_causes) and nlos.fix_weight is not None:
        fit.lineariser.weight = nlos.fix_weight
        base = selector.base(base.noise)
    selection = selector.fit_causes(base, entry_names) if known_causes else selector.run(base)
    say("waves, gusts, fixes without line of sight", 0.9)
    stochastic_found = [c for c in stochastic_causes(fit, selection.final, selection.causes, known_causes)
                 if c.effect.name not in without and (not known_causes or c.effect.name in known_causes)]  # fmt: skip
    return SearchResult(selection, _together(fit, selection, stochastic_found))


def _entries(fit: PosteriorFit, known_causes: Sequence[str]) -> list[str]:
    """Names of the fit's entries that represent `known_causes`: a gusty wind is a wind, waves have none."""
    present, chance = {e.name for e in fit.effects if e.family != "base"}, {e.name for e in effects()}
    if not fit.physics.levelled and (hidden := [name for name in known_causes if name in WITH_THE_MOTION]):
        raise ValueError(f"believe {hidden[0]!r}: only logs with roll and pitch, which these do not have, show it")
    if strange := [name for name in known_causes if name not in present | chance]:
        raise ValueError(f"believe {strange[0]!r}: no such effect; there are {', '.join(sorted(present | chance))}")
    for both in (e for e in fit.effects if e.contains and {e.name, e.contains} <= set(known_causes)):
        raise ValueError(f"believe {both.name!r} or {both.contains!r}, not both: the one contains the other")
    names = ["wind" if name == GUSTY_WIND.name else name for name in known_causes]
    return [name for name in dict.fromkeys(names) if name in present]


def _together(
    fit: PosteriorFit, selection: Selection, stochastic_found: Sequence[StochasticCause]
) -> tuple[AcceptedCause, ...]:
    by_id = {e.id: e for e in fit.effects}
    replaced = {c.replaces for c in stochastic_found if c.replaces}
    causes = [AcceptedCause(by_id[c.id], c, c.id) for c in selection.causes if c.id not in replaced]
    causes += [AcceptedCause(c.effect, c.candidate, c.replaces, c.form_doubtful) for c in stochastic_found]
    return tuple(sorted(causes, key=lambda c: -c.candidate.nats))
