"""Residual accelerations of the model on even stamps in blocks: the data of the tests for stochastic causes.

    ahead, starboard:  latent acceleration + (measured - predicted) specific force             [m/s^2]
    yaw:               rho with rho_dot = -rho / T_r + latent, plus measured - predicted rate  [rad/s]

The latent acceleration of the fit follows slow forces and the residuals hold fast ones, so their sum is used. Yaw is
a rate, so that no noise is differentiated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.fitting.engine.noise import LATENT
from sim.fitting.engine.windows import RATE, SURGE, SWAY

LEAST = 8  # least number of stamps in a block


@dataclass(frozen=True)
class ResidualAcceleration:
    """B blocks of T stamps.

    y, x            (T, 3, B) as in the module, NaN where not measured; (T, 6, B) states [x y psi u v r]
    step_s          interval of the stamps [s]
    M_inv           (3, 3) inverse mass matrix
    to_imu          (2, 3) specific force at the IMU per acceleration (lever arm)
    yaw_rate_1_s    decay rate 1 / T_r of the yaw rate [1/s]
    """

    y: np.ndarray
    x: np.ndarray
    step_s: float
    M_inv: np.ndarray
    to_imu: np.ndarray
    yaw_rate_1_s: float

    @property
    def span_s(self) -> float:
        """Total time with data [s]."""
        return float(np.isfinite(self.y[:, :2]).any(axis=1).sum() * self.step_s)

    def pattern(self, force: np.ndarray) -> np.ndarray:
        """Response of the three channels to a body force (.., 3, n) [N, N, N m]; yaw as an acceleration."""
        accelerations = np.einsum("ij,...jn->...in", self.M_inv, force)
        seen = np.einsum("ij,...jn->...in", self.to_imu, accelerations)
        return np.concatenate([seen, accelerations[..., 2:, :]], axis=-2)


def residual_acceleration(
    fit: PosteriorFit, model: CandidateModel, step_s: float, block_s: float
) -> ResidualAcceleration:
    """Residual accelerations of `model`, means over about `step_s` (a whole number of samples), blocks of `block_s`.

    A block is at most one log.
    """
    # 1. Latent acceleration plus residual, at the IMU; step and block lengths.
    point, windows = model.point, fit.physics.windows
    K = windows.size[1]
    error = -point.residuals * np.array(model.noise.white)
    d = point.z[:, LATENT]
    imu = fit.physics.vessel.sensors.imu
    to_imu = np.array([[1.0, 0.0, -imu.y_m], [0.0, 1.0, imu.x_m]])
    decay = -float(point.state.A[..., 5, 5].mean())
    force = error[..., SURGE : SWAY + 1] + (d @ to_imu.T)[:, None]
    usual = _usual_step(windows.t_s[:, :K][np.isfinite(force).any(axis=-1)])
    step_s = max(1, round(step_s / usual)) * usual
    longest = max(float(windows.t_s[span, -1].max() - windows.t_s[span, 0].min()) for span in windows.spans)
    steps = max(1, int(np.ceil(min(block_s, longest) / step_s - 1e-6)))
    # 2. Log by log: means over the steps, yaw acceleration integrated to a rate, cut into blocks.
    y, x = [], []
    for span in windows.spans:
        t = windows.t_s[span, :K]
        index = ((t - t[0, 0] + usual / 2) / step_s).astype(int)
        count = int(index.max()) + 1
        ahead, starboard, rate, yaw = (
            _means(index, values, count)
            for values in (force[span][..., 0], force[span][..., 1], error[span][..., RATE],
                           np.broadcast_to(d[span, None, 2], t.shape))
        )  # fmt: skip
        states = [_filled(_means(index, point.state.x[span, :K, i], count)) for i in range(6)]
        whole = np.stack([ahead, starboard, rate + _driven(_filled(yaw), decay, step_s)], axis=1)
        y.append(_blocks(whole, steps))
        x.append(_blocks(np.stack(states, axis=1), steps))
    stacked = np.nan_to_num(np.concatenate(x, axis=2))
    return ResidualAcceleration(np.concatenate(y, axis=2), stacked, step_s, point.state.M_inv, to_imu, decay)


def _usual_step(t_s: np.ndarray) -> float:
    return float(np.median(np.diff(t_s)))


def _means(index: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    known = np.isfinite(values)
    size = np.bincount(index[known], minlength=count)
    total = np.bincount(index[known], values[known], minlength=count)
    return np.where(size > 0, total / np.maximum(size, 1), np.nan)


def _filled(values: np.ndarray) -> np.ndarray:
    known = np.isfinite(values)
    return np.interp(np.arange(len(values)), np.flatnonzero(known), values[known])


def _driven(yaw: np.ndarray, decay: float, step_s: float) -> np.ndarray:
    """Yaw rate rho (n,) driven by the acceleration `yaw` (n,): rho' = exp(-decay h) rho + h yaw."""
    keep, rho, out = np.exp(-decay * step_s), 0.0, np.empty(len(yaw))
    for k, push in enumerate(yaw):
        out[k] = rho
        rho = keep * rho + step_s * push
    return out


def _blocks(values: np.ndarray, steps: int) -> np.ndarray:
    """Values (n, c) as (steps, c, blocks); the last block is filled with NaN, or left out if shorter than `LEAST`."""
    count = max(1, (len(values) + steps - LEAST) // steps)
    out = np.full((count * steps, values.shape[1]), np.nan)
    size = min(len(values), len(out))
    out[:size] = values[:size]
    return out.reshape(count, steps, -1).transpose(1, 2, 0)
