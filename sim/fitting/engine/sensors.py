"""Measurement models of the fit: residuals (predicted minus measured, whitened) and their partial derivatives.

    heading          psi + offset + wander + a cos psi + b sin psi      a, b: hard iron, less what the file states of it
    yaw rate         r + b_r
    specific force   at the IMU's place, as in `core.geometry.frames.point_acceleration`, + b_ax, b_ay
    position         p + R(psi) l_tag, taken at stamp - latency; bent by the warp W (`parameters`)

A position sample falls between two steps. From the step at or before it, delta seconds earlier, the tag moves on by
delta v + delta^2 / 2 a, with v and a in the body axes of that step. Columns of the rows: node (L), then q (P) in file
units.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from companion.core.geometry.frames import R2, point_acceleration, point_velocity
from sim.fitting.engine.jacobian_rows import fade
from sim.fitting.engine.motion import WindowMotion
from sim.fitting.engine.noise import BIAS_AX, BIAS_AY, BIAS_R, OFFSET, WANDER, L, Noise, whiten
from sim.fitting.engine.parameters import Parameters
from sim.fitting.engine.windows import PSI, RATE, SURGE, SWAY, Windows

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # cross product with a unit yaw rate: r TURN l = omega x l


def whitened(error: np.ndarray, windows: Windows, noise: Noise) -> np.ndarray:
    """Errors of the IMU (W, K, 4) in the order of `CHANNELS` by their noise; those of heading wander."""
    out = error / np.array(noise.white)
    known = np.isfinite(error[..., PSI])
    psi = whiten(np.where(known, error[..., PSI], 0.0)[..., None], known, windows.h_s, noise)
    out[..., PSI] = np.where(known, psi[..., 0], np.nan)
    return out


@dataclass(frozen=True)
class ImuResiduals:
    """Heading, yaw rate and specific force of all windows."""

    windows: Windows
    parameters: Parameters

    def arm_m(self, q: np.ndarray) -> tuple[float, float]:
        """The IMU's place, forward and starboard of the body origin."""
        imu, own = self.parameters.vessel.sensors.imu, q[self.parameters.imu]
        return (float(own[0]), float(own[1])) if len(own) else (imu.x_m, imu.y_m)

    def hard_iron_rad(self, q: np.ndarray) -> tuple[float, float]:
        """By cos and sin of the heading, beyond what the file states: the measured heading is without that."""
        imu, own = self.parameters.vessel.sensors.imu, q[self.parameters.imu]
        return (own[2] - imu.hard_iron_cos_rad, own[3] - imu.hard_iron_sin_rad) if len(own) else (0.0, 0.0)

    def residual(self, motion: WindowMotion, q: np.ndarray, z: np.ndarray, noise: Noise) -> np.ndarray:
        """Predicted minus measured, whitened, (W, K, 4) in the order of `CHANNELS`; NaN where nothing was measured."""
        K = self.windows.size[1]
        x, nd = motion.x[:, :K], motion.nu_dot[:, :K]
        psi = x[..., 2] + z[:, None, OFFSET] + fade(self.windows, noise) * z[:, None, WANDER]
        a, b = self.hard_iron_rad(q)
        if a or b:
            psi += a * np.cos(x[..., 2]) + b * np.sin(x[..., 2])
        a_x, a_y = point_acceleration(np.moveaxis(x[..., 3:], -1, 0), np.moveaxis(nd, -1, 0), self.arm_m(q))
        biased = [x[..., 5] + z[:, None, BIAS_R], a_x + z[:, None, BIAS_AX], a_y + z[:, None, BIAS_AY]]
        return whitened(np.stack([psi, *biased], axis=2) - self.windows.y, self.windows, noise)

    def add_own(self, rows: np.ndarray, motion: WindowMotion, part: slice, noise: Noise) -> None:
        """Write the derivatives by lever arm and hard iron into `rows` (w, K, 4, L + P) of the windows `part`."""
        imu = self.parameters.imu
        if imu.start == imu.stop:
            return
        K = self.windows.size[1]
        r2, r_dot = motion.x[part, :K, 5] ** 2, motion.nu_dot[part, :K, 2]
        for channel, by_x, by_y in ((SURGE, -r2, -r_dot), (SWAY, r_dot, -r2)):
            scale = np.isfinite(self.windows.y[part, :, channel]) / noise.white[channel]
            rows[..., channel, L + imu.start], rows[..., channel, L + imu.start + 1] = scale * by_x, scale * by_y
        psi, known = motion.x[part, :K, 2], np.isfinite(self.windows.y[part, :, PSI])
        by_iron = np.stack([np.cos(psi), np.sin(psi)], axis=2)
        by_iron = whiten(np.where(known[..., None], by_iron, 0.0), known, self.windows.h_s[part], noise)
        rows[..., PSI, L + imu.start + 2 : L + imu.stop] = by_iron

    def slopes(self, motion: WindowMotion, q: np.ndarray) -> np.ndarray:
        """Partial derivatives of psi, r, a_x, a_y by x y psi u v r u_dot v_dot r_dot, (W, K, 4, 9)."""
        W, K = self.windows.size
        u, v, r = (motion.x[:, :K, i] for i in (3, 4, 5))
        lx, ly = self.arm_m(q)
        C = np.zeros((W, K, 4, 9))
        C[..., PSI, 2] = C[..., RATE, 5] = C[..., SURGE, 6] = C[..., SWAY, 7] = 1.0
        a, b = self.hard_iron_rad(q)
        C[..., PSI, 2] += b * np.cos(motion.x[:, :K, 2]) - a * np.sin(motion.x[:, :K, 2])
        C[..., SURGE, 4], C[..., SURGE, 5], C[..., SURGE, 8] = -r, -v - 2 * lx * r, -ly
        C[..., SWAY, 3], C[..., SWAY, 5], C[..., SWAY, 8] = r, u - 2 * ly * r, lx
        return C


@dataclass(frozen=True)
class TagResiduals:
    """Position samples of all runs."""

    windows: Windows
    parameters: Parameters

    def residual(self, path: TagPath, q: np.ndarray, noise: Noise) -> np.ndarray:
        """Predicted minus measured position, north and east, whitened, (m, 2)."""
        place = path.x[:, :2] + path.turned(path.shift)
        warped = (place - self._middle) @ q[self.parameters.warp].reshape(2, 2).T
        return (place + warped - self.windows.fixes.place_m) / noise.fix_m

    def slopes(self, path: TagPath) -> np.ndarray:
        """Partial derivatives of north and east by the state at the step before, (m, 2, 6).

        The small factor (I + W) of the warp is left out.
        """
        delta = path.delta_s
        C = np.zeros((len(delta), 2, 6))
        C[:, 0, 0] = C[:, 1, 1] = 1.0
        C[:, :, 2] = path.turned(path.shift @ TURN.T)
        C[:, :, 3:5] = delta[..., None] * path.R
        C[:, :, 5] = delta * (path.R @ (TURN @ path.arm))
        return C

    def add_own(self, rows: np.ndarray, path: TagPath, scale: np.ndarray) -> None:
        """Write the derivatives by latency, lever arm and warp into `rows` (m, 2, L + P), times `scale` (m,)."""
        at, warp, by = L + self.parameters.thrusters.stop + 2, L + self.parameters.warp.start, scale[:, None]
        delta = path.delta_s
        rows[:, :, at] = -by * path.turned(path.velocity + delta * path.gain)
        away = path.x[:, :2] + path.turned(path.shift) - self._middle
        rows[:, 0, warp : warp + 2] = rows[:, 1, warp + 2 : warp + 4] = by * away
        arm = path.R + (delta * path.x[:, 5:6])[..., None] * (path.R @ TURN)
        rows[:, :, at + 1 : at + 3] = by[:, :, None] * arm

    @property
    def _middle(self) -> np.ndarray:
        return self.windows.fixes.place_m.mean(axis=0)

    def path(self, motion: WindowMotion, q: np.ndarray) -> TagPath:
        """Where the tag went, near each sample."""
        at = self.parameters.thrusters.stop + 3
        when = self.windows.fixes.t_s - q[self.parameters.thrusters.stop + 2]
        w, k = self.windows.before(when)
        x, nd, arm = motion.x[w, k], motion.nu_dot[w, k], q[at : at + 2]
        velocity = np.stack(point_velocity(x[:, 3:].T, arm), axis=1)
        gain = np.stack(point_acceleration(x[:, 3:].T, nd.T, arm), axis=1)
        return TagPath(w, k, x, (when - self.windows.t_s[w, k])[:, None], arm, velocity, gain)


@dataclass(frozen=True)
class TagPath:
    """The tag near each sample: body-axes velocity and acceleration at the step before, `delta_s` earlier."""

    window: np.ndarray
    step: np.ndarray
    x: np.ndarray
    delta_s: np.ndarray
    arm: np.ndarray
    velocity: np.ndarray
    gain: np.ndarray

    @property
    def shift(self) -> np.ndarray:
        """From the body origin at the step before to the tag at the sample, body axes there, (m, 2)."""
        return self.arm + self.delta_s * self.velocity + self.delta_s**2 / 2 * self.gain

    @cached_property
    def R(self) -> np.ndarray:
        """Body to NED, (m, 2, 2)."""
        return R2(self.x[:, 2])

    def turned(self, vector: np.ndarray) -> np.ndarray:
        """R vector, (m, 2)."""
        return self.R[:, :, 0] * vector[:, :1] + self.R[:, :, 1] * vector[:, 1:]
