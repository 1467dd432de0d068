"""Everything that the logs say at one point about nodes, and about every effect's parameters, as normal equations.

Residuals are predicted minus measured, whitened. Columns: node (L), then one for each parameter. An effect's column of
accelerations delta_a(t) moves the state by

    S_{k+1} = Phi_k S_k + integral of exp(A (h - s)) delta_a(s) ds,   Phi = exp(h A)

(series to third order, A the mean of both ends; delta_a a parabola through both ends and the middle) from nothing at
each node: what it has done before is the node's business (the ties pass it on).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.diagnose.effect import Effect, slices
from sim.diagnose.physics import Accelerations, Physics, State
from sim.diagnose.readings import Readings, fade
from sim.diagnose.theta import Theta, among, secants
from sim.identify.structured.chain import Chain, Ties
from sim.identify.structured.data import PSI, RATE, SURGE, SWAY
from sim.identify.structured.linearise import BLOCK, HUBER
from sim.identify.structured.noise import BIAS_AX, BIAS_AY, BIAS_R, OFFSET, STATE, WANDER, L, Noise, whiten

EARLY, LATE = (1 / 2, 1 / 3, 1 / 8), (1 / 2, 1 / 6, 1 / 24)
"""Weights of I, hA, (hA)^2 on accelerations at both ends of a step, between which they go straight."""
SCALED = {"r": RATE, "ax": SURGE, "ay": SWAY}  # channels that an effect may scale
X0_D = 9  # columns of S before the effects': state (6) and latent acceleration (3) of the node


@dataclass(frozen=True)
class Columns:
    """What one unit of each parameter changes: accelerations, IMU (W, K, 4, P), places (m, 2, P)."""

    a: Accelerations
    imu: np.ndarray
    tag: np.ndarray


@dataclass(frozen=True)
class Point:
    """Normal equations of the data at theta, z. `cost`: half the weighted squares of the data [nats].

    `shares`: what the readings that an effect may scale have in the blocks of the nodes, (W, L, L) by name.
    `residuals` (W, K, 4), `fix_residuals` (m, 2): whitened, NaN where nothing was measured.
    """

    theta: Theta
    z: np.ndarray
    state: State
    chain: Chain
    ties: Ties
    cost: float
    residuals: np.ndarray
    fix_residuals: np.ndarray
    columns: Columns
    shares: dict[str, np.ndarray]

    def judged_only(self) -> Point:
        """Without its columns, which take most of the room: for evidence, not for steps."""
        a = self.columns.a
        nodes, bump, imu, tag = (part[..., :0].copy() for part in (a.nodes, a.bump, self.columns.imu, self.columns.tag))
        return replace(self, columns=Columns(Accelerations(nodes, bump), imu, tag))


class Lineariser:
    """Normal equations on the windows of `physics`. `weight` (m,): what each position sample counts."""

    def __init__(self, physics: Physics):
        self.physics, self.windows = physics, physics.windows
        self.readings = Readings(physics)
        self.weight = np.ones(len(self.readings.window))
        self._by_window = np.argsort(self.readings.window, kind="stable")

    def columns(self, effects: Sequence[Effect], theta: Theta, state: State, chosen: Sequence[Effect]) -> Columns:
        """Secants of all parameters of `chosen`; `effects`: those that may be in theta."""
        W, K = self.windows.size
        a = self.physics.accelerations(effects, theta, state, chosen)
        imu, tag = (np.zeros((*shape, a.nodes.shape[3])) for shape in ((W, K, 4), (len(self.readings.window), 2)))
        read = self.readings
        for each in secants(chosen, theta):
            name, every = each.effect.id, among(effects, each.effect)
            for hook, reading, out in (("imu", read.imu, imu), ("tag", read.tag, tag)):
                if hook in each.effect.hooks:
                    without = reading(every, {**theta, name: each.now}, state)
                    for at, step in each.steps.items():
                        there = reading(every, {**theta, name: each.now + step}, state)
                        out[..., at] = (there - without) / step.sum()
        return Columns(a, imu, tag)

    def refreshed(
        self,
        columns: Columns,
        effects: Sequence[Effect],
        theta: Theta,
        state: State,
        chosen: Sequence[Effect],
        which: Sequence[Effect],
    ) -> Columns:
        """`columns` of `chosen` with those of `which` computed anew."""
        if not which:
            return columns
        at = slices(chosen)
        index = np.concatenate([np.arange(at[e.id].start, at[e.id].stop) for e in which])
        fresh = self.columns(effects, theta, state, which)

        def mixed(old: np.ndarray, new: np.ndarray) -> np.ndarray:
            out = old.copy()
            out[..., index] = new
            return out

        a = Accelerations(mixed(columns.a.nodes, fresh.a.nodes), mixed(columns.a.bump, fresh.a.bump))
        return Columns(a, mixed(columns.imu, fresh.imu), mixed(columns.tag, fresh.tag))

    def point(
        self,
        effects: Sequence[Effect],
        theta: Theta,
        z: np.ndarray,
        noise: Noise,
        chosen: Sequence[Effect],
        state: State,
        columns: Columns | None = None,
    ) -> Point:
        """Normal equations at theta, z, where the boat moves as in `state`, with columns for parameters of `chosen`.

        `columns`: of a point so near that they will do.
        """
        residual, fix = self.readings.residuals(effects, theta, state, z, noise)
        columns = columns or self.columns(effects, theta, state, chosen)
        imu_slopes, tag_slopes = self.readings.slopes(effects, theta, state)
        size = np.sqrt((fix**2).sum(axis=1))
        root = np.sqrt(self.weight * np.minimum(1.0, HUBER / np.maximum(size, 1e-9)))[:, None]
        W, P = self.windows.size[0], columns.a.nodes.shape[3]
        chain = Chain(*(np.zeros(shape) for shape in ((W, L, L), (W, L, L), (W, L, P), (P, P), (W, L), (P,))))
        ends = np.empty((W, 6, X0_D + P))
        shares = {name: np.zeros((W, L, L)) for name in (*SCALED, "place")}
        ordered = self.readings.window[self._by_window]
        for start in range(0, W, BLOCK):
            part = slice(start, min(start + BLOCK, W))
            S = sensitivities(state.A[part], columns.a.nodes[part], columns.a.bump[part], self.windows.h_s[part])
            rows = self._imu_rows(imu_slopes, state, columns, S, noise, part)
            _add(chain, part, rows.reshape(len(rows), -1, L + P), np.nan_to_num(residual[part]).reshape(len(rows), -1))
            for name, channel in SCALED.items():
                own = rows[:, :, channel, :L]
                shares[name][part] = own.transpose(0, 2, 1) @ own
            mine = self._by_window[slice(*np.searchsorted(ordered, (part.start, part.stop)))]
            tag_rows = self._tag_rows(tag_slopes, columns, S, noise, part.start, mine) * root[mine, None]
            before = chain.A[part].copy()
            _add_fixes(chain, tag_rows, fix[mine] * root[mine], self.readings.window[mine])
            shares["place"][part] = chain.A[part] - before
            ends[part] = S[:, -1]
        ties = self._ties(state, ends, z, noise, P)
        return Point(theta, z, state, chain, ties, _cost(residual, fix, self.weight), residual, fix, columns, shares)

    def cost(
        self, effects: Sequence[Effect], theta: Theta, z: np.ndarray, noise: Noise, state: State
    ) -> tuple[float, np.ndarray]:
        """Cost of the data alone [nats] where the boat moves as in `state`, and what the ties leave (T, L)."""
        residual, fix = self.readings.residuals(effects, theta, state, z, noise)
        at, decay, _ = self._tied(noise)
        return _cost(residual, fix, self.weight), _rho(state, z, at, decay)

    def _tied(self, noise: Noise) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at = np.flatnonzero(~np.append(self.windows.first[1:], True))
        span = self.windows.t_s[at, -1] - self.windows.t_s[at, 0]
        return at, noise.tie(span)[0], span

    def _ties(self, state: State, ends: np.ndarray, z: np.ndarray, noise: Noise, P: int) -> Ties:
        at, decay, span = self._tied(noise)
        F, G = np.zeros((len(at), L, L)), np.zeros((len(at), L, P))
        diagonal = np.arange(L)
        F[:, diagonal, diagonal] = decay
        F[:, STATE, :X0_D] = ends[at, :, :X0_D]
        G[:, STATE] = ends[at, :, X0_D:]
        return Ties(_rho(state, z, at, decay), F, G, at, span)

    def _imu_rows(
        self, slopes: np.ndarray, state: State, columns: Columns, S: np.ndarray, noise: Noise, part: slice
    ) -> np.ndarray:
        """Rows (w, K, 4, L + P) of windows `part`. `slopes` (W, K, 4, 9): see `Readings.slopes`."""
        K, P = self.windows.size[1], columns.a.nodes.shape[3]
        S = S[:, :K]
        direct = np.concatenate(  # latent acceleration and effects act at once
            [np.broadcast_to(np.eye(3), (*S.shape[:2], 3, 3)), columns.a.nodes[part, :K]], axis=3
        )
        rates = state.A[part, :K, 3:] @ S
        rates[..., 6:] += direct
        moved = slopes[part] @ np.concatenate([S, rates], axis=2)
        moved[..., X0_D:] += columns.imu[part]
        known = np.isfinite(self.windows.y[part])
        rows = np.zeros((len(S), K, 4, L + P))
        _spread(rows[:, :, RATE:], moved[:, :, RATE:])
        for channel, column in ((RATE, BIAS_R), (SURGE, BIAS_AX), (SWAY, BIAS_AY)):
            rows[..., channel, column] = 1.0
        rows[:, :, RATE:] *= (known / np.array(noise.white))[:, :, RATE:, None]
        slow = np.stack([fade(self.windows, noise)[part], np.ones(S.shape[:2])], axis=2)
        heading = np.concatenate([moved[:, :, PSI], slow], axis=2)
        psi = whiten(heading, known[..., PSI], self.windows.h_s[part], noise)
        _spread(rows[:, :, PSI], psi[..., :-2])
        rows[:, :, PSI, WANDER], rows[:, :, PSI, OFFSET] = psi[..., -2], psi[..., -1]
        return rows

    def _tag_rows(
        self, slopes: np.ndarray, columns: Columns, S: np.ndarray, noise: Noise, start: int, mine: np.ndarray
    ) -> np.ndarray:
        """Rows (m, 2, L + P) of the fixes `mine` in windows from `start` on."""
        rows = np.zeros((len(mine), 2, L + columns.a.nodes.shape[3]))
        _spread(rows, slopes[mine] @ S[self.readings.window[mine] - start, self.readings.index[mine]])
        rows[:, :, L:] += columns.tag[mine]
        return rows / noise.fix_m


def sensitivities(A: np.ndarray, a: np.ndarray, bump: np.ndarray, h_s: np.ndarray) -> np.ndarray:
    """dx/d[x0; d; parameters] at all nodes of some windows, (W, K+1, 6, 9 + P); a (W, K+1, 3, P), bump (W, K, 3, P)."""
    W, K = h_s.shape
    P = a.shape[3]
    S = np.zeros((W, K + 1, 6, X0_D + P))
    S[:, 0, :, :6] = np.eye(6)
    h = h_s[..., None, None]
    hA = h * (A[:, :-1] + A[:, 1:]) / 2
    hA2 = hA @ hA
    Phi = np.eye(6) + hA + hA2 / 2 + hA2 @ hA / 6
    early, late = (h * (c0 * np.eye(6) + c1 * hA + c2 * hA2)[..., 3:] for c0, c1, c2 in (EARLY, LATE))
    G = np.empty((W, K, 6, 3 + P))
    G[..., :3] = early + late
    G[..., 3:] = early @ a[:, :-1] + late @ a[:, 1:]
    curved = np.flatnonzero(bump.any(axis=(0, 1, 2)))
    G[..., 3 + curved] += (h * (2 / 3 * np.eye(6) + hA / 3))[..., 3:] @ bump[..., curved]
    for k in range(K):
        S[:, k + 1] = Phi[:, k] @ S[:, k]
        S[:, k + 1, :, 6:] += G[:, k]
    return S


def _spread(target: np.ndarray, S: np.ndarray) -> None:
    target[..., :X0_D] = S[..., :X0_D]
    target[..., L : L + S.shape[-1] - X0_D] = S[..., X0_D:]


def _rho(state: State, z: np.ndarray, at: np.ndarray, decay: np.ndarray) -> np.ndarray:
    reached = decay * z[at]
    reached[:, STATE] = state.x[at, -1]
    return z[at + 1] - reached


def _cost(residual: np.ndarray, fix: np.ndarray, weight: np.ndarray) -> float:
    size = np.sqrt((fix**2).sum(axis=1))
    huber = np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2) @ weight
    return 0.5 * (float(np.nansum(residual**2)) + float(huber))


def _add(chain: Chain, part: slice, J: np.ndarray, residual: np.ndarray) -> None:
    """J^T J and J^T r of windows `part`; J (w, k, L + P), residual (w, k)."""
    nodes = J[:, :, :L].transpose(0, 2, 1)
    both = nodes @ J
    chain.A[part] += both[:, :, :L]
    chain.B[part] += both[:, :, L:]
    chain.g[part] += (nodes @ residual[:, :, None])[:, :, 0]
    own = J[:, :, L:].reshape(residual.size, J.shape[2] - L)
    chain.D += own.T @ own
    chain.d += own.T @ residual.ravel()


def _add_fixes(chain: Chain, rows: np.ndarray, residual: np.ndarray, window: np.ndarray) -> None:
    """The same for position samples, rows (m, 2, L + P), each of one window; those of one window in a row."""
    if not len(window):
        return
    starts = np.append(True, np.diff(window) != 0).nonzero()[0]
    nodes = rows[:, :, :L].transpose(0, 2, 1)
    both = np.add.reduceat(nodes @ rows, starts, axis=0)
    chain.A[window[starts]] += both[:, :, :L]
    chain.B[window[starts]] += both[:, :, L:]
    chain.g[window[starts]] += np.add.reduceat((nodes @ residual[:, :, None])[:, :, 0], starts, axis=0)
    own = rows[:, :, L:].reshape(residual.size, rows.shape[2] - L)
    chain.D += own.T @ own
    chain.d += own.T @ residual.ravel()
