"""The problem of the structured fit for scipy's least_squares: residuals and Jacobian by CasADi (`casadi_model`).

Unknowns: [w; nodes]. Residuals: all sensors, ties, starts of runs and priors, so that half their sum of squares is the
cost of `StructuredFit.assemble`. The noise is fixed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import csr_array, vstack

from sim.fitting.engine.initial_guess import initial_nodes
from sim.fitting.engine.noise import STATE, L, Noise, whiten
from sim.fitting.engine.parameters import Parameters
from sim.fitting.engine.thrust.history import ThrustHistory
from sim.fitting.engine.windows import PSI, Windows
from sim.studies.peers.casadi_model import chained

DIFFERENCE_S = 1e-6
"""Of dead time and lag, for the slopes of forces in the middle of steps: they have no formula."""


class Called:
    """A mapped CasADi function on its buffers: arrays (count, size) in and out, without conversions."""

    def __init__(self, function: ca.Function):
        self._function = function
        self._in = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        self._out = [np.zeros(function.size_out(i)[::-1]) for i in range(function.n_out())]
        made: Any = function.buffer()
        self._buffer, self._run = made
        for i, array in enumerate(self._in):
            self._buffer.set_arg(i, array.data)
        for i, array in enumerate(self._out):
            self._buffer.set_res(i, array.data)

    def __call__(self, *args: np.ndarray) -> list[np.ndarray]:
        """Outputs; they are overwritten by the next call."""
        for target, value in zip(self._in, args, strict=True):
            target[...] = value.reshape(target.shape)
        self._run()
        return self._out


class CasadiProblem:
    """Residuals (m,) and Jacobian (m, P + W L) at [w; nodes]."""

    def __init__(self, windows: Windows, parameters: Parameters, noise: Noise):
        self.windows, self.parameters, self.noise = windows, parameters, noise
        functions = chained(windows, parameters, noise)
        self._active, self._cells = functions.active, functions.cells
        self._path, self._whole = Called(functions.path), Called(functions.whole)
        self._fix, self._fix_whole = Called(functions.fix), Called(functions.fix_whole)
        self._z0 = initial_nodes(windows, parameters)
        self._first = np.flatnonzero(windows.first)
        self._tied, self._span_s = windows.tied()
        self._decay = self._sigma = np.empty(0)
        self.slacken(noise.slack)
        self._known = np.isfinite(windows.y)
        t = windows.t_s[:, :-1]
        slow = np.stack([windows.h_s, np.exp(-(t - t[:, :1]) / noise.wander_time_s)], axis=2)
        self._told = np.concatenate([slow, np.nan_to_num(windows.y)], axis=2)

    def slacken(self, slack: float) -> None:
        """Multiply the ties' sigmas of states by `slack` from now on."""
        self._decay, self._sigma = replace(self.noise, slack=slack).tie(self._span_s)

    @property
    def start(self) -> np.ndarray:
        """Priors' centres and the first guess of the nodes, as of `StructuredFit.begin`."""
        return np.concatenate([self.parameters.prior[0], self._z0.ravel()])

    @property
    def size(self) -> int:
        """Number of residuals."""
        own = int(self._known.sum()) + self.windows.fixes.place_m.size + self._sigma.size
        return own + len(self._first) * L + len(self.parameters.names)

    def split(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """w (P,) and nodes (W, L)."""
        P = len(self.parameters.names)
        return at[:P], at[P:].reshape(-1, L)

    def residual(self, at: np.ndarray) -> np.ndarray:
        """Predicted minus measured, or minus the prior mean, over sigma, (m,)."""
        w, z = self.split(at)
        inputs, fixes = self._given(w, z)
        W, K = self.windows.size
        x, e = self._path(*inputs)
        x = np.concatenate([z[:, None, STATE], x.reshape(W, K, 6)], axis=1)
        e = self._innovations(e.reshape(W, K, 4, 1))[..., 0]
        (place,) = self._fix(x[fixes[0], fixes[1]], *fixes[2:])
        reached = self._decay * z[self._tied]
        reached[:, STATE] = x[self._tied, -1]
        off = z[self._first]
        off[:, STATE] -= self._z0[self._first, STATE]
        mean, spread = self.parameters.prior
        beliefs = ((z[self._tied + 1] - reached) / self._sigma, off / self.noise.node_start(), (w - mean) / spread)
        return np.concatenate([e[self._known], place.ravel(), *(b.ravel() for b in beliefs)])

    def jacobian(self, at: np.ndarray) -> csr_array:
        """Exact derivative of `residual`."""
        w, z = self.split(at)
        inputs, (window, step, *fixes) = self._given(w, z)
        (W, K), A, C = self.windows.size, len(self._active), L + len(w)
        x, S, _, cells = self._whole(*inputs)
        x = np.concatenate([z[:, None, STATE], x.reshape(W, K, 6)], axis=1)
        S0 = np.broadcast_to(np.eye(6, A).ravel("F"), (W, 1, 6 * A))
        S = np.concatenate([S0, S.reshape(W, K, 6 * A)], axis=1)
        rows = np.zeros((W, K, 4, C))
        rows[:, :, *self._cells] = cells.reshape(W, K, -1)
        rows = self._innovations(rows)[self._known]
        keep = np.zeros((4, C), dtype=bool)
        keep[self._cells] = True
        keep = np.broadcast_to(keep, (W, K, 4, C))[self._known]
        by_fix = self._fix_whole(x[window, step], S[window, step], *fixes)[1].reshape(-1, C, 2).swapaxes(1, 2)
        T = self.parameters.jacobian(w)
        imu = self._sparse(rows, np.nonzero(self._known)[0], T, keep)
        places = self._sparse(by_fix.reshape(-1, C), np.repeat(window, 2), T)
        return csr_array(vstack([imu, places, self._ties(S[self._tied, -1], T), *self._beliefs()], format="csr"))

    def _ties(self, S: np.ndarray, T: np.ndarray) -> csr_array:
        """Derivative of the ties; S (T, 6 A) at the windows' ends."""
        count, C = len(self._tied), L + len(T)
        rows = np.zeros((count, L, C))
        rows[:, np.arange(L), np.arange(L)] = -self._decay
        rows[:, STATE] = 0.0
        rows[:, STATE, self._active] = -S.reshape(count, -1, 6).swapaxes(1, 2)
        rows /= self._sigma[:, :, None]
        P, size = len(T), self.windows.size[0] * L
        after = P + ((self._tied + 1)[:, None] * L + np.arange(L)).ravel()
        own = csr_array((1 / self._sigma.ravel(), after, np.arange(count * L + 1)), shape=(count * L, P + size))
        return own + self._sparse(rows.reshape(-1, C), np.repeat(self._tied, L), T)

    def _beliefs(self) -> tuple[csr_array, csr_array]:
        """Derivatives of the starts of runs, and of the priors."""
        P, size = len(self.parameters.names), self.windows.size[0] * L
        at = P + (self._first[:, None] * L + np.arange(L)).ravel()
        each = np.tile(1 / self.noise.node_start(), len(self._first))
        begin = csr_array((each, at, np.arange(len(at) + 1)), shape=(len(at), P + size))
        prior = csr_array((1 / self.parameters.prior[1], np.arange(P), np.arange(P + 1)), shape=(P, P + size))
        return begin, prior

    def _sparse(self, rows: np.ndarray, window: np.ndarray, T: np.ndarray, keep: np.ndarray | None = None) -> csr_array:
        """Rows (R, C) by [node of their window; q] as sparse rows by [w; nodes]. `keep`: mask of possible nonzeros."""
        P, W = len(T), self.windows.size[0]
        rows[:, L:] = rows[:, L:] @ T
        kept = rows != 0 if keep is None else keep
        columns = np.empty((W, L + P), dtype=np.int32)
        columns[:, :L] = P + np.arange(W * L).reshape(W, L)
        columns[:, L:] = np.arange(P)
        ends = np.concatenate([[0], np.cumsum(kept.sum(axis=1))])
        return csr_array((rows[kept], columns[window][kept], ends), shape=(len(rows), P + W * L))

    def _innovations(self, rows: np.ndarray) -> np.ndarray:
        """Heading errors (W, K, 4, .) over their sigma as innovations: white noise plus wander."""
        known, white = self._known[..., PSI], self.noise.white[PSI]
        rows[:, :, PSI] = whiten(rows[:, :, PSI] * white, known, self.windows.h_s, self.noise)
        return rows

    def _given(self, w: np.ndarray, z: np.ndarray) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """Inputs of the windows; window and step of each position, and its further inputs."""
        windows, at, q = self.windows, self.parameters.thrusters.stop, self.parameters.file_units(w)
        forces = self._forces(float(q[at]), float(q[at + 1]))
        v = np.hstack([z, np.tile(q, (len(z), 1))])
        v[:, L + at : L + at + 2] = 0.0
        window, step = windows.before(windows.fixes.t_s - q[at + 2])
        since = windows.fixes.t_s - windows.t_s[window, step]
        known = np.hstack([since[:, None], windows.fixes.place_m])
        start = forces[window, step, : forces.shape[2] // 3]
        return (z[:, STATE], v, forces, self._told), (window, step, v[window], start, known)

    def _forces(self, dead_time_s: float, lag_s: float) -> np.ndarray:
        """At start, middle and end of each step: forces at a gain of one, by dead time and by lag, (W, K, 9 n)."""
        windows = self.windows
        pieces = []
        for span, commands, around_s in zip(windows.spans, windows.commands, windows.around_s, strict=True):
            t_s, slopes = windows.t_s[span], []
            for more_dead_s, more_lag_s in ((0.0, 0.0), (DIFFERENCE_S, 0.0), (0.0, DIFFERENCE_S)):
                history = ThrustHistory(commands, dead_time_s + more_dead_s, lag_s + more_lag_s)
                slopes.append(history.middle(history.mean(t_s, around_s), t_s, around_s))
            half = [slopes[0], *((more - slopes[0]) / DIFFERENCE_S for more in slopes[1:])]
            at = np.concatenate(ThrustHistory(commands, dead_time_s, lag_s).at(t_s, around_s), axis=2)
            pieces.append(np.concatenate([at[:, :-1], *half, at[:, 1:]], axis=2))
        return np.concatenate(pieces)
