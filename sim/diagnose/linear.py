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
from sim.diagnose.sight import sight
from sim.diagnose.theta import Theta, among, secants, values_of
from sim.identify.structured.chain import Chain, Ties
from sim.identify.structured.data import PSI, RATE, SURGE, SWAY
from sim.identify.structured.linearise import BLOCK, HUBER
from sim.identify.structured.noise import BIAS_AX, BIAS_AY, BIAS_R, OFFSET, STATE, WANDER, L, Noise, whiten

EARLY, LATE = (1 / 2, 1 / 3, 1 / 8), (1 / 2, 1 / 6, 1 / 24)
"""Weights of I, hA, (hA)^2 on accelerations at both ends of a step, between which they go straight."""
SCALED = {"r": RATE, "ax": SURGE, "ay": SWAY}  # channels that an effect may scale
NUDGE = 1e-6  # of states and accelerations, for the slopes of readings
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


class Lineariser:
    """Residuals and normal equations on the windows of `physics`. `weight` (m,): what each position sample counts."""

    def __init__(self, physics: Physics):
        self.physics, self.windows = physics, physics.windows
        vessel = physics.vessel
        self._imu_arm = (vessel.sensors.imu.x_m, vessel.sensors.imu.y_m)
        self._arm = np.array([vessel.sensors.uwb.x_m, vessel.sensors.uwb.y_m])
        self._window, self._index, self._when = self._places(vessel.sensors.uwb.latency_s)
        self.weight = np.ones(len(self._when))
        self._by_window = np.argsort(self._window, kind="stable")
        self._delta = self._when - self.windows.t_s[self._window, self._index]

    def _places(self, latency_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Window and step before each position sample, and when it was taken [s]."""
        windows, fixes = self.windows, self.windows.fixes
        when = fixes.t_s - latency_s
        w, k = np.empty(len(when), dtype=int), np.empty(len(when), dtype=int)
        for i, (span, (t, starts)) in enumerate(zip(windows.spans, windows.grids, strict=True)):
            mine = fixes.run == i
            step = np.clip(np.searchsorted(t, when[mine], side="right") - 1, 0, len(t) - 2)
            own = np.searchsorted(starts, step, side="right") - 1
            w[mine], k[mine] = own + span.start, step - starts[own]
        return w, k, when

    def imu(self, effects: Sequence[Effect], theta: Theta, state: State) -> np.ndarray:
        """psi, r, a_x, a_y as the sensors should say, without node biases, (W, K, 4)."""
        K = self.windows.size[1]
        x, nd = state.x[:, :K], state.nu_dot[:, :K]
        u, v, r = x[..., 3], x[..., 4], x[..., 5]
        lx, ly = self._imu_arm
        ax = nd[..., 0] - v * r - lx * r**2 - ly * nd[..., 2]
        ay = nd[..., 1] + u * r - ly * r**2 + lx * nd[..., 2]
        y = np.stack([x[..., 2], r, ax, ay], axis=2)
        scene = self.physics.scene(state).part(K)
        for effect, p in values_of(effects, theta, "imu"):
            y = effect.hooks["imu"](p, scene, y)
        return y

    def tag(self, effects: Sequence[Effect], theta: Theta, state: State) -> np.ndarray:
        """Places as the tag should report them, (m, 2)."""
        w, k = self._window, self._index
        return self._seen(effects, theta, state.x[w, k], state.nu_dot[w, k])

    def _seen(self, effects: Sequence[Effect], theta: Theta, x: np.ndarray, nu_dot: np.ndarray) -> np.ndarray:
        """The same from states (m, 6) and accelerations (m, 3) at the nodes before."""
        seen = sight(self.physics, x, nu_dot, self._delta, self._arm, self._when)
        place = seen.place_m
        for effect, p in values_of(effects, theta, "tag"):
            place = effect.hooks["tag"](p, seen, place)
        return place

    def residuals(
        self, effects: Sequence[Effect], theta: Theta, state: State, z: np.ndarray, noise: Noise
    ) -> tuple[np.ndarray, np.ndarray]:
        """Whitened, (W, K, 4) and (m, 2)."""
        error = self.imu(effects, theta, state) - self.windows.y
        error[..., PSI] += z[:, None, OFFSET] + self._fade(noise) * z[:, None, WANDER]
        for channel, bias in ((RATE, BIAS_R), (SURGE, BIAS_AX), (SWAY, BIAS_AY)):
            error[..., channel] += z[:, None, bias]
        out = error / np.array(noise.white)
        known = np.isfinite(error[..., PSI])
        psi = whiten(np.where(known, error[..., PSI], 0.0)[..., None], known, self.windows.h_s, noise)
        out[..., PSI] = np.where(known, psi[..., 0], np.nan)
        return out, (self.tag(effects, theta, state) - self.windows.fixes.place_m) / noise.fix_m

    def _fade(self, noise: Noise) -> np.ndarray:
        t = self.windows.t_s[:, :-1]
        return np.exp(-(t - t[:, :1]) / noise.wander_time_s)

    def columns(self, effects: Sequence[Effect], theta: Theta, state: State, chosen: Sequence[Effect]) -> Columns:
        """Secants of all parameters of `chosen`; `effects`: those that may be in theta."""
        W, K = self.windows.size
        a = self.physics.accelerations(effects, theta, state, chosen)
        imu, tag = (np.zeros((*shape, a.nodes.shape[3])) for shape in ((W, K, 4), (len(self._when), 2)))
        for at, (effect, now, step) in enumerate(secants(chosen, theta)):
            there, without = {**theta, effect.id: now + step}, {**theta, effect.id: now}
            every = among(effects, effect)
            if "imu" in effect.hooks:
                imu[..., at] = (self.imu(every, there, state) - self.imu(every, without, state)) / step.sum()
            if "tag" in effect.hooks:
                tag[..., at] = (self.tag(every, there, state) - self.tag(every, without, state)) / step.sum()
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
        residual, fix = self.residuals(effects, theta, state, z, noise)
        columns = columns or self.columns(effects, theta, state, chosen)
        imu_slopes, tag_slopes = self._imu_slopes(effects, theta, state), self._tag_slopes(effects, theta, state)
        size = np.sqrt((fix**2).sum(axis=1))
        root = np.sqrt(self.weight * np.minimum(1.0, HUBER / np.maximum(size, 1e-9)))[:, None]
        W, P = self.windows.size[0], columns.a.nodes.shape[3]
        chain = Chain(*(np.zeros(shape) for shape in ((W, L, L), (W, L, L), (W, L, P), (P, P), (W, L), (P,))))
        ends = np.empty((W, 6, X0_D + P))
        shares = {name: np.zeros((W, L, L)) for name in (*SCALED, "place")}
        for start in range(0, W, BLOCK):
            part = slice(start, min(start + BLOCK, W))
            S = sensitivities(state.A[part], columns.a.nodes[part], columns.a.bump[part], self.windows.h_s[part])
            rows = self._imu_rows(imu_slopes, state, columns, S, noise, part)
            _add(chain, part, rows.reshape(len(rows), -1, L + P), np.nan_to_num(residual[part]).reshape(len(rows), -1))
            for name, channel in SCALED.items():
                own = rows[:, :, channel, :L]
                shares[name][part] = own.transpose(0, 2, 1) @ own
            mine = self._by_window[slice(*np.searchsorted(self._window[self._by_window], (part.start, part.stop)))]
            tag_rows = self._tag_rows(tag_slopes, columns, S, noise, part.start, mine) * root[mine, None]
            before = chain.A[part].copy()
            _add_fixes(chain, tag_rows, fix[mine] * root[mine], self._window[mine])
            shares["place"][part] = chain.A[part] - before
            ends[part] = S[:, -1]
        ties = self._ties(state, ends, z, noise, P)
        return Point(theta, z, state, chain, ties, _cost(residual, fix, self.weight), residual, fix, columns, shares)

    def cost(
        self, effects: Sequence[Effect], theta: Theta, z: np.ndarray, noise: Noise, state: State
    ) -> tuple[float, np.ndarray]:
        """Cost of the data alone [nats] where the boat moves as in `state`, and what the ties leave (T, L)."""
        residual, fix = self.residuals(effects, theta, state, z, noise)
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
        """Rows (w, K, 4, L + P) of windows `part`. `slopes` (W, K, 4, 9): see `_imu_slopes`."""
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
        slow = np.stack([self._fade(noise)[part], np.ones(S.shape[:2])], axis=2)
        heading = np.concatenate([moved[:, :, PSI], slow], axis=2)
        psi = whiten(heading, known[..., PSI], self.windows.h_s[part], noise)
        _spread(rows[:, :, PSI], psi[..., :-2])
        rows[:, :, PSI, WANDER], rows[:, :, PSI, OFFSET] = psi[..., -2], psi[..., -1]
        return rows

    def _imu_slopes(self, effects: Sequence[Effect], theta: Theta, state: State) -> np.ndarray:
        """What psi, r, a_x, a_y change with x y psi u v r u_dot v_dot r_dot, by differences, (W, K, 4, 9)."""
        now, motion = self.imu(effects, theta, state), np.concatenate([state.x, state.nu_dot], axis=2)
        slopes = np.empty((*now.shape, 9))
        for j in range(9):
            moved = motion.copy()
            moved[..., j] += NUDGE
            there = replace(state, x=moved[..., :6], nu_dot=moved[..., 6:])
            slopes[..., j] = (self.imu(effects, theta, there) - now) / NUDGE
        return slopes

    def _tag_slopes(self, effects: Sequence[Effect], theta: Theta, state: State) -> np.ndarray:
        """What the tag's places change with x y psi u v r at the node before, by differences, (m, 2, 6)."""
        w, k = self._window, self._index
        x, nu_dot, A = state.x[w, k], state.nu_dot[w, k], state.A[w, k, 3:]
        now = self._seen(effects, theta, x, nu_dot)
        slopes = np.empty((len(w), 2, 9))
        for j in range(9):
            moved = np.concatenate([x, nu_dot], axis=1)
            moved[:, j] += NUDGE
            slopes[..., j] = (self._seen(effects, theta, moved[:, :6], moved[:, 6:]) - now) / NUDGE
        return slopes[..., :6] + slopes[..., 6:] @ A

    def _tag_rows(
        self, slopes: np.ndarray, columns: Columns, S: np.ndarray, noise: Noise, start: int, mine: np.ndarray
    ) -> np.ndarray:
        """Rows (m, 2, L + P) of the fixes `mine` in windows from `start` on."""
        rows = np.zeros((len(mine), 2, L + columns.a.nodes.shape[3]))
        _spread(rows, slopes[mine] @ S[self._window[mine] - start, self._index[mine]])
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
