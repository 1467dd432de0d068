"""Everything that the measurements say at one point, as normal equations of the chain of nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.identify.structured.chain import Chain, Ties
from sim.identify.structured.data import Windows
from sim.identify.structured.model import Compiled
from sim.identify.structured.motion import X0_D, Motion, Mover, sensitivities
from sim.identify.structured.noise import STATE, L, Noise
from sim.identify.structured.parameters import Parameters
from sim.identify.structured.sensors import Imu, Tag

HUBER = 2.5  # whitened fixes beyond this count linearly, not squared: 97 % efficient on normal noise


@dataclass(frozen=True)
class Linearised:
    """Normal equations of the data alone at one point, what ties the nodes, and the residuals.

    `cost`: half the weighted sum of squares of the data [nats]. `residuals` (W, K, 4) and `fix_residuals` (m, 2) are
    whitened, NaN where nothing was measured.
    """

    chain: Chain
    cost: float
    ties: Ties
    residuals: np.ndarray
    fix_residuals: np.ndarray


class Problem:
    """What does not change between iterations."""

    def __init__(self, windows: Windows, parameters: Parameters, compiled: Compiled):
        imu = parameters.vessel.sensors.imu
        self.windows, self.parameters = windows, parameters
        self.move = Mover(windows, parameters, compiled)
        self.imu, self.tag = Imu(windows, (imu.x_m, imu.y_m)), Tag(windows, parameters)

    def linearise(self, q: np.ndarray, z: np.ndarray, noise: Noise) -> Linearised:
        """Normal equations at parameters q (P,) and nodes z (W, L), without priors."""
        motion = self.move(q, z)
        S = sensitivities(motion, self.windows.h_s)
        residual, fix_residual = self.imu.residual(motion, z, noise), self.tag.residual(motion, q, noise)
        columns = L + len(q)
        size = np.sqrt((fix_residual**2).sum(axis=1))
        weight = np.minimum(1.0, HUBER / np.maximum(size, 1e-9))
        H, grad = _normal(
            self.imu.rows(motion, S, noise, columns),
            residual,
            self.tag.rows(motion, S, q, noise, columns),
            fix_residual,
            weight,
            self.tag.window(q),
        )
        huber = np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2).sum()
        cost = 0.5 * (float(np.nansum(residual**2)) + float(huber))
        ties = self._ties(motion, S, z, noise)
        return Linearised(Chain.of_data(H, grad, L), cost, ties, residual, fix_residual)

    def _ties(self, motion: Motion, S: np.ndarray, z: np.ndarray, noise: Noise) -> Ties:
        at = np.flatnonzero(~np.append(self.windows.first[1:], True))
        span = self.windows.t_s[at, -1] - self.windows.t_s[at, 0]
        decay, _ = noise.tie(span)
        F, G = np.zeros((len(at), L, L)), np.zeros((len(at), L, len(self.parameters.names)))
        diagonal = np.arange(L)
        F[:, diagonal, diagonal] = decay
        F[:, STATE, :X0_D] = S[at, -1, :, :X0_D]
        G[:, STATE, : S.shape[3] - X0_D] = S[at, -1, :, X0_D:]
        reached = decay * z[at]
        reached[:, STATE] = motion.x[at, -1]
        return Ties(z[at + 1] - reached, F, G, at, span)


def _normal(
    rows: np.ndarray,
    residual: np.ndarray,
    fix_rows: np.ndarray,
    fix_residual: np.ndarray,
    weight: np.ndarray,
    window: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """J^T J (W, C, C) and J^T r (W, C) of each window."""
    W, K, channels, C = rows.shape
    J = rows.reshape(W, K * channels, C)
    H = J.transpose(0, 2, 1) @ J
    grad = (J.transpose(0, 2, 1) @ np.nan_to_num(residual).reshape(W, -1, 1))[..., 0]
    order = np.argsort(window, kind="stable")
    rank = np.arange(len(window)) - np.searchsorted(window[order], window[order])
    padded = np.zeros((W, int(rank.max()) + 1, 2, C + 1))
    root = np.sqrt(weight)[:, None]
    packed = np.concatenate([fix_rows * root[..., None], (fix_residual * root)[..., None]], axis=2)
    padded[window[order], rank] = packed[order]
    Jf = padded.reshape(W, -1, C + 1)
    both = Jf.transpose(0, 2, 1) @ Jf
    return H + both[:, :C, :C], grad + both[:, :C, C]
