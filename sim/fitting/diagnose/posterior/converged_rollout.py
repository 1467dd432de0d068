"""Open-loop rollout of long windows whose hook forces depend on the motion itself: fixed point by Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues
from sim.fitting.diagnose.posterior.physics import PUSHES, EffectPhysics, nameable, with_hooks
from sim.fitting.diagnose.posterior.state import WindowTrajectories
from sim.fitting.engine.jacobian_rows import AccelerationPartials, sensitivities
from sim.fitting.engine.kernels.windows import X0_D

STILL, MOST_PASSES = 1e-3, 20  # largest change of x y psi u v r between passes at convergence; passes; assumed


def converged_rollout(
    physics: EffectPhysics, effects: Sequence[Effect], theta: ParameterValues, z: np.ndarray
) -> WindowTrajectories:
    """Trajectories from nodes z (W, L) as by `EffectPhysics.move`, with passes until the motion is converged.

    Forces of nameable effects are linearised in the motion between passes (Newton's step). Where an iterate is not
    finite: the result of `EffectPhysics.move`.
    """
    nonlinear = nameable(with_hooks(effects, theta, PUSHES), theta)
    now = physics.one_pass(effects, theta, z, None)
    for _ in range(MOST_PASSES):
        before, now = now, physics.one_pass(effects, theta, z, now)
        if not np.isfinite(now.x).all():
            return physics.move(effects, theta, z, None)
        if np.abs(now.x - before.x).max() < STILL:
            return now
        if nonlinear:
            now = _newton_update(physics, nonlinear, theta, before, now)
    return now


def _newton_update(
    physics: EffectPhysics,
    effects: Sequence[Effect],
    theta: ParameterValues,
    before: WindowTrajectories,
    now: WindowTrajectories,
) -> WindowTrajectories:
    """One Newton step: `now` was driven by the forces of `effects` along `before`; correct for those along `now`.

    a = M'^-1 (tau(now) - tau(before)),   dx_dot = A dx + [0, a]
    """
    feedback, (W, K) = physics.feedback(effects, theta, now), physics.windows.size
    old, new = (physics.hook_forces(effects, theta, physics.scene(s), now.forces.f)[0] for s in (before, now))
    a, A = (new - old)[..., :3] @ now.M_inv.T @ feedback.mass_ratio.T, now.with_feedback(feedback).A
    pushes = AccelerationPartials.of(a[..., None], np.zeros((W, K, 3, 1)))
    dx = sensitivities(A, pushes, physics.windows.h_s)[..., X0_D]
    nu_dot = now.nu_dot + a + (A[..., 3:, :] @ dx[..., None])[..., 0]
    return replace(now, x=now.x + dx, nu_dot=nu_dot)
