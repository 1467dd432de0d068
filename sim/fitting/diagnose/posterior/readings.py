"""What the sensors should say of a motion: heading, yaw rate, accelerations, places. Residuals, and slopes."""

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
from sim.fitting.engine.noise import BIAS_AX, BIAS_AY, BIAS_R, OFFSET, WANDER, Noise, whiten
from sim.fitting.engine.windows import PSI, RATE, SURGE, SWAY

NUDGE = 1e-6  # of states and accelerations, for the slopes


class Readings:
    """On the windows of `physics`. `window`, `index` (m,): window and step before each position sample."""

    def __init__(self, physics: EffectPhysics):
        self.physics, self.windows = physics, physics.windows
        vessel = physics.vessel
        self._imu_arm = (vessel.sensors.imu.x_m, vessel.sensors.imu.y_m)
        self._arm = np.array([vessel.sensors.uwb.x_m, vessel.sensors.uwb.y_m])
        self._when = self.windows.fixes.t_s - vessel.sensors.uwb.latency_s
        self.window, self.index = self.windows.before(self._when)
        self._delta = self._when - self.windows.t_s[self.window, self.index]

    def imu(self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories) -> np.ndarray:
        """psi, r, a_x, a_y as the sensors should say, without node biases, (W, K, 4)."""
        K = self.windows.size[1]
        x, nd = state.x[:, :K], state.nu_dot[:, :K]
        a_x, a_y = point_acceleration(np.moveaxis(x[..., 3:], -1, 0), np.moveaxis(nd, -1, 0), self._imu_arm)
        y = np.stack([x[..., 2], x[..., 5], a_x, a_y], axis=2)
        scene = self.physics.scene(state).part(K)
        for effect, p in values_by_name(effects, theta, "imu"):
            y = effect.hooks["imu"](p, scene, y)
        return y

    def tag(self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories) -> np.ndarray:
        """Places as the tag should report them, (m, 2)."""
        w, k = self.window, self.index
        return self._seen(effects, theta, state.x[w, k], state.nu_dot[w, k])

    def _seen(self, effects: Sequence[Effect], theta: ParameterValues, x: np.ndarray, nu_dot: np.ndarray) -> np.ndarray:
        """The same from states (m, 6) and accelerations (m, 3) at the nodes before."""
        seen = tag_kinematics(self.physics, x, nu_dot, self._delta, self._arm, self._when)
        place = seen.place_m
        for effect, p in values_by_name(effects, theta, "tag"):
            place = effect.hooks["tag"](p, seen, place)
        return place

    def residuals(
        self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories, z: np.ndarray, noise: Noise
    ) -> tuple[np.ndarray, np.ndarray]:
        """Whitened, (W, K, 4) and (m, 2)."""
        error = self.imu(effects, theta, state) - self.windows.y
        error[..., PSI] += z[:, None, OFFSET] + fade(self.windows, noise) * z[:, None, WANDER]
        for channel, bias in ((RATE, BIAS_R), (SURGE, BIAS_AX), (SWAY, BIAS_AY)):
            error[..., channel] += z[:, None, bias]
        out = error / np.array(noise.white)
        known = np.isfinite(error[..., PSI])
        psi = whiten(np.where(known, error[..., PSI], 0.0)[..., None], known, self.windows.h_s, noise)
        out[..., PSI] = np.where(known, psi[..., 0], np.nan)
        return out, (self.tag(effects, theta, state) - self.windows.fixes.place_m) / noise.fix_m

    def slopes(
        self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories
    ) -> tuple[np.ndarray, np.ndarray]:
        """By differences: what psi, r, a_x, a_y change with x y psi u v r u_dot v_dot r_dot, (W, K, 4, 9); what the

        tag's places change with x y psi u v r at the node before, (m, 2, 6).
        """
        return self._imu_slopes(effects, theta, state), self._tag_slopes(effects, theta, state)

    def _imu_slopes(self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories) -> np.ndarray:
        """What psi, r, a_x, a_y change with x y psi u v r u_dot v_dot r_dot, by differences, (W, K, 4, 9)."""
        now, motion = self.imu(effects, theta, state), np.concatenate([state.x, state.nu_dot], axis=2)
        slopes = np.empty((*now.shape, 9))
        for j in range(9):
            moved = motion.copy()
            moved[..., j] += NUDGE
            there = replace(state, x=moved[..., :6], nu_dot=moved[..., 6:])
            slopes[..., j] = (self.imu(effects, theta, there) - now) / NUDGE
        return slopes

    def _tag_slopes(self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories) -> np.ndarray:
        """What the tag's places change with x y psi u v r at the node before, by differences, (m, 2, 6)."""
        w, k = self.window, self.index
        x, nu_dot, A = state.x[w, k], state.nu_dot[w, k], state.A[w, k, 3:]
        now = self._seen(effects, theta, x, nu_dot)
        slopes = np.empty((len(w), 2, 9))
        for j in range(9):
            moved = np.concatenate([x, nu_dot], axis=1)
            moved[:, j] += NUDGE
            slopes[..., j] = (self._seen(effects, theta, moved[:, :6], moved[:, 6:]) - now) / NUDGE
        return slopes[..., :6] + slopes[..., 6:] @ A
