"""The structured fit that predicts best: with which refinements, and what its model error is.

What fits a boat best cannot be read off the columns of a log: where the model lacks something, the likelihood of short
windows explains it by latent accelerations that the controller will not have, and gets worse the more sensors there are
(docs/identify.md). So it is tried, on halves of the fitted logs that are not fitted at the time (`folds`, `trials`):

    1. multi-step output error of each half, judged by its predictions of the other: with the heading as it was
       measured, and put right where the compass clearly errs by how the boat is turned; then with each of the
       refinements that the file lacks. The best is kept while it gains `WORTH`, and neither half loses `NO_WORSE`
    2. the fit of windows of that model (white noise, latent acceleration), where there are inertial sensors, in the
       same way: with the priors of a measured boat, and with those of one that nobody has measured, in the weather of a
       day. It is kept, for where the model is right it is the more accurate, unless multi-step output error predicts
       better by `NO_WORSE`
    3. a refinement of which that fit of all logs shows nothing is left out again: halves of a log agree by chance
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.configuration.sensors import MOST_HARD_IRON_RAD
from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.identify.folds import HORIZONS_S, Halves, folds
from sim.fitting.identify.horizon import reaches
from sim.fitting.identify.refinements import COMPASS, nothing_of, with_refinements
from sim.fitting.identify.result import INERTIAL, FitResult, fit_structured
from sim.fitting.identify.structured_fit import FitSettings, Say
from sim.fitting.identify.trials import MULTI_STEP, WINDOWS, Trial, TrialSearch, multi_step
from sim.fitting.wiring.compass import hard_iron


@dataclass(frozen=True)
class ChosenFit:
    """The chosen fit: the vessel with its refinements, at first guess, the settings, the result.

    `trials`: all that were tried, by predictions up to `horizon_s` ahead (0: none were); `why`: as it was chosen;
    `too_short`: runs that were left out because nothing in them can be predicted so far ahead; `left_out`: refinements
    of the trial that was kept of which all logs together show nothing.
    """

    vessel: VesselFile
    settings: FitSettings
    result: FitResult
    why: str
    trials: tuple[Trial, ...] = ()
    horizon_s: float = 0.0
    too_short: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def method(self) -> str:
        """How it was fitted."""
        return MULTI_STEP if self.result.horizon_s else WINDOWS

    @property
    def refinements(self) -> tuple[str, ...]:
        """Names of the refinements that were kept."""
        tried = next((trial.refinements for trial in self.trials if trial.kept), ())
        return tuple(name for name in tried if name not in self.left_out)


def fit_chosen(runs: Sequence[Run], vessel: VesselFile, settings: FitSettings, say: Say) -> ChosenFit:
    """Choose and fit. Settings that state a horizon or a window are obeyed: then nothing is tried.

    Raises StructuredFitError where a run cannot be used.
    """
    if settings.horizon_s is not None or settings.window_s is not None:
        return ChosenFit(vessel, settings, fit_structured(runs, vessel, settings, say), "the settings say so")
    inertial = any(run.known(c) for run in runs for c in INERTIAL)
    halves = folds(runs, vessel)
    if halves is None:
        return _short(runs, vessel, settings, inertial, say)
    # 1. The compass, refinements.
    search = TrialSearch(halves, vessel, settings, say)
    if settings.compass:
        _ask_compass(search, runs, vessel)
    search.refine()
    vessel = search.model
    # 2. Method.
    why = "no inertial sensor was logged"
    holding = search.windows_that_hold() if inertial else []
    for own, refinements in holding:
        if result := _if_converged(runs, vessel, own, say):
            why = "it predicts the other half of the logs no worse than multi-step output error"
            vessel, result, left_out = _without_nothing(runs, search, own, result, say)
            trials = search.trials(WINDOWS, refinements)
            return ChosenFit(vessel, own, result, why, trials, halves.horizon_s, left_out=left_out)
        why = f"the fit of {WINDOWS} does not converge"
    if inertial and not holding:
        why = f"it predicts the other half of the logs better than the fit of {WINDOWS}"
    return _by_multi_step(runs, search, halves, why, say)


def _without_nothing(
    runs: Sequence[Run], search: TrialSearch, settings: FitSettings, result: FitResult, say: Say
) -> tuple[VesselFile, FitResult, tuple[str, ...]]:
    """Model and fit without the refinements of which all runs together show nothing, and their names."""
    left_out = nothing_of(result, search.chosen)
    vessel = with_refinements(search.bare, set(search.chosen) - left_out)
    again = _if_converged(runs, vessel, settings, say) if left_out else None
    return (vessel, again, tuple(sorted(left_out))) if again else (search.model, result, ())


def _ask_compass(search: TrialSearch, runs: Sequence[Run], vessel: VesselFile) -> None:
    """Try the heading put right, where the compass clearly errs by how the boat is turned."""
    iron = hard_iron(list(runs), vessel)
    if iron is None or not iron.is_clear:
        return
    put_right = iron.put_right(vessel)
    imu = put_right.sensors.imu
    if max(abs(imu.hard_iron_cos_rad), abs(imu.hard_iron_sin_rad)) > MOST_HARD_IRON_RAD:
        return
    if (halves := folds(runs, put_right)) is not None:
        search.measured_by(COMPASS, put_right, halves)


def _by_multi_step(runs: Sequence[Run], search: TrialSearch, halves: Halves, why: str, say: Say) -> ChosenFit:
    """Multi-step output error of all runs that are long enough for it."""
    settings = multi_step(search.settings, halves.horizon_s)
    long_enough = [reaches(run, halves.horizon_s) for run in runs]
    short = tuple(run.meta.source for run, enough in zip(runs, long_enough, strict=True) if not enough)
    long = [run for run, enough in zip(runs, long_enough, strict=True) if enough]
    result = fit_structured(long, search.model, settings, say)
    trials = search.trials(MULTI_STEP, search.chosen)
    return ChosenFit(search.model, settings, result, why, trials, halves.horizon_s, short)


def _short(runs: Sequence[Run], vessel: VesselFile, settings: FitSettings, inertial: bool, say: Say) -> ChosenFit:
    """Logs that are too short for halves."""
    why = "the logs are too short to be divided into halves that predict each other"
    if inertial and (result := _if_converged(runs, vessel, settings, say)):
        return ChosenFit(vessel, settings, result, why)
    settings = multi_step(settings, HORIZONS_S[-1] if inertial else HORIZONS_S[0])
    return ChosenFit(vessel, settings, fit_structured(runs, vessel, settings, say), why)


def _if_converged(runs: Sequence[Run], vessel: VesselFile, settings: FitSettings, say: Say) -> FitResult | None:
    """The fit of windows; None where it has no solution or does not converge."""
    try:
        result = fit_structured(runs, vessel, replace(settings, horizon_s=0.0), say)
    except np.linalg.LinAlgError:
        return None
    return result if result.converged else None
