"""Residual forces of the model over time and other variables, beside the force that the causes add.

The latent force of a window is [X Y N] = M d with its latent acceleration d; its sigma follows from the nodes'
covariance P: diag(M P_d M^T)^1/2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.model.manoeuvring import mass_matrix
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter, Hook, Values
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.engine.noise import LATENT, Noise

LAGS = 20


@dataclass(frozen=True)
class ResidualForces:
    """Residual forces of the W windows of all logs.

    t_s, clock_s    (W,) middle time of the log, and on the shared clock [s]
    log, x          (W,) index of the log, (W, 6) mean state [x y psi u v r]
    force, sigma    (W, 3) latent force and its standard error [N, N, N m]
    cause           (W, 3) mean force that the causes add there
    """

    t_s: np.ndarray
    clock_s: np.ndarray
    log: np.ndarray
    x: np.ndarray
    force: np.ndarray
    sigma: np.ndarray
    cause: np.ndarray


def residual_forces(
    fit: PosteriorFit, point: LinearisationPoint, noise: Noise, theta: ParameterValues, causes: Sequence[Effect]
) -> ResidualForces:
    """Residual forces at `point`, linearised with `noise`; force of `causes` for `theta` beyond the point's values."""
    physics = fit.physics
    M = mass_matrix(physics.vessel)
    chain, _, _ = fit.assembled(point, noise)
    variance = chain.covariance()[:, LATENT, LATENT]
    windows = physics.windows
    return ResidualForces(
        windows.t_s.mean(axis=1),
        physics.clock_s.mean(axis=1),
        windows.run,
        point.state.x.mean(axis=1),
        point.z[:, LATENT] @ M.T,
        np.sqrt(np.einsum("ij,wjk,ik->wi", M, variance, M)),
        cause_accelerations(physics, fit.effects, point, theta, causes) @ M.T,
    )


def cause_accelerations(
    physics: EffectPhysics,
    effects: Sequence[Effect],
    point: LinearisationPoint,
    theta: ParameterValues,
    causes: Sequence[Effect],
) -> np.ndarray:
    """Mean acceleration in each window that `theta` of `causes` adds at `point`, (W, 3); zero for sensor effects."""
    if not causes:
        return np.zeros((physics.windows.size[0], 3))
    whole = [_whole(effect, theta[effect.id]) for effect in causes]
    a = physics.accelerations([*effects, *whole], point.theta, point.state, whole)
    return a.nodes.sum(axis=3).mean(axis=1)


def _whole(effect: Effect, values: np.ndarray) -> Effect:
    """The effect with one parameter `share` that scales all of `values`, so that one secant spans the whole effect."""

    def scaled(hook: Hook) -> Hook:
        def call(p: Values, *rest: Any) -> Any:
            return hook({q.name: p["share"] * v for q, v in zip(effect.parameters, values, strict=True)}, *rest)

        return call

    share = EffectParameter("share", "1", 1.0, 1.0, 1.0)
    hooks = {stage: scaled(hook) for stage, hook in effect.hooks.items()}
    return Effect(f"all of {effect.id}", effect.family, effect.equation, "", (share,), hooks)


def autocorrelation(point: LinearisationPoint) -> dict[str, np.ndarray]:
    """Autocorrelation of the whitened residuals at lags of 1 to `LAGS` samples, by channel, (LAGS,); NaN: too few."""
    series = {name: point.residuals[..., i].ravel() for i, name in enumerate(("heading", "yaw rate", "a_x", "a_y"))}
    series |= {"north": point.fix_residuals[:, 0], "east": point.fix_residuals[:, 1]}
    out = {}
    for name, values in series.items():
        known = values[np.isfinite(values)]
        known = np.clip(known, -5, 5)  # outliers are independent of their neighbours
        known = known - known.mean() if len(known) else known
        power = float(known @ known)
        ok = len(known) > 2 * LAGS and power > 0
        out[name] = np.array([known[k:] @ known[:-k] / power if ok else np.nan for k in range(1, LAGS + 1)])
    return out


def pulse_widths_and_voltage(physics: EffectPhysics) -> tuple[np.ndarray, np.ndarray]:
    """Thruster pulse widths [us] (W, n) and battery voltage [V] (W,) in the middle of each window; NaN: unknown."""
    names = [f"pwm_{t.name}" for t in physics.vessel.thrusters]
    middle = physics.windows.t_s.mean(axis=1)
    pwm = np.full((len(middle), len(names)), np.nan)
    for run, span in zip(physics.runs, physics.windows.spans, strict=True):
        t, values = run.samples(*names)
        pwm[span] = values.reshape(len(t), -1)[_before(t, middle[span])]
    return pwm, battery_voltage(physics, middle)


def battery_voltage(physics: EffectPhysics, t_s: np.ndarray) -> np.ndarray:
    """Battery voltage [V] as last logged at instants t_s (W, ..) of the windows; NaN: unknown."""
    out = np.full(t_s.shape, np.nan)
    for run, span in zip(physics.runs, physics.windows.spans, strict=True):
        if run.known("battery_v"):
            t, values = run.samples("battery_v")
            out[span] = values[_before(t, t_s[span])]
    return out


def _before(samples_s: np.ndarray, t_s: np.ndarray) -> np.ndarray:
    """Index of the last sample before each instant; of the first where there is none."""
    return np.maximum(np.searchsorted(samples_s, t_s, side="right") - 1, 0)
