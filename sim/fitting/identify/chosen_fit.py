"""The structured fit that predicts best: with which refinements, and what its model error is.

What fits a boat best cannot be read off the columns of a log: where the model lacks something, the likelihood of short
windows explains it by latent accelerations that the controller will not have, and gets worse the more sensors there are
(docs/identify.md). So it is tried, on halves of the fitted logs that are not fitted at the time (`folds`):

    1. multi-step output error of each half, judged by its predictions of the other: the model as it is, and with each
       of the refinements that the file lacks; the best is kept while it gains `WORTH` and helps in both halves
    2. the fit of windows of that model (white noise, latent acceleration), where there are inertial sensors, in the
       same way. It is kept, for where the model is right it is the more accurate, unless multi-step output error
       predicts better by `NO_WORSE`

    score = mean over position, heading, u, v, r of log(rms error of 0.5 to 15 s ahead)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.engine.parameters import Parameters
from sim.fitting.engine.windows import StructuredFitError
from sim.fitting.identify.folds import HORIZONS_S, Halves, folds
from sim.fitting.identify.horizon import HorizonFit, error_sigma, reaches, solve, with_tag_fixed
from sim.fitting.identify.refinements import Refinement, missing
from sim.fitting.identify.result import INERTIAL, FitResult, fit_structured
from sim.fitting.identify.structured_fit import WINDOWS_S, FitSettings, Say

WORTH = 0.05
"""Relative gain in predictions of unseen data that is worth a refinement. On simulated boats without any, chance gained
up to 4 % where sensors had errors that no model has (0.3 m/s2 of coloured acceleration, 150 s logs)."""
NO_WORSE = 0.03
"""Relative difference in predictions below which the fit of windows is kept; assumed."""
STEPS = 25
"""Gauss-Newton steps of a trial at most; assumed."""
MULTI_STEP, WINDOWS = "multi-step output error", "short windows with a latent acceleration"
INERTIA = {"M11_kg": (None, 0.2), "M22_kg": (None, 0.25)}
"""Priors for multi-step output error, which knows little of inertia: a boat can be weighed, and its added mass is a
share of that mass. Assumed."""


@dataclass(frozen=True)
class Trial:
    """One model that was tried.

    `error`: of its predictions, over that of the model as it is by multi-step output error; `halves`: of each half by
    what was fitted to the other. inf: it ran away, has no solution, or did not converge.
    """

    method: str
    refinements: tuple[str, ...]
    error: float
    halves: tuple[float, float]
    kept: bool = False


@dataclass(frozen=True)
class ChosenFit:
    """The chosen fit: the vessel with its refinements, at first guess, the settings, the result.

    `trials`: all that were tried, by predictions up to `horizon_s` ahead (0: none were); `why`: as it was chosen;
    `too_short`: runs that were left out because nothing in them can be predicted so far ahead.
    """

    vessel: VesselFile
    settings: FitSettings
    result: FitResult
    why: str
    trials: tuple[Trial, ...] = ()
    horizon_s: float = 0.0
    too_short: tuple[str, ...] = ()

    @property
    def method(self) -> str:
        """How it was fitted."""
        return MULTI_STEP if self.result.horizon_s else WINDOWS

    @property
    def refinements(self) -> tuple[str, ...]:
        """Names of the refinements that were kept."""
        return next((trial.refinements for trial in self.trials if trial.kept), ())


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
    # 1. Refinements.
    search = _Search(halves, vessel, settings, say)
    search.refine()
    vessel, settings = search.model, search.settings
    # 2. Method.
    why = "no inertial sensor was logged"
    if inertial and search.windows_hold():
        if result := _if_converged(runs, vessel, settings, say):
            why = "it predicts the other half of the logs no worse than multi-step output error"
            return ChosenFit(vessel, settings, result, why, search.trials(WINDOWS), halves.horizon_s)
        why = f"the fit of {WINDOWS} does not converge"
    elif inertial:
        why = f"it predicts the other half of the logs better than the fit of {WINDOWS}"
    settings = _multi_step(settings, halves.horizon_s)
    long_enough = [reaches(run, halves.horizon_s) for run in runs]
    short = tuple(run.meta.source for run, enough in zip(runs, long_enough, strict=True) if not enough)
    long = [run for run, enough in zip(runs, long_enough, strict=True) if enough]
    result = fit_structured(long, vessel, settings, say)
    return ChosenFit(vessel, settings, result, why, search.trials(MULTI_STEP), halves.horizon_s, short)


def _short(runs: Sequence[Run], vessel: VesselFile, settings: FitSettings, inertial: bool, say: Say) -> ChosenFit:
    """Logs that are too short for halves."""
    why = "the logs are too short to be divided into halves that predict each other"
    if inertial and (result := _if_converged(runs, vessel, settings, say)):
        return ChosenFit(vessel, settings, result, why)
    settings = _multi_step(settings, HORIZONS_S[-1] if inertial else HORIZONS_S[0])
    return ChosenFit(vessel, settings, fit_structured(runs, vessel, settings, say), why)


def _if_converged(runs: Sequence[Run], vessel: VesselFile, settings: FitSettings, say: Say) -> FitResult | None:
    """The fit of windows; None where it has no solution or does not converge."""
    try:
        result = fit_structured(runs, vessel, replace(settings, horizon_s=0.0), say)
    except np.linalg.LinAlgError:
        return None
    return result if result.converged else None


class _Search:
    """The trials of both steps above; `model`, `settings`: of the best so far."""

    def __init__(self, halves: Halves, vessel: VesselFile, settings: FitSettings, say: Say) -> None:
        self.halves, self.model, self.settings, self._say = halves, vessel, settings, say
        self._chosen: tuple[str, ...] = ()
        self._plain = self._score(vessel, settings)
        self._best = self._plain
        self._trials = [self._trial(MULTI_STEP, (), self._plain)]

    @staticmethod
    def _silent(_text: str, _share: float) -> None:
        """No progress of a trial."""

    def refine(self) -> None:
        """Take refinements, the best first, while they are worth it."""
        left = missing(self.model)
        while left:
            tried = [(self._tried(each), each) for each in left]
            self._trials += [self._trial(MULTI_STEP, (*self._chosen, r.name), score) for score, r in tried]
            score, best = min(tried, key=lambda pair: pair[0].sum())
            gain = self._best - score
            if not (gain.mean() > WORTH and gain.min() > 0.0):
                return
            self.model, self.settings = self._with(best)
            self._best, self._chosen = score, (*self._chosen, best.name)
            left.remove(best)

    def windows_hold(self) -> bool:
        """Whether the fit of windows predicts no worse; one without a solution, or not converged, does not."""
        settings = replace(self.settings, horizon_s=0.0, window_s=WINDOWS_S[0])
        try:
            found = [fit_structured(runs, self.model, settings, self._silent) for runs in self.halves.runs]
        except (StructuredFitError, np.linalg.LinAlgError):
            found = []
        score = np.full(2, np.inf)
        if found and all(one.converged for one in found):
            parameters = with_tag_fixed(Parameters(self.model))
            fits = [HorizonFit(half, parameters) for half in self.halves.targets]
            score = _crossed(fits, [parameters.unconstrained(one.q) for one in found])
        self._trials.append(self._trial(WINDOWS, self._chosen, score))
        return float((score - self._best).mean()) < NO_WORSE

    def trials(self, method: str) -> tuple[Trial, ...]:
        """All trials, with the mark of the one that is kept."""
        return tuple(replace(t, kept=(t.method, t.refinements) == (method, self._chosen)) for t in self._trials)

    def _tried(self, refinement: Refinement) -> np.ndarray:
        self._say(f"trying {', '.join((*self._chosen, refinement.name))}", 0.0)
        return self._score(*self._with(refinement))

    def _with(self, refinement: Refinement) -> tuple[VesselFile, FitSettings]:
        overrides = {**self.settings.overrides, **refinement.priors}
        return refinement.applied(self.model), replace(self.settings, overrides=overrides)

    def _score(self, vessel: VesselFile, settings: FitSettings) -> np.ndarray:
        """Score of each half, (2,), by what was fitted to the other."""
        settings = _multi_step(settings, self.halves.horizon_s)
        parameters = with_tag_fixed(settings.parameters(vessel))
        fits = [HorizonFit(half, parameters) for half in self.halves.targets]
        try:
            w = [solve(fit, STEPS, self._silent)[0].w for fit in fits]
        except (StructuredFitError, np.linalg.LinAlgError):
            return np.full(2, np.inf)
        return _crossed(fits, w)

    def _trial(self, method: str, refinements: tuple[str, ...], score: np.ndarray) -> Trial:
        a, b = np.exp(score - self._plain)
        return Trial(method, refinements, float(np.exp((score - self._plain).mean())), (float(a), float(b)))


def _multi_step(settings: FitSettings, horizon_s: float) -> FitSettings:
    """The settings for multi-step output error."""
    return replace(settings, horizon_s=horizon_s, overrides={**INERTIA, **settings.overrides})


def _crossed(fits: Sequence[HorizonFit], w: Sequence[np.ndarray]) -> np.ndarray:
    """Score of each half (2,) by the parameters w that were fitted to the other."""
    return np.array([_error(fits[0], w[1]), _error(fits[1], w[0])])


def _error(fit: HorizonFit, w: np.ndarray) -> float:
    """The score of parameters w on the windows of `fit`."""
    with np.errstate(all="ignore"):
        sigma = error_sigma(fit.point(w).error)[1:]
    return float(np.log(sigma).mean()) if np.isfinite(sigma).all() else np.inf
