"""Trajectories of all windows from nodes and parameters, with what their sensitivities need.

Within a window the boat moves by the model alone, from the state of its node z_w, under the commanded forces and the
latent acceleration d_w of the node:

    x_dot = [R(psi) nu;  nu_dot(x, q, tau(t; q)) + d_w],    x(t_w) = z_w[STATE],    tau = B diag(gain) f(t; t_d, T_lag)

less what moving water takes of it (`model`).

The sensitivities S = dx/d[x0, d, q] follow the variational equation along the trajectory,

    S_dot = A S + [0; d(nu_dot)/dq],    A = d(x_dot)/dx                      (`jacobian_rows.sensitivities`)

so this module computes A and the partial derivatives d(nu_dot)/dq at every step. The error of the integrated S is below
1e-4: against exact derivatives (`sim.studies.peers`) all estimates end within 0.01 standard errors; dead time and lag,
whose force varies within a step, within 0.17.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.model.thrust_losses import has_thrust_losses
from sim.fitting.engine.jacobian_rows import AccelerationPartials
from sim.fitting.engine.kernels.windows import MIDDLE
from sim.fitting.engine.model import N_HULL, CompiledModel
from sim.fitting.engine.noise import LATENT, STATE
from sim.fitting.engine.parameters import Parameters
from sim.fitting.engine.thrust.fitted import adjustable, astern_maps
from sim.fitting.engine.thrust.history import ThrustCommands, ThrustHistory
from sim.fitting.engine.wind import wind_inputs
from sim.fitting.engine.windows import Windows


@dataclass(frozen=True)
class WindowMotion:
    """Trajectories of all windows, at the W x (K + 1) instants of `Windows.t_s`.

    x        (W, K+1, 6) states [m, m, rad, m/s, m/s, rad/s]
    nu_dot   (W, K+1, 3) accelerations in body axes, latent acceleration included
    A        (W, K+1, 6, 6) d(x_dot)/dx
    pushes   d(nu_dot)/dq for the parameters that move the boat (`Parameters.moving`): all up to the lag, then trims,
             azimuths, curves, shares astern and terms
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
        """Trajectories at parameters q (P,) in file units and nodes z (W, L)."""
        # 1. Forces of the thrusters, and the body force tau = B diag(gain) f at the start, middle and end of each step.
        W, K = self.windows.size
        parameters = self.parameters
        B, B_turn = self._configuration(q)
        gain = q[parameters.thrusters]
        n, lossy = len(gain), has_thrust_losses(parameters.vessel)
        f, f_mid, f_dead, f_lag = self._thrust(q)
        f, adjust, f_dead, f_lag = f[..., :n], f[..., n:], f_dead[..., :n], f_lag[..., :n]
        # what a unit of each force pushes with: tau, and the force itself where moving water weakens it
        share = np.hstack([(B * gain).T, np.diag(gain)]) if lossy else (B * gain).T
        push, push_mid, d = f @ share, f_mid[..., :n] @ share, z[:, LATENT]
        pushes = np.concatenate([push[:, :-1], push_mid, push[:, 1:]], axis=2)
        # 2. Trajectories.
        wind = wind_inputs(self.windows.wind_m_s, parameters.vessel, parameters.surroundings)
        p = np.hstack([np.tile(np.append(q[:N_HULL], q[parameters.terms]), (W, 1)), wind])
        x = np.empty((W, K + 1, 6))
        x[:, 0] = z[:, STATE]
        constants = np.hstack([p, d])
        x[:, 1:] = self.compiled.rollout(z[:, STATE], constants, pushes, self.windows.h_s[:, :, None])
        # 3. Jacobians of the model at all instants: A, d(nu_dot)/dp and d(nu_dot)/d(push) = [M^-1, that by the losses].
        p_all, d_all = (np.repeat(each, K + 1, axis=0) for each in (p, d))
        m, pushed, last = share.shape[1], p.shape[1], p.shape[1] - wind.shape[1]
        A, G, nu_dot = self.compiled.rates(x.reshape(-1, 6), p_all, push.reshape(-1, m), d_all)
        G = G.reshape(W, K + 1, pushed + m, 3).swapaxes(2, 3)
        # 4. d(nu_dot)/dq in the order of `Parameters.moving`: hull, gains, dead time, lag, trims, azimuths, curves,
        #    shares astern, terms. Thruster parameters act through the forces: d(nu_dot)/dq = unit gain df/dq.
        M_inv = G[0, 0, :, pushed : pushed + 3]
        unit = M_inv @ B + G[..., pushed + 3 :] if lossy else M_inv @ B
        each = unit * gain
        changes = [f[..., None, :] * unit, _turned(f_dead, each), _turned(f_lag, each)]
        able = list(adjustable(parameters.vessel))
        count = len(able)
        if able:
            changes += [adjust[..., None, :count] * each[..., able]]
            changes += [f[..., None, able] * (M_inv @ (B_turn * gain)[:, able])]
            changes += [(adjust[..., None, count : 2 * count] * each[..., able]) @ parameters.curve_of]
        if astern_maps(parameters.vessel):
            changes += [(adjust[..., None, 2 * count :] * each) @ parameters.astern_of]
        changes = [G[..., :N_HULL], *changes, G[..., N_HULL:last]]
        # 5. What a second of dead time adds to nu over each step: gain unit (f at its start - f at its end).
        late = _turned(f[:, :-1] - f[:, 1:], each[:, :-1] if lossy else each)[..., 0]
        A = A.reshape(W, K + 1, 6, 6).swapaxes(2, 3).copy()
        return WindowMotion(x, nu_dot.reshape(W, K + 1, 3).copy(), A, self._late(np.concatenate(changes, axis=3), late))

    def _late(self, nodes: np.ndarray, late: np.ndarray) -> AccelerationPartials:
        """The partial derivatives, with that to the dead time corrected between the steps.

        `nodes` (W, K+1, 3, P): d(nu_dot)/dq at the steps. `late` (W, K, 3): the exact integral of d(nu_dot)/dt_d over
        each step. That derivative jumps with every command, so the mean of its values at both ends misses the integral;
        the bump in the middle of the step makes up the difference.
        """
        dead = self.parameters.thrusters.stop
        ends = (nodes[:, :-1, :, dead] + nodes[:, 1:, :, dead]) / 2
        h_s = self.windows.h_s[..., None]
        mean = np.divide(late, h_s, out=np.zeros_like(late), where=h_s > 0)  # short windows end in steps of length 0
        bump = (mean - ends) / MIDDLE[0]
        return AccelerationPartials(nodes, bump[..., None], np.array([dead]))

    def _configuration(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """B (3, n), thrusters' azimuths as in q, and its derivative by each thruster's azimuth [1/deg], (3, n)."""
        x, y, a = self.parameters.vessel.positions.T
        able = list(adjustable(self.parameters.vessel))
        a[able] = np.deg2rad(q[self.parameters.azimuths])
        c, s = np.cos(a), np.sin(a)
        return np.vstack([c, s, x * s - y * c]), np.deg2rad(np.vstack([-s, c, x * c + y * s]))

    def _thrust(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Forces at a gain of one [N]: at the steps (W, K+1, n + 2 a), at their middles (W, K, n + 2 a); then the

        derivatives by dead time and by lag at the steps [N/s]. The 2 a columns behind the n thrusters are derivatives
        of the a adjustable ones by trim [N/us] and by curve [N]; n more follow where shares astern are estimated, by
        that share [N].
        """
        at = self.parameters.thrusters.stop
        f, f_mid, f_dead, f_lag = [], [], [], []
        windows = self.windows
        for span, commands, around_s in zip(windows.spans, windows.commands, windows.around_s, strict=True):
            history = ThrustHistory(self._commands(commands, q), float(q[at]), float(q[at + 1]))
            values = history.at(windows.t_s[span], around_s)
            f_mid.append(history.middle(values[0], windows.t_s[span], around_s))
            for store, value in zip((f, f_dead, f_lag), values, strict=True):
                store.append(value)
        return np.concatenate(f), np.concatenate(f_mid), np.concatenate(f_dead), np.concatenate(f_lag)

    def _commands(self, commands: ThrustCommands, q: np.ndarray) -> ThrustCommands:
        """Commands of one run at the trims, curves and shares astern of q."""
        parameters = self.parameters
        if adjustable(parameters.vessel):
            commands = commands.at_pitch(q[parameters.trims], parameters.curve_of @ q[parameters.curves])
        if astern_maps(parameters.vessel):
            chosen = parameters.astern_of
            share = chosen @ q[parameters.asterns] + 1.0 - chosen.sum(axis=1)
            commands = commands.with_astern(share, parameters.astern_stated)
        return commands


def _turned(values: np.ndarray, by: np.ndarray) -> np.ndarray:
    """`by` (3, n) times values (W, K, n) as columns (W, K, 3, 1): one matrix product for all; or by (W, K, 3, n)."""
    if by.ndim > 2:
        return by @ values[..., None]
    return (values.reshape(-1, by.shape[1]) @ by.T).reshape(*values.shape[:2], 3, 1)
