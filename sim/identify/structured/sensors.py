"""What the sensors should say of a motion: residuals, whitened, and their derivatives to nodes and parameters.

Specific force at the IMU's place as in `companion.core.estimation.process`. A position sample is older than its stamp
by the latency; between steps the tag's path is taken to second order. Columns: node (L), then q (P) in file units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.identify.structured.data import PSI, RATE, SURGE, SWAY, Windows
from sim.identify.structured.motion import Motion, spread
from sim.identify.structured.noise import BIAS_AX, BIAS_AY, BIAS_R, OFFSET, WANDER, L, Noise, whiten
from sim.identify.structured.parameters import Parameters

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # omega x: of a unit yaw rate


@dataclass(frozen=True)
class Imu:
    """Heading, yaw rate and specific force of all windows. `extras`: as `Parameters.extras`."""

    windows: Windows
    arm_m: tuple[float, float]
    extras: int = 0

    def residual(self, motion: Motion, z: np.ndarray, noise: Noise) -> np.ndarray:
        """Predicted minus measured, whitened, shape (W, K, 4); NaN where nothing was measured."""
        K = self.windows.size[1]
        x, nd = motion.x[:, :K], motion.nu_dot[:, :K]
        u, v, r = x[..., 3], x[..., 4], x[..., 5]
        lx, ly = self.arm_m
        psi = x[..., 2] + z[:, None, OFFSET] + self._fade(noise) * z[:, None, WANDER]
        ax = nd[..., 0] - v * r - lx * r**2 - ly * nd[..., 2] + z[:, None, BIAS_AX]
        ay = nd[..., 1] + u * r - ly * r**2 + lx * nd[..., 2] + z[:, None, BIAS_AY]
        error = np.stack([psi, r + z[:, None, BIAS_R], ax, ay], axis=2) - self.windows.y
        out = error / np.array(noise.white)
        known = np.isfinite(error[..., PSI])
        white = whiten(np.where(known, error[..., PSI], 0.0)[..., None], known, self.windows.h_s, noise)
        out[..., PSI] = np.where(known, white[..., 0], np.nan)
        return out

    def rows(self, motion: Motion, S: np.ndarray, noise: Noise, columns: int, part: slice) -> np.ndarray:
        """Derivative of `residual` for `part` of the windows, (.., K, 4, columns); nil where nothing was measured.

        `motion` and `S` are those of the part.
        """
        K = self.windows.size[1]
        x, A, G, S = motion.x[:, :K], motion.A[:, :K], motion.G[:, :K], S[:, :K]
        u, v, r = x[..., 3], x[..., 4], x[..., 5]
        lx, ly = self.arm_m
        C_ax, C_ay = A[..., 3, :] - ly * A[..., 5, :], A[..., 4, :] + lx * A[..., 5, :]
        C_ax[..., 4] -= r
        C_ax[..., 5] -= v + 2 * lx * r
        C_ay[..., 3] += r
        C_ay[..., 5] += u - 2 * ly * r
        known = np.isfinite(self.windows.y[part])
        scale = known / np.array(noise.white)
        force = np.stack([C_ax, C_ay], axis=2) @ S
        force[:, :, 0, 6:] += G[..., 0, :] - ly * G[..., 2, :]
        force[:, :, 1, 6:] += G[..., 1, :] + lx * G[..., 2, :]
        rows = np.zeros((len(x), K, 4, columns))
        spread(rows[:, :, RATE], S[..., 5, :] * scale[:, :, RATE, None], self.extras)
        spread(rows[:, :, SURGE:], force * scale[:, :, SURGE:, None], self.extras)
        for channel, column in ((RATE, BIAS_R), (SURGE, BIAS_AX), (SWAY, BIAS_AY)):
            rows[..., channel, column] = scale[..., channel]
        slow = np.stack([self._fade(noise)[part], np.ones(x.shape[:2])], axis=2)
        h_s = self.windows.h_s[part]
        psi = whiten(np.concatenate([S[..., 2, :], slow], axis=2), known[..., PSI], h_s, noise)
        spread(rows[:, :, PSI], psi[..., :-2], self.extras)
        rows[:, :, PSI, WANDER], rows[:, :, PSI, OFFSET] = psi[..., -2], psi[..., -1]
        return rows

    def _fade(self, noise: Noise) -> np.ndarray:
        """What is left of a node's heading wander at each step of its window, (W, K)."""
        t = self.windows.t_s[:, :-1]
        return np.exp(-(t - t[:, :1]) / noise.wander_time_s)


@dataclass(frozen=True)
class Tag:
    """Position samples of all runs."""

    windows: Windows
    parameters: Parameters

    def residual(self, motion: Motion, q: np.ndarray, noise: Noise) -> np.ndarray:
        """Predicted minus measured place, whitened, shape (m, 2)."""
        path = self.path(motion, q)
        place = path.x[:, :2] + path.turned(path.shift)
        warped = (place - self._middle) @ q[self.parameters.warp].reshape(2, 2).T
        return (place + warped - self.windows.fixes.place_m) / noise.fix_m

    def rows(self, path: Path, S: np.ndarray, noise: Noise, columns: int) -> np.ndarray:
        """Derivative of `residual` on a path, (m, 2, columns), to the warp's share (its square is left out).

        S (m, 6, ..): sensitivities at the steps before the samples.
        """
        at = L + self.parameters.thrusters.stop + 2
        delta, lever = path.delta_s, TURN @ path.arm
        C = np.zeros((len(delta), 2, 6))
        C[:, 0, 0] = C[:, 1, 1] = 1.0
        C[:, :, 2] = path.turned(path.shift @ TURN.T)
        C[:, :, 3:5] = delta[..., None] * path.R
        C[:, :, 5] = delta * (path.R @ lever)
        rows = np.zeros((len(delta), 2, columns))
        spread(rows, C @ S, self.parameters.extras)
        rows[:, :, at] = -path.turned(path.velocity + delta * path.gain)
        away = path.x[:, :2] + path.turned(path.shift) - self._middle
        warp = L + self.parameters.warp.start
        rows[:, 0, warp : warp + 2] = rows[:, 1, warp + 2 : warp + 4] = away
        rows[:, :, at + 1 : at + 3] = path.R + (delta * path.x[:, 5:6])[..., None] * (path.R @ TURN)
        return rows / noise.fix_m

    @property
    def _middle(self) -> np.ndarray:
        return self.windows.fixes.place_m.mean(axis=0)

    def _place(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Window and step before each sample, and when it was taken [s]."""
        windows, fixes = self.windows, self.windows.fixes
        when = fixes.t_s - q[self.parameters.thrusters.stop + 2]
        w, k = np.empty(len(when), dtype=int), np.empty(len(when), dtype=int)
        for i, (span, (t, starts)) in enumerate(zip(windows.spans, windows.grids, strict=True)):
            mine = fixes.run == i
            step = np.clip(np.searchsorted(t, when[mine], side="right") - 1, 0, len(t) - 2)
            own = np.searchsorted(starts, step, side="right") - 1
            w[mine], k[mine] = own + span.start, step - starts[own]
        return w, k, when

    def path(self, motion: Motion, q: np.ndarray) -> Path:
        """Where the tag went, near each sample."""
        at = self.parameters.thrusters.stop + 3
        w, k, when = self._place(q)
        x, nd, arm = motion.x[w, k], motion.nu_dot[w, k], q[at : at + 2]
        r = x[:, 5:6]
        velocity = x[:, 3:5] + r * (TURN @ arm)
        gain = nd[:, :2] + nd[:, 2:] * (TURN @ arm) + r * (velocity @ TURN.T)
        return Path(w, k, x, (when - self.windows.t_s[w, k])[:, None], arm, velocity, gain)


@dataclass(frozen=True)
class Path:
    """The tag near each sample: body-axes velocity and acceleration at the step before, `delta_s` earlier."""

    window: np.ndarray
    step: np.ndarray
    x: np.ndarray
    delta_s: np.ndarray
    arm: np.ndarray
    velocity: np.ndarray
    gain: np.ndarray

    def part(self, samples: np.ndarray) -> Path:
        """Some of the samples, by index."""
        return Path(
            self.window[samples],
            self.step[samples],
            self.x[samples],
            self.delta_s[samples],
            self.arm,
            self.velocity[samples],
            self.gain[samples],
        )

    @property
    def shift(self) -> np.ndarray:
        """From the body origin at the step before to the tag at the sample, body axes there, (m, 2)."""
        return self.arm + self.delta_s * self.velocity + self.delta_s**2 / 2 * self.gain

    @property
    def R(self) -> np.ndarray:
        """Body to NED, (m, 2, 2)."""
        c, s = np.cos(self.x[:, 2]), np.sin(self.x[:, 2])
        return np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)

    def turned(self, vector: np.ndarray) -> np.ndarray:
        """R vector, (m, 2)."""
        return (self.R @ vector[..., None])[..., 0]
