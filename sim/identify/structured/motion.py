"""Trajectories of all windows from nodes and parameters, and how they change with both.

Within a window the boat moves by the model alone, from its node z_w under the commands plus a latent acceleration.
Sensitivities S = dx/d[node; q] follow the trajectory,

    S_{k+1} = Phi_k S_k + Gamma_k,   Phi = I + h/2 (A_k + A_{k+1}) + h^2/2 A_{k+1} A_k,   Gamma alike,

with the exact Jacobians A of the model at each step (its error, below 1e-4, slows convergence, it moves no estimate).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.thrusters import configuration_matrix
from sim.identify.structured.data import Windows
from sim.identify.structured.model import N_HULL, Compiled
from sim.identify.structured.noise import LATENT, STATE, L
from sim.identify.structured.parameters import Parameters
from sim.identify.structured.thrust import ThrustHistory

X0_D = 9  # columns of S before the parameters: x0 (6) and latent acceleration (3) of the node


@dataclass(frozen=True)
class Motion:
    """All windows: x (W, K+1, 6), nu_dot (.., 3), A = d(x_dot)/dx (.., 6, 6), G = d(nu_dot)/d[d; q] (.., 3, inputs).

    Inputs are the latent acceleration, then the parameters that move the boat: all up to the lag. `late` (W, K, 3):
    what a second of dead time adds to nu over a step, exactly: at the steps alone d(nu_dot) would not tell, it jumps
    with the commands.
    """

    x: np.ndarray
    nu_dot: np.ndarray
    A: np.ndarray
    G: np.ndarray
    late: np.ndarray

    def part(self, windows: slice) -> Motion:
        """Some of the windows."""
        return Motion(self.x[windows], self.nu_dot[windows], self.A[windows], self.G[windows], self.late[windows])


@dataclass(frozen=True)
class Mover:
    """Integrates the windows of one problem."""

    windows: Windows
    parameters: Parameters
    compiled: Compiled

    def __call__(self, q: np.ndarray, z: np.ndarray) -> Motion:
        """Trajectories at parameters q (P,) and nodes z (W, L)."""
        W, K = self.windows.size
        B = configuration_matrix(self.parameters.vessel)
        share = (B * q[self.parameters.thrusters]).T
        f, f_mid, f_dead, f_lag = self._thrust(q)
        tau, tau_mid, d = f @ share, f_mid @ share, z[:, LATENT]
        taus = np.concatenate([tau[:, :-1], tau_mid, tau[:, 1:]], axis=2).reshape(W, -1)
        p = q[:N_HULL]
        x = np.empty((W, K + 1, 6))
        x[:, 0] = z[:, STATE]
        (after,) = self.compiled.rollout(z[:, STATE], np.tile(p, (W, K)), taus, np.tile(d, (1, K)), self.windows.h_s)
        x[:, 1:] = after.reshape(W, K, 6)
        nodes = W * (K + 1)
        d_all = np.repeat(d, K + 1, axis=0)
        A, G, nu_dot = self.compiled.rates(x.reshape(-1, 6), np.tile(p, (nodes, 1)), tau.reshape(-1, 3), d_all)
        G = G.reshape(W, K + 1, N_HULL + 3, 3).swapaxes(2, 3)
        G_tau = G[..., N_HULL:]
        inputs = [np.broadcast_to(np.eye(3), G_tau.shape), G[..., :N_HULL], (G_tau @ B) * f[:, :, None, :]]
        inputs += [G_tau @ (f_dead @ share)[..., None], G_tau @ (f_lag @ share)[..., None]]
        A = A.reshape(W, K + 1, 6, 6).swapaxes(2, 3)
        late = (G_tau[:, :-1] @ (tau[:, :-1] - tau[:, 1:])[..., None])[..., 0]
        return Motion(x, nu_dot.reshape(W, K + 1, 3).copy(), A, np.concatenate(inputs, axis=3), late)

    def _thrust(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Unit-gain forces at nodes (W, K+1, n), at the middles (W, K, n), and d/d dead time, d/d lag at nodes."""
        at = self.parameters.thrusters.stop
        middle = self.windows.t_s[:, :-1] + self.windows.h_s / 2
        f, f_mid, f_dead, f_lag = [], [], [], []
        for span, commands in zip(self.windows.spans, self.windows.commands, strict=True):
            history = ThrustHistory(commands, float(q[at]), float(q[at + 1]))
            for store, value in zip((f, f_dead, f_lag), history.at(self.windows.t_s[span]), strict=True):
                store.append(value)
            f_mid.append(history.at(middle[span])[0])
        return np.concatenate(f), np.concatenate(f_mid), np.concatenate(f_dead), np.concatenate(f_lag)


def spread(target: np.ndarray, S: np.ndarray) -> None:
    """Put the columns of S where they stand among node (L), then q."""
    target[..., :X0_D] = S[..., :X0_D]
    target[..., L : L + S.shape[-1] - X0_D] = S[..., X0_D:]


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
    dead = 6 + G.shape[3] - 2
    step[..., dead] = half[..., 0] * (A1[..., 3:] @ motion.late[..., None])[..., 0]
    step[..., 3:, dead] += motion.late
    S = np.zeros((W, K + 1, 6, 6 + G.shape[3]))
    S[:, 0, :, :6] = np.eye(6)
    for k in range(K):
        S[:, k + 1] = step[:, k, :, :6] @ S[:, k]
        S[:, k + 1, :, 6:] += step[:, k, :, 6:]
    return S
