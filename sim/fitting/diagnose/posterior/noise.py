"""The noise card: stated by the file; white noise from residual quantiles, latent acceleration by maximum evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from companion.logs.runs.splits import source_runs
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.engine.linearise import HUBER
from sim.fitting.engine.noise import Noise, noise_of
from sim.fitting.identify.structured_fit import with_latent

Q90 = 1.644854  # 90 % of a normal distribution lie within so many sigmas
WITHIN = (0.2, 10.0)  # range of estimated over stated white noise; assumed
START = (0.02, 0.02, 0.03)  # initial latent acceleration [m/s^2, m/s^2, rad/s^2]; assumed
FLOOR = (5e-4, 5e-4, 5e-4)  # least latent acceleration [same units]; assumed
LATENTS = (1.0, 0.3, 0.1)  # scales tried for a candidate, which takes over part of the latent acceleration; assumed
REACH = 1.0  # half width of the first parabola, of the logarithm
SWEEPS, SETTLED = 5, 0.15
UNKNOWN_LEAN = 0.4  # m/s^2 of a boat that rolls and pitches by 2 degrees that nobody knows; assumed
LAGS, COLOURED = 100, 0.1  # lags of an autocorrelation at most; value from which it counts; assumed
OFFSET_RAD = 0.002  # sigma of the heading's offset between logs; assumed
SLACK = 5.0  # a fifth of a usual latent acceleration, 0.02 m/s^2, over a second


def stated_noise(vessel: VesselFile, runs: Sequence[Run] = ()) -> Noise:
    """Noise as the vessel file states it, with the initial latent acceleration.

    The latent acceleration is constant over a window, whereas disturbances vary within it: `SLACK` lets states jump
    between windows accordingly. A heading offset common to all logs is an effect, not noise.

    `runs`: what is fitted. Each piece of a log has biases and offsets of its own; their sigmas grow with the root of
    pieces per log, so that all pieces together carry no more information on a common bias than their one log.
    """
    share = np.sqrt(len(runs) / len(source_runs(runs))) if runs else 1.0
    noise = noise_of(vessel)
    x, y, n = (share * sigma for sigma in noise.bias)
    return replace(with_latent(noise, np.array(START)), slack=SLACK, bias=(x, y, n), offset_rad=share * OFFSET_RAD)


def latent_scales(noise: Noise) -> list[Noise]:
    """`noise` with its latent acceleration times each of `LATENTS`, at least `FLOOR`; the first is `noise` itself."""
    latent = np.array(noise.latent)
    return [noise, *(with_latent(noise, np.maximum(share * latent, FLOOR)) for share in LATENTS[1:])]


def estimated_white_noise(noise: Noise, point: LinearisationPoint, stated: Noise) -> Noise:
    """`noise` with white noise from the 90 % quantiles of the residuals at `point`, which outliers hardly move.

    n fixes whose errors hang together carry the information of n / (1 + 2 sum of their autocorrelations) independent
    ones (effective sample size): their sigma is enlarged to match.
    """
    white = [
        _bounded(now, point.residuals[..., c], said)
        for c, (now, said) in enumerate(zip(noise.white, stated.white, strict=True))
    ]
    fix = _bounded(noise.fix_m, point.fix_residuals, stated.fix_m, float(np.sqrt(dependence(point.fix_residuals))))
    return replace(noise, white=(white[0], white[1], white[2], white[3]), fix_m=fix)


def with_unknown_lean(noise: Noise) -> Noise:
    """`noise` for logs whose roll and pitch are missing or false: accelerometers count for little beyond a bias."""
    psi, r, a_x, a_y = noise.white
    return replace(noise, white=(psi, r, max(a_x, UNKNOWN_LEAN), max(a_y, UNKNOWN_LEAN)))


def _bounded(sigma: float, residuals: np.ndarray, stated: float, share: float = 1.0) -> float:
    """sigma times `share` and the 90 % quantile of |residuals| over a unit normal's, within `WITHIN` of `stated`."""
    known = np.abs(residuals[np.isfinite(residuals)])
    if not len(known):
        return sigma
    return float(np.clip(sigma * share * np.quantile(known, 0.9) / Q90, WITHIN[0] * stated, WITHIN[1] * stated))


def dependence(residuals: np.ndarray) -> float:
    """1 + 2 sum of the autocorrelations of residuals (m, 2) in order of time: m over its effective size.

    The sum ends at the first autocorrelation that is not clearly above chance, `LAGS` at most.
    """
    known = np.clip(residuals[np.isfinite(residuals).all(axis=1)], -HUBER, HUBER)
    power, total = float((known**2).sum()), 0.0
    for lag in range(1, min(LAGS, len(known) // 4)):
        rho = float((known[lag:] * known[:-lag]).sum()) / max(power, 1e-12)
        if rho < max(COLOURED, 2 / np.sqrt(known.size)):
            break
        total += rho
    return 1 + 2 * total


def estimated_latent(fit: PosteriorFit, point: LinearisationPoint) -> Noise:
    """The fit's noise with the latent acceleration of greatest evidence at `point`.

    Coordinate-wise: the vertex of a parabola through three values along each axis of log sigma, at most `SWEEPS` times,
    half as wide once the vertices lie within it.
    """
    at = np.log(np.maximum(np.array(fit.noise.latent), FLOOR))

    def evidence(at: np.ndarray) -> float:
        return fit.nodes_evidence(point, with_latent(fit.noise, np.exp(at)))

    value, reach = evidence(at), REACH
    for _ in range(SWEEPS):
        moves = np.array([_vertex(evidence, at, value, axis, reach) for axis in range(3)])
        trial = np.maximum(at + moves, np.log(FLOOR))
        new = evidence(trial)
        if new > value:
            at, value = trial, new
        if np.abs(moves).max() < reach:
            reach /= 2
        if np.abs(moves).max() < SETTLED or reach < SETTLED:
            break
    return with_latent(fit.noise, np.exp(at))


def _vertex(evidence: Callable[[np.ndarray], float], at: np.ndarray, value: float, axis: int, reach: float) -> float:
    """Displacement to the vertex of the parabola through three values along one axis, at most twice `reach`."""
    step = reach * np.eye(3)[axis]
    ahead, behind = evidence(at + step) - value, evidence(at - step) - value
    bend = ahead + behind
    if bend >= 0:
        return 2 * reach if ahead > behind else -2 * reach
    return float(np.clip(reach * (behind - ahead) / (2 * bend), -2 * reach, 2 * reach))
