"""Trajectories of all windows from nodes and parameters, and how they change with both.

Within a window the boat moves by the model alone, from its node z_w under the commands plus a latent acceleration.
Sensitivities S = dx/d[node; q] follow the trajectory,

    S_{k+1} = Phi_k S_k + Gamma_k,   Phi = I + h/2 (A_k + A_{k+1}) + h^2/2 A_{k+1} A_k,   Gamma alike,

with the exact Jacobians A of the model at each step (its error, below 1e-4, slows convergence, it moves no estimate).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.identify.structured.data import Windows
from sim.identify.structured.model import N_HULL, Compiled
from sim.identify.structured.noise import LATENT, STATE, L
from sim.identify.structured.parameters import Parameters, adjustable
from sim.identify.structured.thrust import ThrustHistory

X0_D = 9  # columns of S before the parameters: x0 (6) and latent acceleration (3) of the node


@dataclass(frozen=True)
class Motion:
    """All windows: x (W, K+1, 6), nu_dot (.., 3), A = d(x_dot)/dx (.., 6, 6), G = d(nu_dot)/d[d; q] (.., 3, inputs).

    Inputs are the latent acceleration, then the parameters that move the boat: all up to the lag, then trims, azimuths,
    curves and terms. `late` (W, K, 3): what a second of dead time (input `dead`) adds to nu over a step, exactly: at
    the steps alone d(nu_dot) would not tell, it jumps with the commands.
    """

    x: np.ndarray
    nu_dot: np.ndarray
    A: np.ndarray
    G: np.ndarray
    late: np.ndarray
    dead: int

    def part(self, windows: slice) -> Motion:
        """Some of the windows."""
        return Motion(
            self.x[windows], self.nu_dot[windows], self.A[windows], self.G[windows], self.late[windows], self.dead
        )


@dataclass(frozen=True)
class Mover:
    """Integrates the windows of one problem."""

    windows: Windows
    parameters: Parameters
    compiled: Compiled

    def __call__(self, q: np.ndarray, z: np.ndarray) -> Motion:
        """Trajectories at parameters q (P,) and nodes z (W, L)."""
        W, K = self.windows.size
        parameters = self.parameters
        B, B_turn = self._configuration(q)
        gain = q[parameters.thrusters]
        share, n = (B * gain).T, len(gain)
        f, f_mid, f_dead, f_lag = self._thrust(q)
        f, adjust, f_dead, f_lag = f[..., :n], f[..., n:], f_dead[..., :n], f_lag[..., :n]
        tau, tau_mid, d = f @ share, f_mid[..., :n] @ share, z[:, LATENT]
        taus = np.concatenate([tau[:, :-1], tau_mid, tau[:, 1:]], axis=2)
        p = np.append(q[:N_HULL], q[parameters.terms])
        x = np.empty((W, K + 1, 6))
        x[:, 0] = z[:, STATE]
        constants = np.hstack([np.tile(p, (W, 1)), d])
        x[:, 1:] = self.compiled.rollout(z[:, STATE], constants, taus, self.windows.h_s[:, :, None])
        nodes = W * (K + 1)
        d_all = np.repeat(d, K + 1, axis=0)
        A, G, nu_dot = self.compiled.rates(x.reshape(-1, 6), np.tile(p, (nodes, 1)), tau.reshape(-1, 3), d_all)
        G = G.reshape(W, K + 1, len(p) + 3, 3).swapaxes(2, 3)
        G_tau = G[..., len(p) :]
        inputs = [np.broadcast_to(np.eye(3), G_tau.shape), G[..., :N_HULL], (G_tau @ B) * f[:, :, None, :]]
        inputs += [G_tau @ (f_dead @ share)[..., None], G_tau @ (f_lag @ share)[..., None]]
        able = list(adjustable(parameters.vessel))
        if able:
            G_able = G_tau @ share.T[:, able]
            inputs += [G_able * adjust[:, :, None, : len(able)]]
            inputs += [(G_tau @ (B_turn * gain)[:, able]) * f[:, :, None, able]]
            inputs += [(G_able * adjust[:, :, None, len(able) :]) @ parameters.curve_of]
        inputs += [G[..., N_HULL : len(p)]]
        A = A.reshape(W, K + 1, 6, 6).swapaxes(2, 3)
        late = (G_tau[:, :-1] @ (tau[:, :-1] - tau[:, 1:])[..., None])[..., 0]
        G = np.concatenate(inputs, axis=3)
        return Motion(x, nu_dot.reshape(W, K + 1, 3).copy(), A, G, late, 3 + parameters.thrusters.stop)

    def _configuration(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """B (3, n) and what a degree of azimuth adds to each column."""
        x, y, a = self.parameters.vessel.positions.T
        able = list(adjustable(self.parameters.vessel))
        a[able] = np.deg2rad(q[self.parameters.azimuths])
        c, s = np.cos(a), np.sin(a)
        return np.vstack([c, s, x * s - y * c]), np.deg2rad(np.vstack([-s, c, x * c + y * s]))

    def _thrust(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Unit-gain forces at nodes (W, K+1, n + 2 a), at the middles (W, K, ..), d/d dead time and d/d lag at nodes.

        The 2 a columns beyond the thrusters': d/d trim and d/d curve of the adjustable ones.
        """
        at = self.parameters.thrusters.stop
        middle = self.windows.t_s[:, :-1] + self.windows.h_s / 2
        pitch = q[self.parameters.trims], np.zeros(0)
        if self.parameters.extras:
            pitch = pitch[0], self.parameters.curve_of @ q[self.parameters.curves]
        f, f_mid, f_dead, f_lag = [], [], [], []
        for span, commands in zip(self.windows.spans, self.windows.commands, strict=True):
            history = ThrustHistory(commands.at_pitch(*pitch), float(q[at]), float(q[at + 1]))
            for store, value in zip((f, f_dead, f_lag), history.at(self.windows.t_s[span]), strict=True):
                store.append(value)
            f_mid.append(history.at(middle[span])[0])
        return np.concatenate(f), np.concatenate(f_mid), np.concatenate(f_dead), np.concatenate(f_lag)


def spread(target: np.ndarray, S: np.ndarray, extras: int) -> None:
    """Put the columns of S where they stand among node (L), then q; the last `extras` at the end."""
    base = S.shape[-1] - extras
    target[..., :X0_D] = S[..., :X0_D]
    target[..., L : L + base - X0_D] = S[..., X0_D:base]
    target[..., target.shape[-1] - extras :] = S[..., base:]


def sensitivities(motion: Motion, h: np.ndarray) -> np.ndarray:
    """dx/d[x0, inputs] at all nodes of all windows, shape (W, K + 1, 6, 6 + inputs)."""
    A, G = motion.A, motion.G
    W, K = h.shape
    half = (h / 2)[..., None, None]
    A0, A1, G0, G1 = A[:, :-1], A[:, 1:], G[:, :-1], G[:, 1:]
    step = np.empty((W, K, 6, 6 + G.shape[3]))
    step[..., :6] = np.eye(6) + half * (A0 + A1 + 2 * half * (A1 @ A0))
    step[..., 6:] = 2 * half**2 * (A1[..., 3:] @ G0)
    step[..., 3:, 6:] += half * (G0 + G1)
    dead = 6 + motion.dead
    step[..., dead] = half[..., 0] * (A1[..., 3:] @ motion.late[..., None])[..., 0]
    step[..., 3:, dead] += motion.late
    S = np.zeros((W, K + 1, 6, 6 + G.shape[3]))
    S[:, 0, :, :6] = np.eye(6)
    for k in range(K):
        S[:, k + 1] = step[:, k, :, :6] @ S[:, k]
        S[:, k + 1, :, 6:] += step[:, k, :, 6:]
    return S
