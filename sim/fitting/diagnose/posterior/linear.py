"""Linearisation of the data at one point: normal equations of the nodes and of every effect's parameters.

Residuals are predicted minus measured, whitened. Columns of a window: its node (L), then one for each parameter. The
acceleration delta_a(t) (3,) per unit of a parameter changes the state along a window by the sensitivity S, from zero at
its node (earlier effects reach the window through its node and the ties):

    S_{k+1} = Phi_k S_k + integral from 0 to h of exp(A (h - s)) delta_a(s) ds,   Phi = exp(h A)

(series to third order, A the mean of both ends; delta_a a parabola through both ends and the middle).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect, parameter_slices
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues, including, secant_steps
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.posterior.readings import Readings
from sim.fitting.diagnose.posterior.state import Accelerations, WindowTrajectories
from sim.fitting.engine.block_tridiagonal import Chain, Ties
from sim.fitting.engine.jacobian_rows import (
    BLOCK,
    AccelerationPartials,
    fade,
    imu_jacobian,
    jacobian_columns,
    position_jacobian,
    sensitivities,
)
from sim.fitting.engine.kernels.windows import X0_D
from sim.fitting.engine.linearise import HUBER
from sim.fitting.engine.noise import STATE, L, Noise
from sim.fitting.engine.windows import RATE, SURGE, SWAY

SCALED = {"r": RATE, "ax": SURGE, "ay": SWAY}  # channels that an effect may scale


@dataclass(frozen=True)
class JacobianColumns:
    """Jacobian columns of P parameters: accelerations, IMU readings (W, K, 4, P), tag positions (m, 2, P)."""

    a: Accelerations
    imu: np.ndarray
    tag: np.ndarray


@dataclass(frozen=True)
class LinearisationPoint:
    """Normal equations of the data at theta and nodes z (W, L), where the boat moves as in `state`.

    chain, ties      block-tridiagonal normal equations; linearised continuity of neighbouring windows
    cost             half the weighted squares of the residuals, Huber on fixes [nats]
    residuals        (W, K, 4) whitened psi, r, a_x, a_y; NaN where nothing was measured
    fix_residuals    (m, 2) whitened position residuals
    columns          Jacobian columns of the free parameters
    shares           by scaled reading, its information F_w on each node, (W, L, L)
    """

    theta: ParameterValues
    z: np.ndarray
    state: WindowTrajectories
    chain: Chain
    ties: Ties
    cost: float
    residuals: np.ndarray
    fix_residuals: np.ndarray
    columns: JacobianColumns
    shares: dict[str, np.ndarray]

    def without_columns(self) -> LinearisationPoint:
        """The same without columns, which take most of the memory: enough for evidence, not for further steps."""
        a = self.columns.a
        nodes, bump, imu, tag = (
            part[..., :0].copy() for part in (a.nodes, a.mid_excess, self.columns.imu, self.columns.tag)
        )
        return replace(self, columns=JacobianColumns(Accelerations(nodes, bump), imu, tag))


class Lineariser:
    """Normal equations on the windows of `physics`. `weight` (m,): weight of each position sample, 1 by default."""

    def __init__(self, physics: EffectPhysics):
        self.physics, self.windows = physics, physics.windows
        self.readings = Readings(physics)
        self.weight = np.ones(len(self.readings.window))
        self._by_window = np.argsort(self.readings.window, kind="stable")

    def columns(
        self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories, free: Sequence[Effect]
    ) -> JacobianColumns:
        """Secant columns of all parameters of `free` at theta along `state`; `effects`: those that theta may hold."""
        W, K = self.windows.size
        a = self.physics.accelerations(effects, theta, state, free)
        imu, tag = (np.zeros((*shape, a.nodes.shape[3])) for shape in ((W, K, 4), (len(self.readings.window), 2)))
        read = self.readings
        now = {"imu": read.imu(effects, theta, state), "tag": read.tag(effects, theta, state)}
        known = {e.id for e in effects} & theta.keys()
        for each in secant_steps(free, theta):
            name, every = each.effect.id, including(effects, each.effect)
            for hook, reading, out in (("imu", read.imu, imu), ("tag", read.tag, tag)):
                if hook in each.effect.hooks:
                    without = now[hook] if name in known else reading(every, {**theta, name: each.now}, state)
                    for at, step in each.steps.items():
                        there = reading(every, {**theta, name: each.now + step}, state)
                        out[..., at] = (there - without) / step.sum()
        return JacobianColumns(a, imu, tag)

    def refreshed(
        self,
        columns: JacobianColumns,
        effects: Sequence[Effect],
        theta: ParameterValues,
        state: WindowTrajectories,
        free: Sequence[Effect],
        which: Sequence[Effect],
    ) -> JacobianColumns:
        """`columns` of `free` with those of `which` computed anew."""
        if not which:
            return columns
        at = parameter_slices(free)
        index = np.concatenate([np.arange(at[e.id].start, at[e.id].stop) for e in which])
        fresh = self.columns(effects, theta, state, which)

        def mixed(old: np.ndarray, new: np.ndarray) -> np.ndarray:
            out = old.copy()
            out[..., index] = new
            return out

        a = Accelerations(mixed(columns.a.nodes, fresh.a.nodes), mixed(columns.a.mid_excess, fresh.a.mid_excess))
        return JacobianColumns(a, mixed(columns.imu, fresh.imu), mixed(columns.tag, fresh.tag))

    def point(
        self,
        effects: Sequence[Effect],
        theta: ParameterValues,
        z: np.ndarray,
        noise: Noise,
        free: Sequence[Effect],
        state: WindowTrajectories,
        columns: JacobianColumns | None = None,
    ) -> LinearisationPoint:
        """Normal equations at (theta, z), where the boat moves as in `state`, with columns for parameters of `free`.

        `columns`: of a nearby point, to be used again.
        """
        # 1. Residuals, slopes of the readings, Huber weights of the fixes.
        residual, fix = self.readings.residuals(effects, theta, state, z, noise)
        columns = columns or self.columns(effects, theta, state, free)
        slopes = self.readings.slopes(effects, theta, state)
        size = np.sqrt((fix**2).sum(axis=1))
        root = np.sqrt(self.weight * np.minimum(1.0, HUBER / np.maximum(size, 1e-9)))
        # 2. Blocks of windows: sensitivities S, rows of IMU and fixes, products into the chain.
        W, P = self.windows.size[0], columns.a.nodes.shape[3]
        pushes = AccelerationPartials.of(columns.a.nodes, columns.a.mid_excess)
        chain, ends = Chain.nothing(W, L, P), np.empty((W, 6, X0_D + P))
        shares = {name: np.zeros((W, L, L)) for name in (*SCALED, "place")}
        ordered = self.readings.window[self._by_window]
        for start in range(0, W, BLOCK):
            part = slice(start, min(start + BLOCK, W))
            samples = self._by_window[slice(*np.searchsorted(ordered, (part.start, part.stop)))]
            S, imu, tag = self._rows(state.A[part], pushes.part(part), columns, slopes, root, noise, part, samples)
            chain.add(part, imu.reshape(len(imu), -1, L + P), np.nan_to_num(residual[part]).reshape(len(imu), -1))
            for name, channel in SCALED.items():
                own = imu[:, :, channel, :L]
                shares[name][part] = own.transpose(0, 2, 1) @ own
            before = chain.A[part].copy()
            chain.add_samples(self.readings.window[samples], tag, fix[samples] * root[samples, None])
            shares["place"][part] = chain.A[part] - before
            ends[part] = S[:, -1]
        # 3. Continuity: rho = z_{w+1} - F z_w at the end of each window.
        ties = self._ties(state, ends, z, noise)
        return LinearisationPoint(
            theta, z, state, chain, ties, _cost(residual, fix, self.weight), residual, fix, columns, shares
        )

    def _rows(
        self,
        A: np.ndarray,
        pushes: AccelerationPartials,
        columns: JacobianColumns,
        slopes: tuple[np.ndarray, np.ndarray],
        root: np.ndarray,
        noise: Noise,
        part: slice,
        samples: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sensitivities S, IMU rows and position rows of the windows `part` and their position samples `samples`.

        `A`, `pushes`: those of the part; `root` (m,): square roots of the fixes' weights.
        """
        P, read, h_s = columns.imu.shape[3], self.readings, self.windows.h_s[part]
        S = sensitivities(A, pushes, h_s)
        known, wander, place = (
            np.isfinite(self.windows.y[part]),
            fade(self.windows, noise)[part],
            jacobian_columns(np.arange(P)),
        )
        imu = imu_jacobian(S, A, pushes, slopes[0][part], columns.imu[part], known, (h_s, wander), noise, place, L + P)
        at = read.window[samples] - part.start, read.index[samples]
        tag = position_jacobian(
            S, at, slopes[1][samples], columns.tag[samples], root[samples] / noise.fix_m, place, L + P
        )
        return S, imu, tag

    def cost(
        self, effects: Sequence[Effect], theta: ParameterValues, z: np.ndarray, noise: Noise, state: WindowTrajectories
    ) -> tuple[float, np.ndarray]:
        """Data cost [nats] where the boat moves as in `state`, and residuals rho (T, L) of the T ties."""
        residual, fix = self.readings.residuals(effects, theta, state, z, noise)
        at, decay, _ = self._tied(noise)
        return _cost(residual, fix, self.weight), _rho(state, z, at, decay)

    def _tied(self, noise: Noise) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at, span = self.windows.tied()
        return at, noise.tie(span)[0], span

    def _ties(self, state: WindowTrajectories, ends: np.ndarray, z: np.ndarray, noise: Noise) -> Ties:
        at, decay, span = self._tied(noise)
        F = np.zeros((len(at), L, L))
        diagonal = np.arange(L)
        F[:, diagonal, diagonal] = decay
        F[:, STATE, :X0_D] = ends[at, :, :X0_D]
        return Ties(_rho(state, z, at, decay), F, ends[at, :, X0_D:].copy(), at, span)


def _rho(state: WindowTrajectories, z: np.ndarray, at: np.ndarray, decay: np.ndarray) -> np.ndarray:
    """rho = z_{w+1} - F(z_w), (T, L): states as integrated to the window's end, biases and latent decayed."""
    reached = decay * z[at]
    reached[:, STATE] = state.x[at, -1]
    return z[at + 1] - reached


def _cost(residual: np.ndarray, fix: np.ndarray, weight: np.ndarray) -> float:
    """Half the squares of the IMU residuals and half the weighted Huber loss of the fixes [nats]."""
    size = np.sqrt((fix**2).sum(axis=1))
    huber = np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2) @ weight
    return 0.5 * (float(np.nansum(residual**2)) + float(huber))
