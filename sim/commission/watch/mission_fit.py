"""What one mission's log says of the boat: a normal likelihood of the watched parameters, all else eliminated.

The engine is that of a diagnosis (`sim.fitting.diagnose.posterior`), with the file as base and few entries of its
catalogue. theta (B,): watched parameters of the boat, zero as in the file. What belongs to the day (current, wind,
compass, biases) is fitted for this log alone and eliminated:

    -log p(log | theta) = 1/2 theta^T Lambda theta - eta^T theta + constant
    Lambda = H_bb - H_bd (H_dd + L_d)^-1 H_db,    L_d: prior precision of the day's parameters

Model error counts as latent acceleration, whose size is estimated from this log: in gusts and waves a log says less.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import catalogue, hull, propulsion
from sim.fitting.diagnose.catalogue.effect import Effect, parameter_slices
from sim.fitting.diagnose.posterior.evidence import ReducedNormalEquations
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.noise import (
    estimated_latent,
    estimated_white_noise,
    stated_noise,
)
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.vessel_edits.public_form import family
from sim.fitting.engine.parameters import HULL
from sim.fitting.engine.split import NamedLog, split_at_pauses, usable
from sim.fitting.wiring.levelling import levelled

WINDOW_S = 0.5
LATENT_TIME_S = 0.5
"""Correlation time of the latent acceleration: short, as waves are. The controller answers waves, and what they have in
common with its thrust must not count as thrust; assumed."""
OF_BOAT = ("thruster_gain", "hull_fouling", "payload", "dead_time", "lag")
"""Families of the catalogue that are watched, beside the coefficients of the hull."""
OF_DAY = ("current", "wind")
"""Families that are fitted for each log with their wide priors: weather differs from mission to mission."""
ASTRAY = 3.5  # sigmas from which a position is left out: one of 450 sound ones; assumed
MEDIAN_LENGTH = 1.1774  # of a vector of two normal components of sigma 1
ROUNDS = (3, 2, 2)  # Gauss-Newton steps between estimates of the noise


@dataclass(frozen=True)
class MissionInformation:
    """Likelihood of theta by one log: names of its B entries, Lambda (B, B), eta (B,); module docstring.

    day     estimates of the day's parameters, by `effect.parameter`
    latent  latent acceleration [m/s^2, m/s^2, rad/s^2] by which the log was weighed
    thrust  rms acceleration by the thrusters, the same units
    """

    names: tuple[str, ...]
    precision: np.ndarray
    eta: np.ndarray
    day: Mapping[str, float]
    latent: tuple[float, float, float]
    thrust: tuple[float, float, float]


def boat_effects(vessel: VesselFile) -> list[Effect]:
    """Watched entries of the catalogue, in the order of theta: what belongs to the boat, and is remembered."""
    entries = (*hull.base(vessel), *hull.effects(vessel), *propulsion.effects(vessel, ()))
    return [e for e in entries if e.always_free and _is_watched(e)]


def _is_watched(effect: Effect) -> bool:
    return family(effect.name) in OF_BOAT or effect.id.removeprefix("base:") in HULL


def _of_day(effect: Effect) -> bool:
    return effect.family in ("sensors", "base") or family(effect.name) in OF_DAY


def mission_information(run: Run, vessel: VesselFile) -> MissionInformation:
    """Fit the log `run` of the boat of `vessel`; what it says of theta. It depends on no other log.

    Roll and pitch that follow the boat's own acceleration are left out; what a lean that nobody knows adds to the noise
    of accelerometers is estimated with it. Raises JobError, StructuredFitError, RunError.
    """
    (log,) = levelled([usable(NamedLog(run.meta.source, run), vessel)])
    runs = split_at_pauses(log.run)
    effects = [e for e in catalogue(vessel, runs) if e.always_free and (_is_watched(e) or _of_day(e))]
    stated = replace(stated_noise(vessel, runs), latent_time_s=LATENT_TIME_S)
    fit = PosteriorFit(EffectPhysics(runs, vessel, WINDOW_S), effects, stated)
    point = _solved(fit, effects, None)
    if (astray := _astray(fit, point)).any():
        fit = PosteriorFit(EffectPhysics(_without(fit, runs, astray), vessel, WINDOW_S), effects, stated)
        point = _solved(fit, effects, point)
    pushed = fit.physics.drive(point.state.forces.f)[..., :3] @ point.state.M_inv.T
    found = _eliminated(fit, effects, fit.reduced(point, effects))
    surge, sway, yaw = np.sqrt((pushed**2).mean(axis=(0, 1))).tolist()
    return replace(found, thrust=(surge, sway, yaw))


def _solved(fit: PosteriorFit, effects: Sequence[Effect], near: LinearisationPoint | None) -> LinearisationPoint:
    """Motion and noise of the log, watched and day's parameters with wide priors; `near`: where to start."""
    stated = fit.noise
    active = frozenset(e.id for e in effects if family(e.name) in (*OF_BOAT, *OF_DAY))
    theta: ParameterValues = near.theta if near else {}
    z, point = near.z if near else fit.z0, None
    for slack in () if near else (100.0, 10.0):  # loose ties at first: the motion follows the data, then the model
        fit.noise = replace(stated, slack=slack)
        point = fit.solve(theta, z, effects, active, steps=1, before=point)
        theta, z = point.theta, point.z
    fit.noise = stated
    for steps in ROUNDS:
        point = fit.solve(theta, z, effects, active, steps=steps, before=point)
        theta, z = point.theta, point.z
        fit.noise = estimated_white_noise(fit.noise, point, stated)
        fit.noise = estimated_latent(fit, point)
        fit.count_degrees_of_freedom(point)
    return fit.point(theta, z, effects, point).without_columns()


def _astray(fit: PosteriorFit, point: LinearisationPoint) -> np.ndarray:
    """Mask (m,) of the positions too far off to be noise, as of ranges without line of sight.

    Huber's loss leaves them a pull to one side, which over a leg of a minute is a wrong speed and so a wrong drag.
    """
    off_m = fit.noise.fix_m * np.linalg.norm(point.fix_residuals, axis=1)
    sigma_m = max(float(np.nanmedian(off_m)) / MEDIAN_LENGTH, fit.physics.vessel.sensors.position_sigma_m)
    return off_m > ASTRAY * sigma_m


def _without(fit: PosteriorFit, runs: Sequence[Run], astray: np.ndarray) -> list[Run]:
    """The runs without the positions `astray` (m,)."""
    fixes, out = fit.physics.windows.fixes, []
    for i, run in enumerate(runs):
        gone = pl.col("t_s").is_in(fixes.t_s[astray & (fixes.run == i)].tolist())
        blank = [pl.when(gone).then(None).otherwise(pl.col(c)).alias(c) for c in ("north_m", "east_m")]
        out.append(Run(run.table.with_columns(blank), run.meta, run.whole))
    return out


def _eliminated(fit: PosteriorFit, effects: Sequence[Effect], reduced: ReducedNormalEquations) -> MissionInformation:
    """The day's parameters eliminated with their priors, at all values of theta."""
    at = parameter_slices(effects)
    boat = np.concatenate([np.arange(at[e.id].start, at[e.id].stop) for e in effects if _is_watched(e)])
    day_effects = [e for e in effects if not _is_watched(e)]
    day = np.concatenate([np.arange(at[e.id].start, at[e.id].stop) for e in day_effects])
    active = frozenset(e.id for e in day_effects if family(e.name) in OF_DAY)
    prior = fit.prior(day_effects, active)
    H, h = reduced.H, reduced.b + reduced.H @ reduced.theta0
    joint = H[np.ix_(day, day)] + np.diag(prior.precision)
    gain = np.linalg.solve(joint, np.column_stack([H[np.ix_(day, boat)], h[day] + prior.precision * prior.mean]))
    precision = H[np.ix_(boat, boat)] - H[np.ix_(boat, day)] @ gain[:, :-1]
    eta = h[boat] - H[np.ix_(boat, day)] @ gain[:, -1]
    names = [p for e in day_effects for p in (f"{e.id}.{q.name}" for q in e.parameters)]
    return MissionInformation(
        names=tuple(e.id for e in effects if _is_watched(e)),
        precision=(precision + precision.T) / 2,
        eta=eta,
        day=dict(zip(names, (reduced.theta0[day]).tolist(), strict=True)),
        latent=fit.noise.latent,
        thrust=(0.0, 0.0, 0.0),
    )
