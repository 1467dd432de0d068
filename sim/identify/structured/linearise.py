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

BLOCK = 32  # windows whose rows are in memory at a time: a few megabytes, near a core's cache
HUBER = 2.5  # whitened fixes beyond this count linearly, not squared: 97 % efficient on normal noise


Products = tuple[np.ndarray, np.ndarray, np.ndarray]
"""J^T J, J^T r and the sensitivities at the ends of some windows."""


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
        self.imu, self.tag = Imu(windows, (imu.x_m, imu.y_m), parameters.extras), Tag(windows, parameters)

    def linearise(self, q: np.ndarray, z: np.ndarray, noise: Noise) -> Linearised:
        """Normal equations at parameters q (P,) and nodes z (W, L), without priors."""
        motion = self.move(q, z)
        residual, fix_residual = self.imu.residual(motion, z, noise), self.tag.residual(motion, q, noise)
        path = self.tag.path(motion, q)
        size = np.sqrt((fix_residual**2).sum(axis=1))
        root = np.sqrt(np.minimum(1.0, HUBER / np.maximum(size, 1e-9)))[:, None]
        W, columns = self.windows.size[0], L + len(q)

        def block(part: slice) -> Products:
            some = motion.part(part)
            S = sensitivities(some, self.windows.h_s[part])
            H, grad = _products(self.imu.rows(some, S, noise, columns, part), residual[part])
            mine = np.flatnonzero((path.window >= part.start) & (path.window < part.stop))
            own = path.part(mine)
            rows = self.tag.rows(own, S[own.window - part.start, own.step], noise, columns) * root[mine, None]
            _add_fixes(H, grad, rows, fix_residual[mine] * root[mine], own.window - part.start)
            return H, grad, S[:, -1].copy()

        parts = [slice(at, min(at + BLOCK, W)) for at in range(0, W, BLOCK)]
        H, grad, ends = (np.concatenate(pieces) for pieces in zip(*map(block, parts), strict=True))
        huber = np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2).sum()
        cost = 0.5 * (float(np.nansum(residual**2)) + float(huber))
        ties = self._ties(motion, ends, z, noise)
        return Linearised(Chain.of_data(H, grad, L), cost, ties, residual, fix_residual)

    def _ties(self, motion: Motion, ends: np.ndarray, z: np.ndarray, noise: Noise) -> Ties:
        at = np.flatnonzero(~np.append(self.windows.first[1:], True))
        span = self.windows.t_s[at, -1] - self.windows.t_s[at, 0]
        decay, _ = noise.tie(span)
        F, G = np.zeros((len(at), L, L)), np.zeros((len(at), L, len(self.parameters.names)))
        diagonal = np.arange(L)
        F[:, diagonal, diagonal] = decay
        F[:, STATE, :X0_D] = ends[at, :, :X0_D]
        base = ends.shape[2] - self.parameters.extras
        G[:, STATE, : base - X0_D] = ends[at, :, X0_D:base]
        G[:, STATE, G.shape[2] - self.parameters.extras :] = ends[at, :, base:]
        reached = decay * z[at]
        reached[:, STATE] = motion.x[at, -1]
        return Ties(z[at + 1] - reached, F, G, at, span)


def _products(rows: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """J^T J (W, C, C) and J^T r (W, C) of each window; what was not measured is NaN in the residual, nil in rows."""
    W, K, channels, C = rows.shape
    J = rows.reshape(W, K * channels, C)
    Jt = J.transpose(0, 2, 1)
    return Jt @ J, (Jt @ np.nan_to_num(residual).reshape(W, -1, 1))[..., 0]


def _add_fixes(H: np.ndarray, grad: np.ndarray, rows: np.ndarray, residual: np.ndarray, window: np.ndarray) -> None:
    """Add what position samples (m, 2, C) say to their windows' products."""
    for w in np.unique(window):
        J = rows[window == w].reshape(-1, rows.shape[2])
        H[w] += J.T @ J
        grad[w] += J.T @ residual[window == w].ravel()
