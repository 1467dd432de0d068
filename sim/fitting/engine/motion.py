"""Trajectories of all windows from nodes and parameters, and how they change with both.

Within a window the boat moves by the model alone, from its node z_w under the commands plus a latent acceleration.
Sensitivities (`rows.sensitivities`) follow the trajectory with the exact Jacobians A of the model at each step. Their
own error is below 1e-4: beside exact derivatives (`peer_casadi`) all estimates end within 0.01 standard errors; dead
time and lag, whose force is taken as it is within a step, within 0.17.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.fitting.engine.jacobian_rows import AccelerationPartials
from sim.fitting.engine.kernels.windows import MIDDLE
from sim.fitting.engine.model import N_HULL, CompiledModel
from sim.fitting.engine.noise import LATENT, STATE
from sim.fitting.engine.parameters import Parameters, adjustable
from sim.fitting.engine.thrust.history import ThrustHistory
from sim.fitting.engine.windows import Windows


@dataclass(frozen=True)
class WindowMotion:
    """All windows: x (W, K+1, 6), nu_dot (.., 3), A = d(x_dot)/dx (.., 6, 6), and what parameters change of nu_dot.

    Those that move the boat (`Parameters.moving`): all up to the lag, then trims, azimuths, curves and terms.
    """

    x: np.ndarray
    nu_dot: np.ndarray
    A: np.ndarray
    pushes: AccelerationPartials


@dataclass(frozen=True)
class WindowIntegrator:
    """Integrates the windows of one problem."""

    windows: Windows
    parameters: Parameters
    compiled: CompiledModel

    def __call__(self, q: np.ndarray, z: np.ndarray) -> WindowMotion:
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
        M_inv = G[0, 0, :, len(p) :]
        changes = [f[..., None, :] * (M_inv @ B), _turned(f_dead, share @ M_inv.T), _turned(f_lag, share @ M_inv.T)]
        able = list(adjustable(parameters.vessel))
        if able:
            each, count = M_inv @ share.T[:, able], len(able)
            changes += [adjust[..., None, :count] * each]
            changes += [f[..., None, able] * (M_inv @ (B_turn * gain)[:, able])]
            changes += [(adjust[..., None, count:] * each) @ parameters.curve_of]
        changes = [G[..., :N_HULL], *changes, G[..., N_HULL : len(p)]]
        late = _turned(tau[:, :-1] - tau[:, 1:], M_inv.T)[..., 0]
        A = A.reshape(W, K + 1, 6, 6).swapaxes(2, 3).copy()
        return WindowMotion(x, nu_dot.reshape(W, K + 1, 3).copy(), A, self._late(np.concatenate(changes, axis=3), late))

    def _late(self, nodes: np.ndarray, late: np.ndarray) -> AccelerationPartials:
        """`late` (W, K, 3): what a second of dead time adds to nu over a step, exactly.

        At the steps alone d(nu_dot) would not tell, it jumps with the commands.
        """
        dead = self.parameters.thrusters.stop
        ends = (nodes[:, :-1, :, dead] + nodes[:, 1:, :, dead]) / 2
        h_s = self.windows.h_s[..., None]
        mean = np.divide(late, h_s, out=np.zeros_like(late), where=h_s > 0)  # short windows end in steps of no length
        bump = (mean - ends) / MIDDLE[0]
        return AccelerationPartials(nodes, bump[..., None], np.array([dead]))

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
        pitch = q[self.parameters.trims], np.zeros(0)
        if self.parameters.extras:
            pitch = pitch[0], self.parameters.curve_of @ q[self.parameters.curves]
        f, f_mid, f_dead, f_lag = [], [], [], []
        windows = self.windows
        for span, commands, around_s in zip(windows.spans, windows.commands, windows.around_s, strict=True):
            history = ThrustHistory(commands.at_pitch(*pitch), float(q[at]), float(q[at + 1]))
            for store, value in zip((f, f_dead, f_lag), history.at(windows.t_s[span], around_s), strict=True):
                store.append(value)
            f_mid.append(history.mean(*windows.within(span, around_s.shape[2])))
        return np.concatenate(f), np.concatenate(f_mid), np.concatenate(f_dead), np.concatenate(f_lag)


def _turned(values: np.ndarray, by: np.ndarray) -> np.ndarray:
    """values (W, K, n) times `by` (n, 3), as one column (W, K, 3, 1): one product for all, not one a window."""
    return (values.reshape(-1, len(by)) @ by).reshape(*values.shape[:2], 3, 1)
