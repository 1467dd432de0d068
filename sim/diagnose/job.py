"""One diagnosis from logs to findings: what the simulation gets wrong, why, and what is gained by mending it.

    split -> noise of the reference log -> base refitted, causes by evidence -> files -> held-out logs -> verdict

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
from sim.diagnose.effect import Effect
from sim.diagnose.extend import FOLDED, numbers_beside, refitted, trusted, with_causes
from sim.diagnose.fit import Fit
from sim.diagnose.held_out import Believed, HeldOutScore, score
from sim.diagnose.linear import Point
from sim.diagnose.mistaken import refuse_mistaken
from sim.diagnose.noise import tuned_latent
from sim.diagnose.pauses import unbroken
from sim.diagnose.physics import Physics, Theta
from sim.diagnose.places import Cause
from sim.diagnose.public import Place, Told, family, point, public, smallest
from sim.diagnose.search import Found, search
from sim.diagnose.select import Candidate, Model, Selection, Selector, stated_noise
from sim.diagnose.stochastic import ECHOES
from sim.diagnose.told_apart import ToldApart, told_apart
from sim.diagnose.visible import visible_from
from sim.identify.blocks import parts
from sim.identify.job_split import Log, Split, split, usable
from sim.identify.problems import problems
from sim.identify.run import Problem, Run
from sim.identify.structured.noise import Noise

STEPS = ("reference", "base and causes", "files", "held-out logs")
"""What `diagnose` says it is at, in this order; shares run from 0 to 1 within each."""
WINDOW_S = 1.0
TOLD_S = 10  # horizon by which causes are judged on held-out logs
OF_THE_DAY = ("sensors", "environment")
REFIT_SIGMAS = 2.0  # of a tolerance band: a gain may then reach the smallest size worth a name, and no more
Say = Callable[[str, str, float], None]
"""Step, what of it, share of it that is done."""
Effects = Callable[[VesselFile], Sequence[Effect]]
"""A user's own entries for a boat: `effects` of the file that `--catalogue` names."""
Adequate = Callable[[Fit, Selection, Noise | None, Sequence[str]], Judgement]
"""What is left over and which causes can stand, from the fit, its end, the reference log's noise, and echoes."""


@dataclass(frozen=True)
class Named:
    """A cause in public: what is said of it, its size over the smallest worth a name, its values for the files.

    `fitted`: id of the entry by which the fit has it (empty: none). `form_doubtful`: see `Cause` of `search`.
    """

    candidate: Candidate
    effect: Effect
    numbers: dict[str, Told]
    smallest: tuple[float, str]
    cause: Cause
    fitted: str
    form_doubtful: bool = False


@dataclass(frozen=True)
class Files:
    """Vessel files: refitted without causes, numbers beside the causes, with the causes; what has no place in one."""

    refitted: VesselFile
    numbers: VesselFile
    extended: VesselFile
    left: dict[str, str]


@dataclass(frozen=True)
class Diagnosis:
    """Everything. `refit`: the base with coefficients and gains only, against which gain is counted.

    `refit_point`: where it stands on the fitted logs; `ambient`: noise of the reference log.
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
    ambiguous_with: tuple[str, ...]
    adequacy: record.Adequacy | None
    identifiability: ToldApart | None
    files: Files
    held_out: HeldOutScore
    visible: dict[str, tuple[float, str]]
    problems: dict[str, list[Problem]]
    seed: int
    runtime_s: float


def diagnose(
    runs: Sequence[Run],
    vessel: VesselFile,
    *,
    reference: Run | None = None,
    held_out: Sequence[Run] = (),
    block_s: float | None = None,
    more: Effects = lambda _vessel: (),
    without: Sequence[str] = (),
    adequacy: Adequate | None = adequacy,
    identifiability: Callable[[Fit, Selection], ToldApart] | None = told_apart,
    say: Say = lambda _step, _text, _share: None,
    seed: int = 0,
    clock: Callable[[], float] = lambda: 0.0,
) -> Diagnosis:
    """What `vessel` gets wrong of the logs `runs`. `reference`: a calm log of the boat before anything was wrong.

    `held_out`: logs that no fit shall see; without any the last quarter of each log, or every other block of `block_s`.
    `without`: names of effects, or their heads, that the catalogue shall not know. `clock`: seconds, for the running
    time. Raises JobError, RunError or StructuredFitError (all ValueError) naming the log that cannot be used.
    """
    begun = clock()
    parted = split(_logs(runs), _logs(held_out), vessel, block_s)
    for used in parted.used:
        refuse_mistaken(used.log.run)
    fitted = [piece for run in parted.fitted for piece in unbroken(run)]
    outside = [run for part in parted.held_out for run in (parts(part.run, part.inside) if part.inside else [part.run])]
    outside = [piece for run in outside for piece in unbroken(run)]
    own = tuple(more(vessel))
    ambient = _ambient(reference, vessel, say) if reference is not None else None
    entries = unaware(catalogue(vessel, fitted, own), without)
    fit = Fit(Physics(fitted, vessel, WINDOW_S), entries, _stated(vessel, ambient))
    everything = search(fit, without, lambda text, share: say(STEPS[1], text, min(share, 0.99)))
    selection = everything.selection
    say(STEPS[1], "", 1.0)
    say(STEPS[2], "refitted base", 0.0)
    refit, standing = _refit(fit, selection.base)
    found = _named(fit, everything, seed)
    echoes = [echo for one in everything.causes for echo in ECHOES.get(one.effect.name, ())]
    sound = adequacy(fit, selection, ambient, echoes) if adequacy else None
    if sound is not None:
        found = tuple(replace(n, form_doubtful=n.form_doubtful or n.fitted in sound.doubtful) for n in found
                      if n.fitted not in sound.withdrawn)  # fmt: skip
    sufficient = sound.adequacy if sound is not None else None
    apart = identifiability(fit, selection) if identifiability else None
    same = {n.effect.name: n.effect.same_as for n in found}
    verdict, names, others = record.verdict_of(list(same), selection.rivals, same, sufficient)
    causes = tuple(n for n in found if n.effect.name in names)
    theta = _beside(fit, selection, causes) if causes else refit.theta
    files = _files(fit, refit, theta, causes, selection.final.noise)
    say(STEPS[2], "", 1.0)
    say(STEPS[3], "", 0.0)
    models = {
        "base": Believed({}, selection.base.noise),
        "refit": refit,
        "extended": _sayable(fit, selection, theta, causes) if causes else refit,
    }
    judged = score(outside, vessel, fit.effects, models, fit.physics, seed)
    if causes and _harmful(judged):
        verdict, causes, files = "unknown", (), _files(fit, refit, refit.theta, (), selection.final.noise)
    say(STEPS[3], "", 1.0)
    return Diagnosis(
        base=vessel,
        split=parted,
        fit=fit,
        selection=selection,
        refit=refit,
        refit_point=standing,
        ambient=ambient,
        reference=reference.meta.source if reference is not None else "",
        causes=causes,
        verdict=verdict,
        ambiguous_with=others,
        adequacy=sufficient,
        identifiability=apart,
        files=files,
        held_out=judged,
        visible=visible_from(fit, selection.final),
        problems={used.log.name: problems(used.log.run) for used in parted.used},
        seed=seed,
        runtime_s=clock() - begun,
    )


def _harmful(judged: HeldOutScore) -> bool:
    """Whether the causes make held-out readings worse, surely, and none of them surely better: then they are wrong."""
    told = [e for e in judged.errors if e.horizon_s == TOLD_S]
    worse = any(e.channel == "position" and e.gain_ci95[1] < 0 for e in told)
    return worse and not any(e.gain_ci95[0] > 0 for e in told)


def _logs(runs: Sequence[Run]) -> list[Log]:
    return [Log(run.meta.source, run) for run in runs]


def _ambient(reference: Run, vessel: VesselFile, say: Say) -> Noise:
    """Noise of sensors and of what nobody can foretell, from a log in which nothing is wrong."""
    say(STEPS[0], reference.meta.source, 0.0)
    run = usable(Log(reference.meta.source, reference), vessel).run
    refuse_mistaken(run)
    calm = unbroken(run)
    everyday = [e for e in catalogue(vessel, calm) if e.everyday]
    model = Selector(Fit(Physics(calm, vessel, WINDOW_S), everyday, stated_noise(vessel))).base()
    say(STEPS[0], "", 1.0)
    return model.noise


def _stated(vessel: VesselFile, ambient: Noise | None) -> Noise:
    """Noise to begin with: the file's, or the reference log's."""
    noise = stated_noise(vessel)
    return noise if ambient is None else replace(noise, white=ambient.white, fix_m=ambient.fix_m)


def _refit(fit: Fit, base: Model) -> tuple[Believed, Point]:
    """Coefficients and gains alone, each within what nobody would name: a cause must not hide in the base."""
    few = [_within(e) for e in fit.effects if e.family == "base" or e.name.startswith("thruster_gain:")]
    theta = {
        e.id: np.clip(base.point.theta[e.id], [p.lower for p in e.parameters], [p.upper for p in e.parameters])
        for e in few
    }
    fit.noise = base.noise
    found = fit.solve(theta, base.point.z, few, frozenset(), steps=2, before=base.point)
    fit.noise = tuned_latent(fit, found)
    found = fit.solve(found.theta, found.z, few, frozenset(), steps=1, before=found)
    return Believed(found.theta, fit.noise), found


def _within(effect: Effect) -> Effect:
    """The effect with its parameters held within `REFIT_SIGMAS` of nil."""
    sigmas = [p.prior for p in effect.parameters] if effect.family == "base" else effect.tolerance()
    held = [replace(p, lower=max(p.lower, -REFIT_SIGMAS * s), upper=min(p.upper, REFIT_SIGMAS * s))
            for p, s in zip(effect.parameters, sigmas, strict=True)]  # fmt: skip
    return replace(effect, parameters=tuple(held))


def _beside(fit: Fit, selection: Selection, causes: Sequence[Named]) -> Theta:
    """Base numbers beside the causes, to stand in a file alone: what the hull might have beyond them is held at nil.

    Free beside them are the bands of sensors and environment, which no file gets: what they did that day is not the
    boat's. Chosen on seven hidden cases (nonce "report") against keeping the whole catalogue free.
    """
    final, ids = selection.final, frozenset(n.fitted for n in causes)
    chosen = [e for e in fit.effects if e.id in ids or _is_number(e) or (e.everyday and e.family in OF_THE_DAY)]
    theta = {k: v for k, v in final.point.theta.items() if k in {e.id for e in chosen}}
    fit.noise = final.noise
    return fit.solve(theta, final.point.z, chosen, ids, steps=2, before=final.point).theta


def _is_number(effect: Effect) -> bool:
    """Whether its tolerance band moves numbers that every vessel file has."""
    return effect.everyday and (effect.family == "base" or family(effect.name) in FOLDED)


def _place(fit: Fit) -> Place:
    return Place(fit.physics.centre_m, fit.physics.middle_s)


def _cause(fit: Fit, effect: Effect, values: np.ndarray, note: str) -> Cause:
    own = {p.name: float(v) + effect.origin.get(p.name, 0.0) for p, v in zip(effect.parameters, values, strict=True)}
    return Cause(effect, own, point(effect, values, _place(fit)), note)


def _named(fit: Fit, found: Found, seed: int) -> tuple[Named, ...]:
    """Accepted causes, the surest first."""
    out = []
    for one in found.causes:
        effect, candidate = one.effect, one.candidate
        numbers = public(effect, candidate.values, candidate.covariance, _place(fit), seed)
        told = ", ".join(f"{k} {n.value:.4g}" for k, n in numbers.items())
        note = f"{effect.name}{f' ({told})' if told else ''} found by aritra diagnose"
        cause = replace(_cause(fit, effect, candidate.values, note), forces_n=_forces(found.selection.final))
        out.append(Named(candidate, effect, numbers, smallest(effect), cause, one.fitted, one.form_doubtful))
    return tuple(out)


def _forces(model: Model) -> np.ndarray:
    f = model.point.state.forces.f
    return f.reshape(-1, f.shape[2])


def _files(fit: Fit, refit: Believed, theta: Theta, causes: Sequence[Named], final: Noise) -> Files:
    """Refitted; and from `theta`, beside the causes: numbers, extended. Left out of them: noise of `refit`, `final`."""
    vessel = fit.physics.vessel
    note = "refitted by aritra diagnose"
    left_out = "latent force of the fitted logs, doubled, or a fifth of the filter's own tuning: aritra diagnose"
    plain = trusted(refitted(vessel, _nuisances(fit, refit.theta, (), note), note), refit.noise, left_out)
    if not causes:
        return Files(plain, plain, plain, {})
    names = {n.effect.name for n in causes} | {n.fitted for n in causes}
    beside = refitted(vessel, _nuisances(fit, theta, names, note), note)
    mine = [n.cause for n in causes]
    extended, left = with_causes(beside, mine)
    return Files(plain, numbers_beside(beside, extended, mine), trusted(extended, final, left_out), left)


def _nuisances(fit: Fit, theta: Theta, names: set[str] | tuple[str, ...], note: str) -> list[Cause]:
    return [_cause(fit, e, theta[e.id], note) for e in fit.effects if e.id in theta and e.name not in names]


def _sayable(fit: Fit, selection: Selection, theta: Theta, causes: Sequence[Named]) -> Believed:
    """Causes and base numbers, not the tolerance bands that no file gets."""
    kept = {n.fitted for n in causes} | {e.id for e in fit.effects if _is_number(e)}
    return Believed({k: v for k, v in theta.items() if k in kept}, selection.final.noise)
