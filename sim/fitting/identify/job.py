"""One identification from logs to verdict: Taylor series, structured model, and which of them to believe.

    split -> structured fit -> smooth and regress -> open-loop simulation of held-out data -> verdict

Pure: logs are Runs, the time comes from `now`, the seed from `Choices`; nothing is read or written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.apply_sensor_errors import calibrated
from companion.logs.runs.problems import problems
from companion.logs.runs.run import LogProblem, Run
from companion.logs.runs.splits import HeldOut
from sim.fitting.engine.smoothing import RATE_HZ, Smoothed, SmootherNoise, smooth
from sim.fitting.engine.split import JobError, NamedLog, Split
from sim.fitting.identify.chosen_fit import ChosenFit, fit_chosen
from sim.fitting.identify.result import FitResult
from sim.fitting.identify.structured_fit import FitSettings
from sim.fitting.identify.verdict import KEEP, NAMES, IdentificationVerdict, verdict
from sim.fitting.identify.vessel_out import identified_vessel, in_surroundings
from sim.fitting.taylor.pipeline import PaperMotion, forces_kgf, paper_motion, smoother_samples
from sim.fitting.taylor.regression import Samples, TaylorFit, least_squares, noise_shift
from sim.fitting.taylor.sindy import sindy_coefficients
from sim.fitting.validate.divergence import Departure, departure
from sim.fitting.validate.models import TaylorSimulator, VesselSimulator
from sim.fitting.validate.protocol import Simulator
from sim.fitting.validate.scores import SpeedBox
from sim.fitting.validate.study import Validation, judgeable, validate
from sim.fitting.wiring.levelling import split_levelled
from sim.fitting.wiring.record import VESSEL, WiringReport

STEPS = ("structured model", "smoothing", "Taylor series", "held-out runs")
"""Steps that `identify` reports progress of, in their order; shares run from 0 to 1 within each."""
PAPER = "the paper's Kalman filter, Lanczos low-pass and 7-point differences"
SMOOTHER = "the RTS smoother"
Say = Callable[[str, str, float], None]
"""Progress: step, detail, share of the step that is done."""


@dataclass(frozen=True)
class Choices:
    """What the user decides.

    block_s   hold out alternate blocks of this length [s] instead of the last part
    taylor    fit the Taylor series too; peer: pysindy too
    seed      of the noise study and of the random thrusts of the stability test
    settings  of the structured fit
    """

    block_s: float | None = None
    taylor: bool = True
    peer: bool = False
    seed: int = 0
    settings: FitSettings = field(default_factory=FitSettings)


@dataclass(frozen=True)
class SmoothedMotions:
    """Motion of the fitted runs: smoothed, and by the paper's pipeline (None: no yaw rate or accelerations logged)."""

    runs: tuple[Run, ...]
    smoothed: tuple[Smoothed, ...]
    paper: tuple[PaperMotion, ...] | None

    def smoother_samples(self, vessel: VesselFile) -> list[Samples]:
        """Regression samples of each run; accelerations are the smoother's."""
        return [smoother_samples(r, vessel, s) for r, s in zip(self.runs, self.smoothed, strict=True)]

    def paper_samples(self, vessel: VesselFile) -> list[Samples]:
        """Regression samples of each run by the paper's pipeline; empty where that cannot be applied."""
        pairs = zip(self.runs, self.paper, strict=True) if self.paper else ()
        return [Samples(m.nu, m.nu_dot, forces_kgf(r, vessel, m.t_s), RATE_HZ) for r, m in pairs]


@dataclass(frozen=True)
class Taylor:
    """One 23-term series by least squares, from samples by `pipeline`.

    `shift` (3, 23): by how much the smoother's errors in u, v, r move the coefficients (`noise_shift`).
    """

    name: str
    pipeline: str
    fit: TaylorFit
    shift: np.ndarray


@dataclass(frozen=True)
class Stamp:
    """When a step was done (UTC, ISO 8601)."""

    what: str
    utc: str


@dataclass(frozen=True)
class Identification:
    """Inputs and results of one identification.

    chosen       the structured fit: model, method, result, and what else was tried
    series       Taylor series by the paper's pipeline and by the smoother
    peer         coefficients (3, 23) by pysindy, if asked for
    departures   how the models diverge from the held-out data; models in the order of `validation.scores`
    problems     by name of the log
    stamps       in order of time
    wiring       what was found of signs and sides before; `base` has the thrusters as they are connected
    """

    base: VesselFile
    chosen: ChosenFit
    identified: VesselFile
    choices: Choices
    split: Split
    motion: SmoothedMotions
    noise: SmootherNoise
    series: tuple[Taylor, ...]
    peer: np.ndarray | None
    validation: Validation
    departures: tuple[Departure, ...]
    problems: dict[str, list[LogProblem]]
    verdict: IdentificationVerdict
    stamps: tuple[Stamp, ...]
    wiring: WiringReport = field(default_factory=WiringReport)

    def with_wiring(self, wiring: WiringReport) -> Identification:
        """This identification after what was put right in logs and vessel file is as `wiring` says."""
        if not wiring.vessel_changed:
            return replace(self, wiring=wiring)
        keep = f"{KEEP.removesuffix('.')}, with its thrusters put right ({VESSEL})."
        lines = tuple(line.replace(KEEP, keep) for line in self.verdict.lines)
        return replace(self, wiring=wiring, verdict=replace(self.verdict, lines=lines))

    @property
    def model(self) -> VesselFile:
        """What was fitted: `base` with the refinements that the logs asked for, at first guess."""
        return self.chosen.vessel

    @property
    def structured(self) -> FitResult:
        """Result of the structured fit."""
        return self.chosen.result


def identify(
    logs: Sequence[NamedLog],
    held_out: Sequence[NamedLog],
    vessel: VesselFile,
    choices: Choices,
    now: Callable[[], str],
    say: Say = lambda _step, _text, _share: None,
) -> Identification:
    """Fit `vessel` to logs and judge it on held-out data. `now`: UTC, ISO 8601.

    Raises JobError, RunError or StructuredFitError (all ValueError) naming the log that cannot be used.
    """
    # 1. Split the logs; nothing below looks at the held-out parts before step 4, but whether they can be judged. Roll
    #    and pitch that follow the acceleration are left out.
    stamps = [Stamp("choices made, before any fit", now())]
    division = judgeable(split_levelled(logs, held_out, vessel, choices.block_s), vessel)
    log_problems = {used.log.name: problems(used.log.run) for used in division.used}
    # 2. Structured fit, and the vessel file with its result.
    step = STEPS[0]
    say(step, "", 0.0)
    chosen = fit_chosen(
        division.fitted, vessel, choices.settings, lambda text, share: say(step, text, min(share, 0.99))
    )
    model, structured = chosen.vessel, chosen.result
    say(step, f"{structured.iterations} steps", 1.0)
    identified = identified_vessel(model, structured, date=now()[:10])
    stamps.append(Stamp("structured model fitted", now()))
    # 3. Smooth the fitted parts, as the file knows its sensors now, and fit the Taylor series to their accelerations.
    noise = SmootherNoise.of(identified)
    motion = _motion([calibrated(run, identified) for run in division.fitted], noise, say)
    stamps.append(Stamp("fitted parts smoothed", now()))
    series, peer = _series(motion, vessel, choices, say)
    stamps.append(Stamp("regressions done", now()))
    # 4. All models in open loop on the held-out parts.
    models = _simulators(vessel, identified, chosen, division, series, peer, now)
    box = SpeedBox.of(np.concatenate([s.nu for s in motion.smoothed]))
    held_out_runs = [HeldOut(calibrated(out.run, identified), out.inside) for out in division.held_out]
    validation, departures = _judge(models, held_out_runs, vessel, noise, box, choices.seed, say)
    stamps.append(Stamp("held-out runs simulated for the first time", now()))
    return Identification(
        base=vessel,
        chosen=chosen,
        identified=identified,
        choices=choices,
        split=division,
        motion=motion,
        noise=noise,
        series=series,
        peer=peer,
        validation=validation,
        departures=departures,
        problems=log_problems,
        verdict=verdict(chosen, validation, log_problems),
        stamps=tuple(stamps),
    )


def _motion(runs: Sequence[Run], noise: SmootherNoise, say: Say) -> SmoothedMotions:
    """Smooth the fitted runs, and take them through the paper's pipeline where all its sensors were logged."""
    smoothed = []
    for i, run in enumerate(runs):
        say(STEPS[1], run.meta.source, i / len(runs))
        smoothed.append(smooth(run, noise))
    complete = all(run.known(c) for run in runs for c in ("r_rad_s", "ax_m_s2", "ay_m_s2"))
    paper = tuple(paper_motion(run, noise) for run in runs) if complete else None
    say(STEPS[1], "", 1.0)
    return SmoothedMotions(tuple(runs), tuple(smoothed), paper)


def _series(
    motion: SmoothedMotions, vessel: VesselFile, choices: Choices, say: Say
) -> tuple[tuple[Taylor, ...], np.ndarray | None]:
    """The 23-term series by least squares, and coefficients by pysindy, as far as they were asked for."""
    step, series, peer = STEPS[2], [], None
    if choices.taylor:
        ways = (
            (NAMES["taylor"], PAPER, motion.paper_samples(vessel)),
            (NAMES["smoothed"], SMOOTHER, motion.smoother_samples(vessel)),
        )
        for i, (name, pipeline, samples) in enumerate(ways):
            say(step, name, 0.6 * i / len(ways))
            if not samples:
                continue
            fit, sigmas = least_squares(samples), [s.nu_sigma for s in motion.smoothed]
            shift = noise_shift(samples, sigmas, np.random.default_rng(choices.seed))
            series.append(Taylor(name, pipeline, fit, shift))
    if choices.peer:
        say(step, NAMES["peer"], 0.6)
        try:
            peer = sindy_coefficients(motion.smoother_samples(vessel))
        except ModuleNotFoundError:
            raise JobError("pysindy is not installed: `make install` in a checkout brings it") from None
    say(step, "" if choices.taylor or choices.peer else "not asked for", 1.0)
    return tuple(series), peer


def _simulators(
    vessel: VesselFile,
    identified: VesselFile,
    chosen: ChosenFit,
    division: Split,
    series: Sequence[Taylor],
    peer: np.ndarray | None,
    now: Callable[[], str],
) -> list[Simulator]:
    """The models to judge. Where the held-out parts are of the fitted logs, the structured one has their day."""
    models: list[Simulator] = [VesselSimulator(NAMES["base"], vessel)]
    models += [TaylorSimulator(one.name, one.fit.C, vessel) for one in series]
    models += [TaylorSimulator(NAMES["peer"], peer, vessel)] if peer is not None else []
    same_day = all(used.fitted_s for used in division.used if used.held_out_s)
    if same_day:
        of_the_day = identified_vessel(chosen.vessel, chosen.result, date=now()[:10], session=True)
        identified = in_surroundings(of_the_day, chosen.result)
    return [*models, VesselSimulator(NAMES["structured"], identified)]


def _judge(
    models: Sequence[Simulator],
    held_out: Sequence[HeldOut],
    vessel: VesselFile,
    noise: SmootherNoise,
    box: SpeedBox,
    seed: int,
    say: Say,
) -> tuple[Validation, tuple[Departure, ...]]:
    """Every model and both baselines in open loop on the held-out data."""
    step = STEPS[3]
    validation = validate(
        models, held_out, vessel, noise, box=box, seed=seed, say=lambda text, share: say(step, text, share)
    )
    pairs = zip(validation.scores, validation.states, strict=True)
    departures = tuple(departure(one.name, states, validation.windows, box) for one, states in pairs)
    say(step, f"{len(validation.windows.x0)} runs", 1.0)
    return validation, departures
