"""Gauss-Newton linearisation: all measurements at one point (q, z) as normal equations of nodes and parameters.

    cost = 1/2 sum |r_imu|^2 + sum huber(|r_fix|),    H = J^T J,    g = J^T r       residuals whitened

Huber's loss is solved by re-weighting: a position whose whitened residual has length s > HUBER gets weight HUBER / s.
"""

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

HUBER = 2.5  # sigmas from which a residual counts linearly, not squared: 97 % efficient on normal noise


@dataclass(frozen=True)
class Linearised:
    """The data at one point, without priors.

    chain          normal equations of the measurements in z and q
    cost           negative log likelihood of the measurements, up to a constant [nats]
    ties           continuity conditions between neighbouring windows, linearised
    residuals      (W, K, 4) of IMU and compass, whitened, NaN where nothing was measured
    fix_residuals  (m, 2) of positions, whitened
    motion         trajectories at this point
    """

    chain: Chain
    cost: float
    ties: Ties
    residuals: np.ndarray
    fix_residuals: np.ndarray
    motion: WindowMotion


class FitProblem:
    """The parts of a fit that stay the same between iterations: windows, parameters, compiled model, sensors."""

    def __init__(self, windows: Windows, parameters: Parameters, compiled: CompiledModel):
        self.windows, self.parameters = windows, parameters
        self.move = WindowIntegrator(windows, parameters, compiled)
        self.imu, self.tag = ImuResiduals(windows, parameters), TagResiduals(windows, parameters)

    def linearise(self, q: np.ndarray, z: np.ndarray, noise: Noise, motion: WindowMotion | None = None) -> Linearised:
        """Normal equations at parameters q (P,) and nodes z (W, L), without priors.

        `motion`: the trajectories at q and z where they are known already.
        """
        # 1. Trajectories, residuals, Huber weights of the positions.
        motion = motion or self.move(q, z)
        path = self.tag.path(motion, q)
        residual, fix_residual = self.imu.residual(motion, q, z, noise), self.tag.residual(path, q, noise)
        size = np.sqrt((fix_residual**2).sum(axis=1))
        root = np.sqrt(np.minimum(1.0, HUBER / np.maximum(size, 1e-9)))
        # 2. Partial derivatives of the sensors.
        W, P = self.windows.size[0], len(q)
        place, direct = jacobian_columns(self.parameters.moving), np.empty((W, self.windows.size[1], 4, 0))
        imu_slopes, tag_slopes, wander = self.imu.slopes(motion, q), self.tag.slopes(path), fade(self.windows, noise)
        chain, ends = Chain.nothing(W, L, P), np.empty((W, 6, len(place)))
        samples, whitened = np.zeros((len(size), 2, L + P)), fix_residual * root[:, None]
        # 3. By blocks of windows: sensitivities S, rows of J, and J^T J, J^T r added to the normal equations.
        for start in range(0, W, BLOCK):
            part = slice(start, min(start + BLOCK, W))
            A, pushes, h_s = motion.A[part], motion.pushes.part(part), self.windows.h_s[part]
            S, known = sensitivities(A, pushes, h_s), np.isfinite(self.windows.y[part])
            steps = h_s, wander[part]
            rows = imu_jacobian(S, A, pushes, imu_slopes[part], direct[part], known, steps, noise, place, L + P)
            self.imu.add_own(rows, motion, part, noise)
            chain.add(part, rows.reshape(len(rows), -1, L + P), np.nan_to_num(residual[part]).reshape(len(rows), -1))
            mine = np.flatnonzero((path.window >= part.start) & (path.window < part.stop))
            at, nothing = (path.window[mine] - start, path.step[mine]), np.empty((len(mine), 2, 0))
            samples[mine] = position_jacobian(S, at, tag_slopes[mine], nothing, root[mine] / noise.fix_m, place, L + P)
            ends[part] = S[:, -1]
        # 4. Rows of the positions, with the derivatives by latency, lever arm and warp.
        self.tag.add_own(samples, path, root / noise.fix_m)
        chain.add_samples(path.window, samples, whitened)
        # 5. Cost.
        huber = np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2).sum()
        cost = 0.5 * (float(np.nansum(residual**2)) + float(huber))
        return Linearised(chain, cost, self._ties(motion, ends, z, noise), residual, fix_residual, motion)

    def _ties(self, motion: WindowMotion, ends: np.ndarray, z: np.ndarray, noise: Noise) -> Ties:
        """Continuity of neighbouring windows: rho = z_{w+1} - f(z_w, q), F = df/dz_w, G = df/dq of the states.

        `ends` (W, 6, C): sensitivities S at the end of each window. States follow the model; latent acceleration,
        biases and slow heading errors decay as `noise.tie` has it.
        """
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
