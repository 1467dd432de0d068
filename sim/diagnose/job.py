"""One diagnosis from logs to findings: what the simulation gets wrong, why, and what is gained by mending it.

    split -> noise of the reference log -> base refitted, causes by evidence -> what is left over -> files
          -> held-out logs, by which causes that do harm are taken back -> verdict

No file or random source here: logs are Runs, the seed is an argument, `clock` tells how long it took.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.vessel_file import VesselFile
from sim.diagnose import findings as record
from sim.diagnose.adequacy import Judgement, adequacy
from sim.diagnose.catalogue import catalogue, unaware
from sim.diagnose.clock import Clock
from sim.diagnose.echoes import SILENCE, Echoes
from sim.diagnose.effect import Effect
from sim.diagnose.fit import Fit
from sim.diagnose.held_out import Believed, HeldOutScore, score
from sim.diagnose.linear import Point
from sim.diagnose.mended import Files, Named, cause_of, mend, place, refit
from sim.diagnose.mistaken import refuse_mistaken
from sim.diagnose.noise import stated_noise
from sim.diagnose.pauses import pieces, unbroken, without_pauses
from sim.diagnose.physics import Physics
from sim.diagnose.public import public, smallest
from sim.diagnose.search import Found, search
from sim.diagnose.select import Model, Selection, Selector
from sim.diagnose.spread import spread
from sim.diagnose.told_apart import ToldApart, told_apart
from sim.diagnose.visible import visible_from
from sim.identify.job_split import Log, Split, split, usable
from sim.identify.problems import problems
from sim.identify.run import Problem, Run
from sim.identify.structured.data import fixes_of
from sim.identify.structured.noise import Noise

STEPS = ("reference", "base and causes", "files", "held-out logs")
"""What `diagnose` says it is at, in this order; shares run from 0 to 1 within each."""
WINDOW_S = 1.0
TOLD_S = 10  # horizon by which causes are judged on held-out logs
FORM_DOUBT = 0.1
"""Of the smallest size worth a name, one sigma: no entry is quite of the form of the world: docs/diagnose.md."""
UNNEEDED = "small faults of other kinds, together, explain the same"
OUTDONE = "one kind of function of another nature explains more than all causes together, or as much as three"
FALLEN = "beside the causes that are left it is not sure, or not large, enough"
HARMFUL = "it makes the readings of the held-out logs worse"
Say = Callable[[str, str, float], None]
"""Step, what of it, share of it that is done."""
Effects = Callable[[VesselFile], Sequence[Effect]]
"""A user's own entries for a boat: `effects` of the file that `--catalogue` names."""
Adequate = Callable[[Fit, Selection, Noise | None, Echoes, bool], Judgement]
"""What is left over and which causes can stand, from the fit, its end, the reference log's noise, and echoes."""


@dataclass(frozen=True)
class Data:
    """What of the logs is fitted and what is held out, in unbroken pieces. `clock`: of all logs."""

    split: Split
    fitted: list[Run]
    held_out: list[Run]
    clock: Clock


@dataclass(frozen=True)
class Verdict:
    """What is said of the causes. `confused`: by name of a cause, named or not, those that it cannot be told from.

    `withdrawn`: by name of those that were found and then taken back, why.
    """

    selection: Selection
    causes: tuple[Named, ...]
    verdict: record.Verdict
    confused: dict[str, tuple[str, ...]]
    adequacy: record.Adequacy | None
    withdrawn: dict[str, str]


@dataclass(frozen=True)
class Diagnosis:
    """Everything. `refit`: the base with coefficients and gains only, against which gain is counted.

    `refit_point`: where it stands on the fitted logs; `ambient`: noise of the reference log; `confused`: see `Verdict`.
    """

    base: VesselFile
    split: Split
    fit: Fit
    selection: Selection
    refit: Believed
    refit_point: Point
    ambient: Noise | None
    reference: str
    causes: tuple[Named, ...]
    verdict: record.Verdict
    confused: dict[str, tuple[str, ...]]
    withdrawn: dict[str, str]
    adequacy: record.Adequacy | None
    identifiability: ToldApart | None
    files: Files
    held_out: HeldOutScore
    visible: dict[str, tuple[float, str]]
    problems: dict[str, list[Problem]]
    seed: int
    runtime_s: float

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """All that one of the causes cannot be told from."""
        return tuple(dict.fromkeys(other for others in self.confused.values() for other in others))


def diagnose(
    runs: Sequence[Run],
    vessel: VesselFile,
    *,
    reference: Run | None = None,
    held_out: Sequence[Run] = (),
    block_s: float | None = None,
    more: Effects = lambda _vessel: (),
    without: Sequence[str] = (),
    known: Sequence[str] = (),
    adequacy: Adequate | None = adequacy,
    identifiability: Callable[[Fit, Selection], ToldApart] | None = told_apart,
    say: Say = lambda _step, _text, _share: None,
    seed: int = 0,
    clock: Callable[[], float] = lambda: 0.0,
) -> Diagnosis:
    """What `vessel` gets wrong of the logs `runs`. `reference`: a calm log of the boat before anything was wrong.

    `held_out`: logs that no fit shall see; without any the last quarter of each log, or every other block of `block_s`.
    `without`: names of effects, or their heads, that the catalogue shall not know. `known`: names of the causes that
    are there for sure: how large they are is found, no others are looked for. `clock`: seconds. Raises JobError,
    RunError or StructuredFitError (all ValueError) naming the log that cannot be used.
    """
    begun = clock()
    data = _data(runs, held_out, vessel, block_s)
    ambient = _ambient(reference, vessel, say) if reference is not None else None
    entries = unaware(catalogue(vessel, data.fitted, tuple(more(vessel)), data.clock), without)
    fit = Fit(Physics(data.fitted, vessel, WINDOW_S, data.clock), entries, _stated(vessel, data.fitted, ambient))
    found = search(fit, without, known, lambda text, share: say(STEPS[1], text, min(share, 0.99)))
    say(STEPS[1], "", 1.0)
    say(STEPS[2], "refitted base", 0.0)
    plain, standing = refit(fit, found.selection.base)
    verdict = _verdict(fit, found, ambient, adequacy, seed, bool(known))
    mended = mend(fit, plain, verdict.selection.final, verdict.causes)
    say(STEPS[2], "", 1.0)
    say(STEPS[3], "", 0.0)
    believed = {"base": Believed({}, found.selection.base.noise), "refit": plain, "extended": mended.extended}
    judged = score(data.held_out, vessel, fit.effects, believed, fit.physics, seed)
    if verdict.causes and not known and _harmful(judged):
        verdict = _taken_back(fit, verdict, ambient, adequacy)
        mended = mend(fit, plain, verdict.selection.final, ())
        judged = score(data.held_out, vessel, fit.effects, believed | {"extended": plain}, fit.physics, seed)
    apart = identifiability(fit, verdict.selection) if identifiability else None
    say(STEPS[3], "", 1.0)
    return Diagnosis(
        base=vessel,
        split=data.split,
        fit=fit,
        selection=verdict.selection,
        refit=plain,
        refit_point=standing,
        ambient=ambient,
        reference=reference.meta.source if reference is not None else "",
        causes=verdict.causes,
        verdict=verdict.verdict,
        confused=verdict.confused,
        withdrawn=verdict.withdrawn,
        adequacy=verdict.adequacy,
        identifiability=apart,
        files=mended.files,
        held_out=judged,
        visible=visible_from(fit, verdict.selection.final),
        problems={used.log.name: problems(used.log.run) for used in data.split.used},
        seed=seed,
        runtime_s=clock() - begun,
    )


def _data(runs: Sequence[Run], held_out: Sequence[Run], vessel: VesselFile, block_s: float | None) -> Data:
    whole = without_pauses(split(_logs(runs), _logs(held_out), vessel, block_s))
    parted, clock = spread(whole), Clock.of(whole.fitted, [part.run for part in whole.held_out])
    for used in parted.used:
        refuse_mistaken(used.log.run)
    outside = [run for out in parted.held_out for run in (pieces(out.run, out.inside) if out.inside else [out.run])]
    for run in outside:
        fixes_of(run)  # they are looked at last, after a long search
    return Data(parted, list(parted.fitted), outside, clock)


def _logs(runs: Sequence[Run]) -> list[Log]:
    return [Log(run.meta.source, run) for run in runs]


def _ambient(reference: Run, vessel: VesselFile, say: Say) -> Noise:
    """Noise of sensors and of what nobody can foretell, from a log in which nothing is wrong."""
    say(STEPS[0], reference.meta.source, 0.0)
    run = usable(Log(reference.meta.source, reference), vessel).run
    refuse_mistaken(run)
    calm = unbroken(run)
    everyday = [e for e in catalogue(vessel, calm) if e.everyday]
    model = Selector(Fit(Physics(calm, vessel, WINDOW_S), everyday, stated_noise(vessel, calm))).base()
    say(STEPS[0], "", 1.0)
    return model.noise


def _stated(vessel: VesselFile, runs: Sequence[Run], ambient: Noise | None) -> Noise:
    """Noise to begin with: the file's, or the reference log's."""
    noise = stated_noise(vessel, runs)
    return noise if ambient is None else replace(noise, white=ambient.white, fix_m=ambient.fix_m)


def _verdict(
    fit: Fit, found: Found, ambient: Noise | None, adequate: Adequate | None, seed: int, known: bool
) -> Verdict:
    """Of the fitted logs: which causes can stand, whether they are told from others, whether anything is left over.

    `known`: the causes are there, and none of them is taken back.
    """
    withdrawn: dict[str, str] = {}
    doubtful: frozenset[str] = frozenset()
    left: record.Adequacy | None = None
    if adequate:
        sound, found, withdrawn = _standing(fit, found, ambient, adequate, known)
        doubtful, left = sound.doubtful, sound.adequacy
    named = [replace(n, form_doubtful=n.form_doubtful or n.fitted in doubtful) for n in _named(fit, found, seed)]
    same = {n.effect.name: n.effect.same_as for n in named}
    verdict, names, confused = record.verdict_of(list(same), found.rivals(fit), same, left)
    causes = tuple(n for n in named if n.effect.name in names)
    return Verdict(found.selection, causes, verdict, confused, left, withdrawn)


def _standing(
    fit: Fit, found: Found, ambient: Noise | None, adequate: Adequate, known: bool
) -> tuple[Judgement, Found, dict[str, str]]:
    """What is left over, the causes that can stand, and by name why the others are taken back.

    Judged anew where it was judged beside a cause that fell with them, or by the echoes of one that is gone.
    """
    withdrawn: dict[str, str] = {}
    while True:
        before, echoes = found, Echoes.of(c.effect.name for c in found.causes)
        sound = adequate(fit, found.selection, ambient, echoes, known)
        if not sound.withdrawn:
            return sound, found, withdrawn
        found = before.without(fit, sound.withdrawn)
        names = {c.effect.name for c in found.causes}
        why = {id_: OUTDONE if id_ in sound.outdone else UNNEEDED for id_ in sound.withdrawn}
        gone = {c.effect.name: why.get(c.fitted, FALLEN) for c in before.causes if c.effect.name not in names}
        withdrawn |= gone
        if FALLEN not in gone.values() and Echoes.of(names) == echoes:
            return sound, found, withdrawn


def _taken_back(fit: Fit, verdict: Verdict, ambient: Noise | None, adequate: Adequate | None) -> Verdict:
    """Without any of the causes, for they do harm: unknown, and what the base leaves over."""
    withdrawn = verdict.withdrawn | {n.effect.name: HARMFUL for n in verdict.causes}
    selection = Selector(fit).without(verdict.selection, {c.id for c in verdict.selection.causes})
    left = adequate(fit, selection, ambient, SILENCE, False).adequacy if adequate else None
    return Verdict(selection, (), "unknown", {}, left, withdrawn)


def _harmful(judged: HeldOutScore) -> bool:
    """Whether the causes make held-out readings worse, surely, and none of them surely better: then they are wrong."""
    told = [e for e in judged.errors if e.horizon_s == TOLD_S]
    worse = any(e.channel == "position" and e.gain_ci95[1] < 0 for e in told)
    return worse and not any(e.gain_ci95[0] > 0 for e in told)


def _named(fit: Fit, found: Found, seed: int) -> tuple[Named, ...]:
    """Accepted causes, the surest first."""
    out = []
    for one in found.causes:
        effect, candidate = one.effect, one.candidate
        numbers = public(effect, candidate.values, _doubted(effect, candidate.covariance), place(fit), seed)
        told = ", ".join(f"{k} {n.value:.4g}" for k, n in numbers.items())
        note = f"{effect.name}{f' ({told})' if told else ''} found by aritra diagnose"
        cause = replace(cause_of(fit, effect, candidate.values, note), forces_n=_forces(found.selection.final))
        out.append(Named(candidate, effect, numbers, smallest(effect), cause, one.fitted, one.form_doubtful))
    return tuple(out)


def _doubted(effect: Effect, covariance: np.ndarray) -> np.ndarray:
    """`covariance` with the doubt that the entry's form is quite that of the world, which no log shows."""
    smallest_sizes = [p.smallest if np.isfinite(p.smallest) else 0.0 for p in effect.parameters]
    return covariance + np.diag((FORM_DOUBT * np.array(smallest_sizes)) ** 2)


def _forces(model: Model) -> np.ndarray:
    f = model.point.state.forces.f
    return f.reshape(-1, f.shape[2])
