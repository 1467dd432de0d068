"""Everything that the measurements say at one point, as normal equations of the chain of nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.fitting.engine.block_tridiagonal import Chain, Ties
from sim.fitting.engine.jacobian_rows import (
    BLOCK,
    fade,
    imu_jacobian,
    jacobian_columns,
    position_jacobian,
    sensitivities,
)
from sim.fitting.engine.kernels.windows import X0_D
from sim.fitting.engine.model import CompiledModel
from sim.fitting.engine.motion import WindowIntegrator, WindowMotion
from sim.fitting.engine.noise import STATE, L, Noise
from sim.fitting.engine.parameters import Parameters
from sim.fitting.engine.sensors import ImuResiduals, TagResiduals
from sim.fitting.engine.windows import Windows

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
    motion: WindowMotion


class FitProblem:
    """What does not change between iterations."""

    def __init__(self, windows: Windows, parameters: Parameters, compiled: CompiledModel):
        imu = parameters.vessel.sensors.imu
        self.windows, self.parameters = windows, parameters
        self.move = WindowIntegrator(windows, parameters, compiled)
        self.imu, self.tag = ImuResiduals(windows, (imu.x_m, imu.y_m)), TagResiduals(windows, parameters)

    def linearise(self, q: np.ndarray, z: np.ndarray, noise: Noise, motion: WindowMotion | None = None) -> Linearised:
        """Normal equations at parameters q (P,) and nodes z (W, L), without priors; `motion`: where it is known."""
        motion = motion or self.move(q, z)
        path = self.tag.path(motion, q)
        residual, fix_residual = self.imu.residual(motion, z, noise), self.tag.residual(path, q, noise)
        size = np.sqrt((fix_residual**2).sum(axis=1))
        root = np.sqrt(np.minimum(1.0, HUBER / np.maximum(size, 1e-9)))
        W, P = self.windows.size[0], len(q)
        place, direct = jacobian_columns(self.parameters.moving), np.empty((W, self.windows.size[1], 4, 0))
        imu_slopes, tag_slopes, wander = self.imu.slopes(motion), self.tag.slopes(path), fade(self.windows, noise)
        chain, ends = Chain.nothing(W, L, P), np.empty((W, 6, len(place)))
        samples, whitened = np.zeros((len(size), 2, L + P)), fix_residual * root[:, None]
        for start in range(0, W, BLOCK):
            part = slice(start, min(start + BLOCK, W))
            A, pushes, h_s = motion.A[part], motion.pushes.part(part), self.windows.h_s[part]
            S, known = sensitivities(A, pushes, h_s), np.isfinite(self.windows.y[part])
            steps = h_s, wander[part]
            rows = imu_jacobian(S, A, pushes, imu_slopes[part], direct[part], known, steps, noise, place, L + P)
            chain.add(part, rows.reshape(len(rows), -1, L + P), np.nan_to_num(residual[part]).reshape(len(rows), -1))
            mine = np.flatnonzero((path.window >= part.start) & (path.window < part.stop))
            at, nothing = (path.window[mine] - start, path.step[mine]), np.empty((len(mine), 2, 0))
            samples[mine] = position_jacobian(S, at, tag_slopes[mine], nothing, root[mine] / noise.fix_m, place, L + P)
            ends[part] = S[:, -1]
        self.tag.add_own(samples, path, root / noise.fix_m)
        chain.add_samples(path.window, samples, whitened)
        huber = np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2).sum()
        cost = 0.5 * (float(np.nansum(residual**2)) + float(huber))
        return Linearised(chain, cost, self._ties(motion, ends, z, noise), residual, fix_residual, motion)

    def _ties(self, motion: WindowMotion, ends: np.ndarray, z: np.ndarray, noise: Noise) -> Ties:
        at, span = self.windows.tied()
        decay, _ = noise.tie(span)
        F, G = np.zeros((len(at), L, L)), np.zeros((len(at), 6, len(self.parameters.names)))
        diagonal = np.arange(L)
        F[:, diagonal, diagonal] = decay
        F[:, STATE, :X0_D] = ends[at, :, :X0_D]
        G[:, :, self.parameters.moving] = ends[at, :, X0_D:]
        reached = decay * z[at]
        reached[:, STATE] = motion.x[at, -1]
        return Ties(z[at + 1] - reached, F, G, at, span)
