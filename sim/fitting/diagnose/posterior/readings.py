"""Measurement model of heading, gyro, accelerometers and UWB tag with effects: predictions, residuals, Jacobians.

psi,  r,  a_x = u_dot - v r - l_x r^2 - l_y r_dot,  a_y = v_dot + u r - l_y r^2 + l_x r_dot,  p = [x y] + R(psi) l_tag
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from companion.core.geometry.frames import point_acceleration
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues, values_by_name
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.posterior.state import WindowTrajectories
from sim.fitting.diagnose.posterior.tag_kinematics import tag_kinematics
from sim.fitting.engine.jacobian_rows import fade
from sim.fitting.engine.noise import BIAS_AX, BIAS_AY, BIAS_R, OFFSET, WANDER, Noise
from sim.fitting.engine.sensors import whitened
from sim.fitting.engine.windows import PSI, RATE, SURGE, SWAY

NUDGE = 1e-6  # difference step of states and accelerations for the slopes


class Readings:
    """Readings on the windows of `physics`. `window`, `index` (m,): window and step before each position sample."""

    def __init__(self, physics: EffectPhysics):
        self.physics, self.windows = physics, physics.windows
        vessel = physics.vessel
        self._imu_arm = (vessel.sensors.imu.x_m, vessel.sensors.imu.y_m)
        self._arm = np.array([vessel.sensors.position.x_m, vessel.sensors.position.y_m])
        self._when = self.windows.fixes.t_s - vessel.sensors.position.latency_s
        self.window, self.index = self.windows.before(self._when)
        self._delta = self._when - self.windows.t_s[self.window, self.index]

    def imu(self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories) -> np.ndarray:
        """Predicted psi [rad], r [rad/s], a_x, a_y [m/s^2], without biases of the nodes, (W, K, 4)."""
        K = self.windows.size[1]
        x, nd = state.x[:, :K], state.nu_dot[:, :K]
        a_x, a_y = point_acceleration(np.moveaxis(x[..., 3:], -1, 0), np.moveaxis(nd, -1, 0), self._imu_arm)
        y = np.stack([x[..., 2], x[..., 5], a_x, a_y], axis=2)
        scene = self.physics.scene(state).part(K)
        for effect, p in values_by_name(effects, theta, "imu"):
            y = effect.hooks["imu"](p, scene, y)
        return y

    def tag(self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories) -> np.ndarray:
        """Predicted position samples of the tag, north and east, (m, 2) [m]."""
        w, k = self.window, self.index
        return self._seen(effects, theta, state.x[w, k], state.nu_dot[w, k])

    def _seen(self, effects: Sequence[Effect], theta: ParameterValues, x: np.ndarray, nu_dot: np.ndarray) -> np.ndarray:
        """The same from states (m, 6) and accelerations (m, 3) at the steps before the samples."""
        tag = tag_kinematics(self.physics, x, nu_dot, self._delta, self._arm, self._when)
        place = tag.place_m
        for effect, p in values_by_name(effects, theta, "tag"):
            place = effect.hooks["tag"](p, tag, place)
        return place

    def residuals(
        self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories, z: np.ndarray, noise: Noise
    ) -> tuple[np.ndarray, np.ndarray]:
        """Whitened residuals predicted minus measured: IMU (W, K, 4), NaN where not measured, and fixes (m, 2).

        `z` (W, L): nodes, whose heading offset, heading wander and biases are added to the predictions.
        """
        error = self.imu(effects, theta, state) - self.windows.y
        error[..., PSI] += z[:, None, OFFSET] + fade(self.windows, noise) * z[:, None, WANDER]
        for channel, bias in ((RATE, BIAS_R), (SURGE, BIAS_AX), (SWAY, BIAS_AY)):
            error[..., channel] += z[:, None, bias]
        fixes = (self.tag(effects, theta, state) - self.windows.fixes.place_m) / noise.fix_m
        return whitened(error, self.windows, noise), fixes

    def slopes(
        self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories
    ) -> tuple[np.ndarray, np.ndarray]:
        """Jacobians of the IMU readings (W, K, 4, 9) and of the tag's positions (m, 2, 6), see below."""
        return self._imu_slopes(effects, theta, state), self._tag_slopes(effects, theta, state)

    def _imu_slopes(self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories) -> np.ndarray:
        """d[psi r a_x a_y]/d[x y psi u v r u_dot v_dot r_dot] by forward differences, (W, K, 4, 9)."""
        now, motion = self.imu(effects, theta, state), np.concatenate([state.x, state.nu_dot], axis=2)
        slopes = np.empty((*now.shape, 9))
        for j in range(9):
            moved = motion.copy()
            moved[..., j] += NUDGE
            nudged = replace(state, x=moved[..., :6], nu_dot=moved[..., 6:])
            slopes[..., j] = (self.imu(effects, theta, nudged) - now) / NUDGE
        return slopes

    def _tag_slopes(self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories) -> np.ndarray:
        """d(position)/d[x y psi u v r] at the step before, with nu_dot = A x, by forward differences, (m, 2, 6)."""
        w, k = self.window, self.index
        x, nu_dot, A = state.x[w, k], state.nu_dot[w, k], state.A[w, k, 3:]
        now = self._seen(effects, theta, x, nu_dot)
        slopes = np.empty((len(w), 2, 9))
        for j in range(9):
            moved = np.concatenate([x, nu_dot], axis=1)
            moved[:, j] += NUDGE
            slopes[..., j] = (self._seen(effects, theta, moved[:, :6], moved[:, 6:]) - now) / NUDGE
        return slopes[..., :6] + slopes[..., 6:] @ A
