"""Trials on halves of the logs, each judged by its predictions of the half that it was not fitted to.

score = mean over position, heading, u, v, r of log(rms error of 0.5 to 15 s ahead)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from sim.fitting.engine.free_parameters import HARD_IRON
from sim.fitting.engine.windows import StructuredFitError
from sim.fitting.identify.folds import Halves
from sim.fitting.identify.horizon import HorizonFit, error_sigma, solve, with_tag_fixed
from sim.fitting.identify.refinements import UNMEASURED_BOAT, Refinement, missing
from sim.fitting.identify.result import fit_structured
from sim.fitting.identify.structured_fit import UNMEASURED, WINDOWS_S, FitSettings, Say

WORTH = 0.05
"""Relative gain in predictions of unseen data that is worth a refinement. On simulated boats without any, chance gained
up to 4 % where sensors had errors that no model has (0.3 m/s2 of coloured acceleration, 150 s logs)."""
NO_WORSE = 0.03
"""Relative difference in predictions that does not count; assumed."""
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


def multi_step(settings: FitSettings, horizon_s: float) -> FitSettings:
    """The settings for multi-step output error."""
    return replace(settings, horizon_s=horizon_s, overrides={**INERTIA, **settings.overrides})


class TrialSearch:
    """The trials. `model`, `settings`, `chosen` (refinements): of the best so far; `bare`: the model without them."""

    def __init__(self, halves: Halves, vessel: VesselFile, settings: FitSettings, say: Say) -> None:
        self.halves, self.model, self.settings, self._say = halves, vessel, settings, say
        self.bare = vessel
        self.chosen: tuple[str, ...] = ()
        self._plain = self._multi_step(vessel, settings)
        self._best = self._plain
        self._trials = [self._trial(MULTI_STEP, (), self._plain)]

    @staticmethod
    def _silent(_text: str, _share: float) -> None:
        """No progress of a trial."""

    def measured_by(self, name: str, vessel: VesselFile, halves: Halves) -> None:
        """Try `vessel`, whose sensors err otherwise, so that `halves` are others; `name`: the refinement."""
        before, self.halves = self.halves, halves
        score = self._multi_step(vessel, self.settings)
        self._trials.append(self._trial(MULTI_STEP, (name,), score))
        if _worth(self._best, score):
            self.model, self._best, self.chosen = vessel, score, (name,)
        else:
            self.halves = before

    def refine(self) -> None:
        """Take refinements, the best first, while they are worth it."""
        self.bare, left = self.model, missing(self.model, (run for half in self.halves.runs for run in half))
        while left:
            tried = [(self._tried(each), each) for each in left]
            self._trials += [self._trial(MULTI_STEP, (*self.chosen, r.name), score) for score, r in tried]
            score, best = min(tried, key=lambda pair: pair[0].sum())
            if not _worth(self._best, score):
                return
            self.model, self.settings = self._with(best)
            self._best, self.chosen = score, (*self.chosen, best.name)
            left.remove(best)

    def windows_that_hold(self) -> list[tuple[FitSettings, tuple[str, ...]]]:
        """Settings of fits of windows that predict no worse than multi-step output error, and their refinements.

        The best first: as the settings have it, where an unmeasured boat in the weather of a day is not worth it.
        """
        found = []
        for settings, names in ((self.settings, self.chosen), (self._unmeasured(), (*self.chosen, UNMEASURED_BOAT))):
            self._say("trying short windows", 0.0)
            score = self._windows(settings)
            self._trials.append(self._trial(WINDOWS, names, score))
            found.append((score, settings, names))
        (plain, *_), (wide, *_) = found
        order = reversed(found) if _worth(plain, wide) else found
        return [(s, names) for score, s, names in order if float((score - self._best).mean()) < NO_WORSE]

    def _unmeasured(self) -> FitSettings:
        """Settings for a boat that nobody has measured, in the weather of a day."""
        own = self.settings.sigmas
        iron = {} if self.settings.compass else dict.fromkeys(HARD_IRON, (None, 0.0))
        sigmas = replace(own, gain=max(own.gain, UNMEASURED.sigmas.gain), arm_m=max(own.arm_m, UNMEASURED.sigmas.arm_m))
        return replace(
            self.settings,
            sigmas=sigmas,
            overrides={**self.settings.overrides, **iron},
            surroundings=True,
            unmeasured_imu=True,
            heading_offset_rad=UNMEASURED.heading_offset_rad,
        )

    def trials(self, method: str, refinements: tuple[str, ...]) -> tuple[Trial, ...]:
        """All trials, with the mark of the one that is kept."""
        return tuple(replace(t, kept=(t.method, t.refinements) == (method, refinements)) for t in self._trials)

    def _tried(self, refinement: Refinement) -> np.ndarray:
        self._say(f"trying {', '.join((*self.chosen, refinement.name))}", 0.0)
        return self._multi_step(*self._with(refinement))

    def _with(self, refinement: Refinement) -> tuple[VesselFile, FitSettings]:
        overrides = {**self.settings.overrides, **refinement.priors}
        return refinement.applied(self.model), replace(self.settings, overrides=overrides)

    def _multi_step(self, vessel: VesselFile, settings: FitSettings) -> np.ndarray:
        """Score of each half, (2,), by multi-step output error of the other."""
        settings = multi_step(settings, self.halves.horizon_s)
        parameters = with_tag_fixed(settings.parameters(vessel))
        fits = [HorizonFit(half, parameters) for half in self.halves.targets]
        try:
            w = [solve(fit, STEPS, self._silent)[0].w for fit in fits]
        except (StructuredFitError, np.linalg.LinAlgError):
            return np.full(2, np.inf)
        return _crossed(fits, w)

    def _windows(self, settings: FitSettings) -> np.ndarray:
        """The same by fits of windows; inf without a solution, or where one does not converge."""
        settings = replace(settings, horizon_s=0.0, window_s=WINDOWS_S[0])
        try:
            found = [fit_structured(runs, self.model, settings, self._silent) for runs in self.halves.runs]
        except (StructuredFitError, np.linalg.LinAlgError):
            return np.full(2, np.inf)
        if not all(one.converged for one in found):
            return np.full(2, np.inf)
        parameters = with_tag_fixed(replace(settings, overrides={}).parameters(self.model))
        fits = [HorizonFit(half, parameters) for half in self.halves.targets]
        return _crossed(fits, [parameters.unconstrained(one.q) for one in found])

    def _trial(self, method: str, refinements: tuple[str, ...], score: np.ndarray) -> Trial:
        a, b = np.exp(score - self._plain)
        return Trial(method, refinements, float(np.exp((score - self._plain).mean())), (float(a), float(b)))


def _worth(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether it is worth a refinement: both halves (2,) gain in the mean, and neither loses what counts."""
    if not np.isfinite(after).all():
        return False
    gain = before - after
    return bool(gain.mean() > WORTH and gain.min() > -NO_WORSE)


def _crossed(fits: Sequence[HorizonFit], w: Sequence[np.ndarray]) -> np.ndarray:
    """Score of each half (2,) by the parameters w that were fitted to the other."""
    return np.array([_error(fits[0], w[1]), _error(fits[1], w[0])])


def _error(fit: HorizonFit, w: np.ndarray) -> float:
    """The score of parameters w on the windows of `fit`."""
    with np.errstate(all="ignore"):
        sigma = error_sigma(fit.point(w).error)[1:]
    return float(np.log(sigma).mean()) if np.isfinite(sigma).all() else np.inf
