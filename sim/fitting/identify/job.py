"""One identification from logs to verdict: Taylor series, structured model, and which of them to believe.

    split -> smooth and regress -> structured fit -> open-loop runs on what was held out -> verdict

No file, clock or random source here: logs are Runs, the time comes from `now`, the seed from `Choices`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.problems import problems
from companion.logs.runs.run import LogProblem, Run
from sim.fitting.engine.smoothing import RATE_HZ, Smoothed, SmootherNoise, smooth
from sim.fitting.engine.split import JobError, NamedLog, Split, split
from sim.fitting.identify.result import FitResult, fit_structured
from sim.fitting.identify.structured_fit import FitSettings
from sim.fitting.identify.verdict import NAMES, IdentificationVerdict, verdict
from sim.fitting.identify.vessel_out import identified_vessel
from sim.fitting.taylor.pipeline import PaperMotion, forces_kgf, paper_motion, smoother_samples
from sim.fitting.taylor.regression import Samples, TaylorFit, least_squares, noise_shift
from sim.fitting.taylor.sindy import sindy_coefficients
from sim.fitting.validate.divergence import Departure, departure
from sim.fitting.validate.models import TaylorSimulator, VesselSimulator
from sim.fitting.validate.protocol import Simulator
from sim.fitting.validate.scores import SpeedBox
from sim.fitting.validate.study import Validation, validate

STEPS = ("smoothing", "Taylor series", "structured model", "held-out runs")
"""What `identify` says it is at, in this order; shares run from 0 to 1 within each."""
PAPER = "the paper's Kalman filter, Lanczos low-pass and 7-point differences"
SMOOTHER = "the RTS smoother"
Say = Callable[[str, str, float], None]
"""Step, what of it, share of it that is done."""


@dataclass(frozen=True)
class Choices:
    """What the user decides. `block_s`: alternate blocks instead of the last part. `peer`: pysindy beside the others.

    `settings`: of the structured fit. `seed`: of the noise study and of the random thrusts of the stability test.
    """

    block_s: float | None = None
    taylor: bool = True
    peer: bool = False
    seed: int = 0
    settings: FitSettings = field(default_factory=FitSettings)


@dataclass(frozen=True)
class SmoothedMotions:
    """What the fitted runs did: smoothed, and by the paper's pipeline (None: no yaw rate or accelerations logged)."""

    runs: tuple[Run, ...]
    smoothed: tuple[Smoothed, ...]
    paper: tuple[PaperMotion, ...] | None

    def smoother_samples(self, vessel: VesselFile) -> list[Samples]:
        """For a regression, one for each run; accelerations are the smoother's own."""
        return [smoother_samples(r, vessel, s) for r, s in zip(self.runs, self.smoothed, strict=True)]

    def paper_samples(self, vessel: VesselFile) -> list[Samples]:
        """For a regression, one for each run, as the paper takes them; none where it cannot."""
        pairs = zip(self.runs, self.paper, strict=True) if self.paper else ()
        return [Samples(m.nu, m.nu_dot, forces_kgf(r, vessel, m.t_s), RATE_HZ) for r, m in pairs]


@dataclass(frozen=True)
class Taylor:
    """One 23-term series by least squares. `shift` (3, 23): what the smoother's errors in u, v, r do to it."""

    name: str
    pipeline: str
    fit: TaylorFit
    shift: np.ndarray


@dataclass(frozen=True)
class Stamp:
    """When something was done (UTC)."""

    what: str
    utc: str


@dataclass(frozen=True)
class Identification:
    """Everything. `series`: by the paper's pipeline and by the smoother; `peer`: pysindy's coefficients (3, 23).

    `problems`: by log. `stamps`: in order of time.
    """

    base: VesselFile
    identified: VesselFile
    choices: Choices
    split: Split
    motion: SmoothedMotions
    noise: SmootherNoise
    structured: FitResult
    series: tuple[Taylor, ...]
    peer: np.ndarray | None
    validation: Validation
    departures: tuple[Departure, ...]
    problems: dict[str, list[LogProblem]]
    verdict: IdentificationVerdict
    stamps: tuple[Stamp, ...]


def identify(
    logs: Sequence[NamedLog],
    held_out: Sequence[NamedLog],
    vessel: VesselFile,
    choices: Choices,
    now: Callable[[], str],
    say: Say = lambda _step, _text, _share: None,
) -> Identification:
    """Fit `vessel` to logs and judge it on what is held out. `now`: UTC, ISO 8601.

    Raises JobError, RunError or StructuredFitError (all ValueError) naming the log that cannot be used.
    """
    stamps = [Stamp("choices made, before any fit", now())]
    parted = split(logs, held_out, vessel, choices.block_s)
    told = {used.log.name: problems(used.log.run) for used in parted.used}
    noise = SmootherNoise.of(vessel)
    motion = _motion(parted.fitted, noise, say)
    stamps.append(Stamp("fitted parts smoothed", now()))
    series, peer = _series(motion, vessel, choices, say)
    stamps.append(Stamp("regressions done", now()))
    step = STEPS[2]
    say(step, "", 0.0)
    structured = fit_structured(
        parted.fitted, vessel, choices.settings, lambda text, share: say(step, text, min(share, 0.99))
    )
    say(step, f"{structured.iterations} steps", 1.0)
    identified = identified_vessel(vessel, structured, date=now()[:10])
    stamps.append(Stamp("structured model fitted", now()))
    models: list[Simulator] = [VesselSimulator(NAMES["base"], vessel)]
    models += [TaylorSimulator(one.name, one.fit.C, vessel) for one in series]
    models += [TaylorSimulator(NAMES["peer"], peer, vessel)] if peer is not None else []
    same_day = all(used.fitted_s for used in parted.used if used.held_out_s)
    of_the_day = identified_vessel(vessel, structured, date=now()[:10], session=True) if same_day else identified
    models.append(VesselSimulator(NAMES["structured"], of_the_day))
    box = SpeedBox.of(np.concatenate([s.nu for s in motion.smoothed]))
    validation, departures = _judge(models, parted, vessel, noise, box, choices.seed, say)
    stamps.append(Stamp("held-out runs simulated for the first time", now()))
    return Identification(
        base=vessel,
        identified=identified,
        choices=choices,
        split=parted,
        motion=motion,
        noise=noise,
        structured=structured,
        series=series,
        peer=peer,
        validation=validation,
        departures=departures,
        problems=told,
        verdict=verdict(structured, validation, told),
        stamps=tuple(stamps),
    )


def _motion(runs: Sequence[Run], noise: SmootherNoise, say: Say) -> SmoothedMotions:
    smoothed = []
    for i, run in enumerate(runs):
        say(STEPS[0], run.meta.source, i / len(runs))
        smoothed.append(smooth(run, noise))
    complete = all(run.known(c) for run in runs for c in ("r_rad_s", "ax_m_s2", "ay_m_s2"))
    paper = tuple(paper_motion(run, noise) for run in runs) if complete else None
    say(STEPS[0], "", 1.0)
    return SmoothedMotions(tuple(runs), tuple(smoothed), paper)


def _series(
    motion: SmoothedMotions, vessel: VesselFile, choices: Choices, say: Say
) -> tuple[tuple[Taylor, ...], np.ndarray | None]:
    """The 23-term series by least squares, and by pysindy, as far as they were asked for."""
    step, series, peer = STEPS[1], [], None
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
            raise JobError('pysindy is not installed: pip install "aritra[analysis]"') from None
    say(step, "" if choices.taylor or choices.peer else "not asked for", 1.0)
    return tuple(series), peer


def _judge(
    models: Sequence[Simulator],
    parted: Split,
    vessel: VesselFile,
    noise: SmootherNoise,
    box: SpeedBox,
    seed: int,
    say: Say,
) -> tuple[Validation, tuple[Departure, ...]]:
    """Every model and both baselines in open loop on what was held out."""
    step = STEPS[3]
    found = validate(
        models, parted.held_out, vessel, noise, box=box, seed=seed, say=lambda text, share: say(step, text, share)
    )
    pairs = zip(found.scores, found.states, strict=True)
    departures = tuple(departure(one.name, states, found.windows, box) for one, states in pairs)
    say(step, f"{len(found.windows.x0)} runs", 1.0)
    return found, departures
