"""Stochastic causes: waves, gusts, fixes without line of sight, each with a likelihood test of its own.

No Jacobian column can express them, so the search over the catalogue neither finds them nor is robust against them:

1. at the base model, before the search: `nlos_cause`, whose `fix_weight` down-weights such fixes from then on;
2. at the final model with its causes: `stochastic_causes`, waves and, where a wind was found, its gusts.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.model.effects.wind import RHO_AIR
from sim.fitting.diagnose.catalogue.effect import Effect, Scene
from sim.fitting.diagnose.catalogue.parts import air_force
from sim.fitting.diagnose.catalogue.stochastic import GUSTY_WIND, NLOS, WAVES
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import dependence
from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS, Z95, Candidate
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.fitting.diagnose.stochastic_effects import gusts as gusty
from sim.fitting.diagnose.stochastic_effects import nlos, waves
from sim.fitting.diagnose.stochastic_effects.residual_acceleration import ResidualAcceleration, residual_acceleration
from sim.fitting.engine.windows import SURGE, SWAY

PERIOD_DOUBT = 2.0  # factor on the standard error of a period, for the unknown shape of the spectrum; assumed
IN_SIGHT = 0.5  # probability of line of sight from which a fix counts as one that has it
COMPASS_DEG = 0.7  # sigma of a compass error below its smallest size, and thus of every direction; assumed
DIRECTION_DOUBT_DEG = 1.5  # sigma of a gusty wind's direction beside the fit's, which takes gusts for noise; assumed


@dataclass(frozen=True)
class StochasticCause:
    """One stochastic cause.

    effect, candidate    entry and its score
    form_doubtful        the family is right, but the waves' spectrum is broader than the entry's
    replaces             name of the cause of the search that it replaces
    fix_weight           (m,) probability that each fix has line of sight
    """

    effect: Effect
    candidate: Candidate
    form_doubtful: bool = False
    replaces: str = ""
    fix_weight: np.ndarray | None = None


def stochastic_causes(
    fit: PosteriorFit, model: CandidateModel, causes: Sequence[Candidate] = (), sure: Collection[str] = ()
) -> list[StochasticCause]:
    """Stochastic causes that can be named at `model`, in order of evidence. `causes`: active ones of the search.

    They need `DECISIVE_NATS`, more than causes of the search, since they mask groups of the adequacy check. `sure`:
    names of those that are present for sure, however small.
    """
    found = [nlos_cause(fit, model)]
    if has_accelerations(model):
        wind = [c for c in causes if c.id == "wind"]
        found.append(wave_cause(fit, model, WAVES.name in sure))
        found += [gust_cause(fit, model, c, GUSTY_WIND.name in sure) for c in wind]
    named = [c for c in found if c is not None and (c.effect.name in sure or _accepted(c.candidate))]
    return sorted(named, key=lambda c: -c.candidate.nats)


def has_accelerations(model: CandidateModel) -> bool:
    """Whether accelerations were measured, without which waves and gusts cannot be tested."""
    return bool(np.isfinite(model.point.residuals[..., SURGE : SWAY + 1]).any())


def _accepted(candidate: Candidate) -> bool:
    return candidate.accepted and candidate.nats >= DECISIVE_NATS


def nlos_cause(fit: PosteriorFit, model: CandidateModel) -> StochasticCause | None:
    """Fixes without line of sight to the anchor that explains them best, with `fix_weight`; None without anchors.

    Its nats are those of as many independent fixes as the errors of those in sight are worth: where a cause that is not
    found yet moves the boat, they hang together, and then a few seconds of them look as if an anchor were hidden.
    """
    if fit.physics.vessel.sensors.uwb is None:
        return None
    places, fix_m = fit.physics.windows.fixes.place_m, model.noise.fix_m
    anchors = nlos.anchors_of(fit.physics.runs, places)
    residuals = model.point.fix_residuals
    best = nlos.fit_anchors(-residuals * fix_m, places, fix_m, anchors)[0]
    nats = best.nats / dependence(np.where(best.line_of_sight[:, None] > IN_SIGHT, residuals, np.nan))
    at, C = best.posterior.at[nlos.OWN][:2], best.posterior.covariance[nlos.OWN, nlos.OWN][:2, :2]
    values = np.array([best.share, np.exp(at[1]), best.number])
    slope = np.array([best.share * (1 - best.share), values[1]])
    return StochasticCause(
        NLOS, _candidate(NLOS, nats, values, C * np.outer(slope, slope)), fix_weight=best.line_of_sight
    )


def wave_cause(fit: PosteriorFit, model: CandidateModel, sure: bool = False) -> StochasticCause | None:
    """Waves by screening, then by a fit of the likelihood; None where either rejects them, unless they are `sure`."""
    whole = residual_acceleration(fit, model, waves.STEP_S, np.inf)
    seen = waves.screen_waves(whole)
    if not sure and (seen.nats < waves.QUICK_NATS or seen.F_w_N < waves.SMALLEST_N):
        return None
    found = waves.fit_waves(residual_acceleration(fit, model, waves.STEP_S, waves.BLOCK_S), seen)
    if not sure and found.width > waves.MOST_WIDTH:
        return None
    F_w, share = waves.rms_force(whole, found.beta_rad, found.T_p_s)
    own = found.posterior.covariance[[waves.T_P, waves.BETA], [waves.T_P, waves.BETA]]
    sigma = np.array(
        [F_w * share, PERIOD_DOUBT * found.T_p_s * np.sqrt(own[0]), np.hypot(np.degrees(np.sqrt(own[1])), COMPASS_DEG)]
    )
    values = np.array([F_w, found.T_p_s, np.degrees(found.beta_rad)])
    nats = min(found.nats, found.over_body_fixed)
    doubt = found.broad or waves.beside_peak(whole, found.beta_rad, found.T_p_s) > waves.OTHER
    return StochasticCause(WAVES, _candidate(WAVES, nats, values, np.diag(sigma**2)), form_doubtful=doubt)


def gust_cause(fit: PosteriorFit, model: CandidateModel, wind: Candidate, sure: bool = False) -> StochasticCause | None:
    """Gusts of the wind that the search found, with nats over a steady wind; None where too small, unless `sure`."""
    pressure = float(np.hypot(*wind.values))
    if pressure <= 0:
        return None
    speed, beta = (
        float(np.sqrt(2 * pressure / RHO_AIR)),
        float(np.degrees(np.arctan2(-wind.values[1], -wind.values[0]))),
    )
    data = residual_acceleration(fit, model, gusty.STEP_S, gusty.BLOCK_S)
    found = gusty.fit_gusts(data, _wind_along(fit, data, speed, beta))
    gustiness, time = gusty.gustiness_of(found.size), found.gust_time_s
    along = wind.values / pressure
    across = np.array([-along[1], along[0]])
    of_engine = float(np.sqrt(along @ wind.covariance @ along)) / pressure / 2
    of_gusts = gustiness * np.sqrt(2 * time / data.span_s)  # sampling error of the mean over few gusts
    share = float(np.hypot(of_engine, of_gusts))
    values = np.array([speed / np.sqrt(1 + gustiness**2), beta % 360, gustiness, time])
    sigma = np.array([
        values[0] * share,
        np.hypot(np.degrees(np.sqrt(across @ wind.covariance @ across)) / pressure, DIRECTION_DOUBT_DEG),
        gustiness * np.hypot(gusty.size_error(time, data.span_s), 2 * share),
        time * np.sqrt(found.posterior.covariance[gusty.TIME, gusty.TIME]),
    ])  # fmt: skip
    candidate = _candidate(GUSTY_WIND, found.nats, values, np.diag(sigma**2))
    return StochasticCause(GUSTY_WIND, candidate, replaces="wind") if sure or gustiness > gusty.SMALLEST else None


def _wind_along(fit: PosteriorFit, data: ResidualAcceleration, speed: float, beta_deg: float) -> np.ndarray:
    T, _, B = data.x.shape
    none = np.zeros((T, B))
    scene = Scene(none, none, data.x.transpose(0, 2, 1), np.zeros((T, B, 3)), np.zeros(T), np.zeros(2), 0.0)
    force = air_force(fit.physics.vessel, scene, speed, beta_deg) - air_force(fit.physics.vessel, scene, 0.0, beta_deg)
    return force.transpose(0, 2, 1)


def _candidate(effect: Effect, nats: float, values: np.ndarray, covariance: np.ndarray) -> Candidate:
    """Candidate with `values` (k,), whose first parameter is the size; `covariance` of the first ones."""
    smallest = effect.parameters[0].smallest
    full = np.zeros((len(values), len(values)))
    full[: len(covariance), : len(covariance)] = covariance
    size = float(values[0]) / smallest
    lower = max(size - Z95 * float(np.sqrt(full[0, 0])) / smallest, 0.0)
    return Candidate(effect.id, nats, nats, values, full, size, lower)
