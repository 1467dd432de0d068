"""One diagnosis from logs to findings.

    split -> noise of the reference log -> base refitted, causes by evidence -> adequacy -> vessel files
          -> score on held-out logs, by which harmful causes are withdrawn -> verdict

No I/O and no random source here: logs are Runs, the seed is an argument, `clock` measures the run time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.problems import problems
from companion.logs.runs.run import LogProblem, Run
from companion.logs.runs.splits import parts
from sim.fitting.diagnose.catalogue import catalogue, without_effects
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.clock import LogClock
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.preparation.subsampling import subsample
from sim.fitting.diagnose.preparation.swapped_columns import reject_swapped_columns, strange_scale
from sim.fitting.diagnose.report import findings as record
from sim.fitting.diagnose.report.verdict import (
    Adequate,
    conclude,
    held_out_objection,
    without_causes,
    without_some,
)
from sim.fitting.diagnose.selection.adequacy import adequacy
from sim.fitting.diagnose.selection.detectability import detection_limits
from sim.fitting.diagnose.selection.distinguishability import Distinguishability, distinguishability
from sim.fitting.diagnose.selection.greedy_selection import Selection, Selector
from sim.fitting.diagnose.selection.held_out import HeldOutScore, score
from sim.fitting.diagnose.selection.held_out_support import unsupported
from sim.fitting.diagnose.selection.search import search_causes
from sim.fitting.diagnose.selection.smoothed_logs import ModelUnderTest
from sim.fitting.diagnose.vessel_edits.refitted_vessel import ReportedCause, VesselFiles, refit, vessel_with_causes
from sim.fitting.engine.noise import Noise
from sim.fitting.engine.split import NamedLog, Split, reject_overlap, split_at_pauses, usable
from sim.fitting.engine.windows import usable_fixes
from sim.fitting.wiring.levelling import split_levelled, unlevelled
from sim.fitting.wiring.record import WiringReport
from sim.fitting.wiring.thrusters import restored

STEPS = ("reference", "base and causes", "files", "held-out logs")
"""Steps that `diagnose` reports, in this order; shares run from 0 to 1 within each."""
WINDOW_S = 1.0
Progress = Callable[[str, str, float], None]
"""Report of progress: step, text, share done."""
Effects = Callable[[VesselFile], Sequence[Effect]]
"""A user's own entries for a boat: `effects` of the file that `--catalogue` names."""


@dataclass(frozen=True)
class Data:
    """Fitted and held-out runs without pauses, and the clock of all logs."""

    split: Split
    fitted: list[Run]
    held_out: list[Run]
    clock: LogClock


@dataclass(frozen=True)
class Diagnosis:
    """The result of a diagnosis.

    refit, refit_point    base refitted by coefficients and gains, against which gain is counted; its linearisation
    ambient, reference    noise and name of the reference log (None, empty: there is none)
    confused, withdrawn   see `DiagnosisVerdict`
    visible               by effect, detection limit in public units and its unit
    problems              by log
    wiring                what was found of signs and sides before; `base` has the thrusters as they are connected
    """

    base: VesselFile
    split: Split
    fit: PosteriorFit
    selection: Selection
    refit: ModelUnderTest
    refit_point: LinearisationPoint
    ambient: Noise | None
    reference: str
    causes: tuple[ReportedCause, ...]
    verdict: record.Verdict
    confused: dict[str, tuple[str, ...]]
    withdrawn: dict[str, str]
    adequacy: record.Adequacy | None
    identifiability: Distinguishability | None
    files: VesselFiles
    held_out: HeldOutScore
    visible: dict[str, tuple[float, str]]
    problems: dict[str, list[LogProblem]]
    seed: int
    runtime_s: float
    wiring: WiringReport = field(default_factory=WiringReport)

    def with_wiring(self, wiring: WiringReport, given: VesselFile) -> Diagnosis:
        """This diagnosis of logs and of the file `given` after what was put right in them is as `wiring` says.

        Where nothing else is wrong, that is what is named. Files without causes have the thrusters as given.
        """
        verdict = "named" if self.verdict == "none" and wiring.corrected else self.verdict
        files = self.files
        if wiring.vessel_changed:
            refitted, numbers = (restored(vessel, given) for vessel in (files.refitted, files.numbers))
            files = replace(files, refitted=refitted, numbers=numbers)
        return replace(self, wiring=wiring, verdict=verdict, files=files)

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Names of all rivals of the causes."""
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
    identifiability: Callable[[PosteriorFit, Selection], Distinguishability] | None = distinguishability,
    say: Progress = lambda _step, _text, _share: None,
    seed: int = 0,
    clock: Callable[[], float] = lambda: 0.0,
) -> Diagnosis:
    """Diagnose the logs `runs` of the boat that `vessel` describes.

    reference          a log of the sound boat in calm, for the ambient noise
    held_out           logs that no fit uses; default: the last quarter of each log, or every other block of `block_s`
    more, without      a user's own entries; names or families of effects that the catalogue leaves out
    known              names of causes that are present for sure: they are sized, no others are searched
    adequacy, identifiability    the checks; None: left out
    say, seed, clock   progress; of intervals; run time [s]

    JobError, RunError or StructuredFitError (all ValueError) name a log that cannot be used.
    """
    # 1. Data, noise of the reference log, catalogue.
    begun = clock()
    data = data_of(runs, held_out, vessel, block_s)
    if reference is not None:
        reject_overlap(_logs([*runs, *held_out, reference]))
    ambient = _ambient(reference, vessel, say) if reference is not None else None

    entries = without_effects(catalogue(vessel, data.fitted, tuple(more(vessel)), data.clock), without)
    physics = EffectPhysics(data.fitted, vessel, WINDOW_S, data.clock)
    fit = PosteriorFit(physics, entries, _stated(vessel, data.fitted, ambient))
    # 2. Base refitted, causes by evidence.
    say(STEPS[1], "base", 0.0)
    search_result = search_causes(fit, without, known, lambda text, share: say(STEPS[1], text, min(share, 0.99)))
    say(STEPS[1], "", 1.0)
    # 3. Verdict by the fitted logs, vessel files.
    say(STEPS[2], "refitted base", 0.0)
    refitted_base, refitted_point = refit(fit, search_result.selection.base)
    verdict = conclude(fit, search_result, ambient, adequacy, seed, bool(known))

    def compared(one: ModelUnderTest, other: ModelUnderTest) -> HeldOutScore:
        pair = {"base": refitted_base, "refit": one, "extended": other}
        return score(data.held_out, vessel, fit.effects, pair, fit.physics, seed)

    gone = frozenset() if known else unsupported(fit, verdict.selection, compared)
    if gone:
        verdict = without_some(fit, search_result, verdict, gone, ambient, adequacy, seed)
    files_and_model = vessel_with_causes(fit, refitted_base, verdict.selection.final, verdict.causes)
    say(STEPS[2], "", 1.0)
    # 4. Held-out score of the three models; harmful causes are withdrawn.
    say(STEPS[3], "", 0.0)
    models = {
        "base": ModelUnderTest({}, search_result.selection.base.noise),
        "refit": refitted_base,
        "extended": files_and_model.extended,
    }
    held_out_score = score(data.held_out, vessel, fit.effects, models, fit.physics, seed)
    if verdict.causes and not known and (why := held_out_objection(verdict, held_out_score)):
        verdict = without_causes(fit, verdict, why, ambient, adequacy)
        files_and_model = vessel_with_causes(fit, refitted_base, verdict.selection.final, ())
        held_out_score = score(
            data.held_out, vessel, fit.effects, models | {"extended": refitted_base}, fit.physics, seed
        )
    apart = identifiability(fit, verdict.selection) if identifiability else None
    say(STEPS[3], "", 1.0)
    return Diagnosis(
        base=vessel,
        split=data.split,
        fit=fit,
        selection=verdict.selection,
        refit=refitted_base,
        refit_point=refitted_point,
        ambient=ambient,
        reference=reference.meta.source if reference is not None else "",
        causes=verdict.causes,
        verdict=verdict.verdict,
        confused=verdict.confused,
        withdrawn=verdict.withdrawn,
        adequacy=verdict.adequacy,
        identifiability=apart,
        files=files_and_model.files,
        held_out=held_out_score,
        visible=detection_limits(fit, verdict.selection.final),
        problems={
            used.log.name: [
                *unlevelled(used.log.run),
                *strange_scale(used.log.run),
                *problems(used.log.run),
            ]
            for used in data.split.used
        },
        seed=seed,
        runtime_s=clock() - begun,
    )


def data_of(runs: Sequence[Run], held_out: Sequence[Run], vessel: VesselFile, block_s: float | None) -> Data:
    """Split of the logs, subsampled, and the shared clock. JobError for swapped columns.

    Roll and pitch that follow the acceleration are left out.
    """
    whole = split_levelled(_logs(runs), _logs(held_out), vessel, block_s)
    parted, clock = subsample(whole), LogClock.of(whole.fitted, [part.run for part in whole.held_out])
    for used in parted.used:
        reject_swapped_columns(used.log.run)
    outside = [run for out in parted.held_out for run in (parts(out.run, out.inside) if out.inside else [out.run])]
    for run in outside:
        usable_fixes(run)  # raises early: held-out runs are used only after a long search
    return Data(parted, list(parted.fitted), outside, clock)


def _logs(runs: Sequence[Run]) -> list[NamedLog]:
    return [NamedLog(run.meta.source, run) for run in runs]


def _ambient(reference: Run, vessel: VesselFile, say: Progress) -> Noise:
    """Noise of sensors and ambient latent acceleration from the log of a sound boat."""
    say(STEPS[0], reference.meta.source, 0.0)
    run = usable(NamedLog(reference.meta.source, reference), vessel, at_rest=True).run
    reject_swapped_columns(run)
    calm = split_at_pauses(run)
    everyday = [e for e in catalogue(vessel, calm) if e.always_free]
    model = Selector(PosteriorFit(EffectPhysics(calm, vessel, WINDOW_S), everyday, stated_noise(vessel, calm))).base()
    say(STEPS[0], "", 1.0)
    return model.noise


def _stated(vessel: VesselFile, runs: Sequence[Run], ambient: Noise | None) -> Noise:
    """Initial noise: the file's, with white noise and fixes of the reference log where there is one."""
    noise = stated_noise(vessel, runs)
    return noise if ambient is None else replace(noise, white=ambient.white, fix_m=ambient.fix_m)
