"""Prediction of every measurement from the nodes and parameters, with derivatives, as normal equations.

Within a window the boat moves by the model alone, from its node z_w under the commands plus a latent acceleration.
Sensitivities S = dx/d[node; q] follow the trajectory,

    S_{k+1} = Phi_k S_k + Gamma_k,   Phi = I + h/2 (A_k + A_{k+1}) + h^2/2 A_{k+1} A_k,   Gamma alike,

with the exact Jacobians A of the model at each step (its error, below 1e-4, slows convergence, it moves no estimate).
Columns: node (L), then q (P) in file units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.thrusters import configuration_matrix
from sim.identify.structured.chain import Chain, Ties
from sim.identify.structured.data import PSI, RATE, SURGE, SWAY, Windows
from sim.identify.structured.model import N_HULL, Compiled
from sim.identify.structured.noise import BIAS_AX, BIAS_AY, BIAS_R, LATENT, OFFSET, STATE, WANDER, L, Noise, whiten
from sim.identify.structured.parameters import Parameters
from sim.identify.structured.thrust import ThrustHistory

HUBER = 2.5  # whitened fixes beyond this count linearly, not squared: 97 % efficient on normal noise


@dataclass(frozen=True)
class Linearised:
    """Normal equations of the data alone at one point, what ties the nodes, and the residuals.

    `cost`: half the weighted sum of squares of the data [nats].
    """

    chain: Chain
    cost: float
    ties: Ties
    residuals: np.ndarray  # (W, K, 4) whitened, NaN where nothing was measured
    fix_residuals: np.ndarray  # (m, 2) whitened
    states: np.ndarray  # (W, K + 1, 6)


@dataclass(frozen=True)
class _Motion:
    """Trajectories and what they hang on: x (W, K+1, 6), nu_dot (.., 3), A (.., 6, 6), G (.., 3, inputs)."""

    x: np.ndarray
    nu_dot: np.ndarray
    A: np.ndarray
    G: np.ndarray
    S: np.ndarray


@dataclass(frozen=True)
class Problem:
    """What does not change between iterations."""

    windows: Windows
    parameters: Parameters
    compiled: Compiled

    def linearise(self, q: np.ndarray, z: np.ndarray, noise: Noise) -> Linearised:
        """Normal equations at parameters q (P,) and nodes z (W, L), without priors."""
        motion = self._move(q, z)
        rows, residual = self._imu_rows(motion, z, noise)
        fix_rows, fix_residual, window = self._fix_rows(motion, q, noise)
        size = np.sqrt((fix_residual**2).sum(axis=1))
        weight = np.minimum(1.0, HUBER / np.maximum(size, 1e-9))
        H, grad = _normal(rows, residual, fix_rows, fix_residual, weight, window)
        chain = Chain.of_data(H, grad, L)
        huber = np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2).sum()
        cost = 0.5 * (float(np.nansum(residual**2)) + float(huber))
        return Linearised(chain, cost, self._ties(motion, z, noise), residual, fix_residual, motion.x)

    def _thrust(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Unit-gain forces at nodes (W, K+1, n), at the middles (W, K, n), and the derivatives at nodes."""
        at = self.parameters.thrusters.stop
        middle = self.windows.t_s[:, :-1] + self.windows.h_s / 2
        f, f_mid, f_dead, f_lag = [], [], [], []
        for span, commands in zip(self.windows.spans, self.windows.commands, strict=True):
            history = ThrustHistory(commands, float(q[at]), float(q[at + 1]))
            here = history.at(self.windows.t_s[span])
            for store, value in zip((f, f_dead, f_lag), here, strict=True):
                store.append(value)
            f_mid.append(history.at(middle[span])[0])
        return np.concatenate(f), np.concatenate(f_mid), np.concatenate(f_dead), np.concatenate(f_lag)

    def _move(self, q: np.ndarray, z: np.ndarray) -> _Motion:
        W, K = self.windows.size
        vessel = self.parameters.vessel
        gains = q[self.parameters.thrusters]
        B = configuration_matrix(vessel)
        share = (B * gains).T
        f, f_mid, f_dead, f_lag = self._thrust(q)
        d = z[:, LATENT]
        tau, tau_mid = f @ share, f_mid @ share
        taus = np.concatenate([tau[:, :-1], tau_mid, tau[:, 1:]], axis=2)
        p = q[:N_HULL]
        h = self.windows.h_s
        x = np.empty((W, K + 1, 6))
        x[:, 0] = z[:, STATE]
        (after,) = self.compiled.rollout(z[:, STATE], np.tile(p, (W, K)), taus.reshape(W, -1), np.tile(d, (1, K)), h)
        x[:, 1:] = after.reshape(W, K, 6)
        nodes = W * (K + 1)
        d_all = np.repeat(d, K + 1, axis=0)
        A, G, nu_dot = self.compiled.rates(x.reshape(-1, 6), np.tile(p, (nodes, 1)), tau.reshape(-1, 3), d_all)
        A = A.reshape(W, K + 1, 6, 6).swapaxes(2, 3)
        G = G.reshape(W, K + 1, N_HULL + 3, 3).swapaxes(2, 3)
        G_tau = G[..., N_HULL:]
        inputs = [np.broadcast_to(np.eye(3), G_tau.shape), G[..., :N_HULL], (G_tau @ B) * f[:, :, None, :]]
        inputs += [G_tau @ (f_dead @ share)[..., None], G_tau @ (f_lag @ share)[..., None]]
        G_all = np.concatenate(inputs, axis=3)
        return _Motion(x, nu_dot.reshape(W, K + 1, 3), A, G_all, _sensitivities(A, G_all, h))

    def _imu_rows(self, motion: _Motion, z: np.ndarray, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
        """Whitened Jacobian (W, K, 4, L + P) and residual (W, K, 4)."""
        W, K = self.windows.size
        imu = self.parameters.vessel.sensors.imu
        lx, ly = imu.x_m, imu.y_m
        x, nd, A, G, S = motion.x[:, :K], motion.nu_dot[:, :K], motion.A[:, :K], motion.G[:, :K], motion.S[:, :K]
        u, v, r = x[..., 3], x[..., 4], x[..., 5]
        predicted = np.stack(
            [
                x[..., 2] + z[:, None, OFFSET],
                r + z[:, None, BIAS_R],
                nd[..., 0] - v * r - lx * r**2 - ly * nd[..., 2] + z[:, None, BIAS_AX],
                nd[..., 1] + u * r - ly * r**2 + lx * nd[..., 2] + z[:, None, BIAS_AY],
            ],
            axis=2,
        )
        C_ax, C_ay = A[..., 3, :] - ly * A[..., 5, :], A[..., 4, :] + lx * A[..., 5, :]
        C_ax[..., 4] -= r
        C_ax[..., 5] -= v + 2 * lx * r
        C_ay[..., 3] += r
        C_ay[..., 5] += u - 2 * ly * r
        n_dyn = S.shape[3]
        rows = np.zeros((W, K, 4, L + len(self.parameters.names)))
        dyn = _dynamic_columns(n_dyn)
        rows[..., PSI, dyn], rows[..., RATE, dyn] = S[..., 2, :], S[..., 5, :]
        rows[..., SURGE, dyn] = (C_ax[..., None, :] @ S)[..., 0, :]
        rows[..., SWAY, dyn] = (C_ay[..., None, :] @ S)[..., 0, :]
        direct = dyn[6:]
        rows[..., SURGE, direct] += G[..., 0, :] - ly * G[..., 2, :]
        rows[..., SWAY, direct] += G[..., 1, :] + lx * G[..., 2, :]
        since = self.windows.t_s[:, :K] - self.windows.t_s[:, :1]
        fade = np.exp(-since / noise.wander_time_s)
        predicted[..., PSI] += fade * z[:, None, WANDER]
        rows[..., PSI, WANDER] = fade
        for channel, column in ((PSI, OFFSET), (RATE, BIAS_R), (SURGE, BIAS_AX), (SWAY, BIAS_AY)):
            rows[..., channel, column] = 1.0
        error = predicted - self.windows.y
        known = np.isfinite(error)
        both = np.concatenate([rows[:, :, PSI], np.where(known[..., PSI], error[..., PSI], 0.0)[..., None]], axis=2)
        psi = whiten(both, known[..., PSI], self.windows.h_s, noise)
        scale = known / np.array(noise.white)
        rows *= scale[..., None]
        rows[:, :, PSI] = psi[..., :-1]
        residual = np.where(known, error, 0.0) * scale
        residual[..., PSI] = psi[..., -1]
        return rows, np.where(known, residual, np.nan)

    def _fix_rows(self, motion: _Motion, q: np.ndarray, noise: Noise) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Whitened Jacobian (m, 2, L + P), residual (m, 2) and the window of each position sample."""
        windows, fixes = self.windows, self.windows.fixes
        at = self.parameters.thrusters.stop + 2
        latency, arm = q[at], q[at + 1 : at + 3]
        when = fixes.t_s - latency
        w, k = np.empty(len(when), dtype=int), np.empty(len(when), dtype=int)
        for i, (span, (t, starts)) in enumerate(zip(windows.spans, windows.grids, strict=True)):
            mine = fixes.run == i
            step = np.clip(np.searchsorted(t, when[mine], side="right") - 1, 0, len(t) - 2)
            own = np.searchsorted(starts, step, side="right") - 1
            w[mine], k[mine] = own + span.start, step - starts[own]
        x, S, nd = motion.x[w, k], motion.S[w, k], motion.nu_dot[w, k]
        delta = (when - windows.t_s[w, k])[:, None]
        c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
        R = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)
        dR = np.stack([np.stack([-s, -c], 1), np.stack([c, -s], 1)], 1)
        r = x[:, 5:6]
        turn = np.array([[0.0, -1.0], [1.0, 0.0]])
        body = x[:, 3:5] + r * (turn @ arm)  # the tag's velocity, body axes
        gain = nd[:, :2] + nd[:, 2:] * (turn @ arm) + r * (body @ turn.T)
        shift = arm + delta * body + delta**2 / 2 * gain  # the tag from the step's position, body axes
        moved = lambda vector: np.einsum("mij,mj->mi", R, vector)  # noqa: E731
        error = x[:, :2] + moved(shift) - fixes.place_m
        C = np.zeros((len(when), 2, 6))
        C[:, 0, 0] = C[:, 1, 1] = 1.0
        C[:, :, 2] = np.einsum("mij,mj->mi", dR, shift)
        C[:, :, 3:5] = delta[..., None] * R
        C[:, :, 5] = delta * (R @ (turn @ arm))
        rows = np.zeros((len(when), 2, L + len(self.parameters.names)))
        rows[:, :, _dynamic_columns(S.shape[2])] = C @ S
        rows[:, :, L + at] = -moved(body + delta * gain)
        rows[:, :, L + at + 1 :] = R + (delta * r)[..., None] * (R @ turn)
        return rows / noise.fix_m, error / noise.fix_m, w

    def _ties(self, motion: _Motion, z: np.ndarray, noise: Noise) -> Ties:
        at = np.flatnonzero(~np.append(self.windows.first[1:], True))
        span = self.windows.t_s[at, -1] - self.windows.t_s[at, 0]
        decay, _ = noise.tie(span)
        F, P = np.zeros((len(at), L, L)), len(self.parameters.names)
        G = np.zeros((len(at), L, P))
        diagonal = np.arange(L)
        F[:, diagonal, diagonal] = decay
        S = motion.S[at, -1]
        F[:, STATE, :9] = S[..., :9]
        G[:, STATE, : S.shape[2] - 9] = S[..., 9:]
        reached = decay * z[at]
        reached[:, STATE] = motion.x[at, -1]
        return Ties(z[at + 1] - reached, F, G, at, span)


def _dynamic_columns(n_dyn: int) -> np.ndarray:
    """Columns that move the trajectory: x0 and d of the node, then q up to the lag."""
    return np.concatenate([np.arange(9), L + np.arange(n_dyn - 9)])


def _sensitivities(A: np.ndarray, G: np.ndarray, h: np.ndarray) -> np.ndarray:
    """dx/d[x0, inputs] at all nodes of all windows, shape (W, K + 1, 6, 6 + inputs)."""
    W, K = h.shape
    half = (h / 2)[..., None, None]
    A0, A1, G0, G1 = A[:, :-1], A[:, 1:], G[:, :-1], G[:, 1:]
    step = np.empty((W, K, 6, 6 + G.shape[3]))
    step[..., :6] = np.eye(6) + half * (A0 + A1 + 2 * half * (A1 @ A0))
    step[..., 6:] = 2 * half**2 * (A1[..., 3:] @ G0)
    step[..., 3:, 6:] += half * (G0 + G1)
    S = np.zeros((W, K + 1, 6, 6 + G.shape[3]))
    S[:, 0, :, :6] = np.eye(6)
    for k in range(K):
        S[:, k + 1] = step[:, k, :, :6] @ S[:, k]
        S[:, k + 1, :, 6:] += step[:, k, :, 6:]
    return S


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
