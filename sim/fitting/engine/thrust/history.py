"""Thruster forces over time, exactly, with their derivatives to dead time and lag; and to trims, lagged like them.

    f_dot = (F(pwm(t - t_d), V) - f) / T_lag        one unit of gain per thruster

F holds between changes, so that f is a chain of exponentials; it knows nothing of the hull's motion. From it

    df/dt_d = -f_dot,        df/dT_lag: the same chain, driven by -(F - f) / T_lag^2
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import get_lapack_funcs

from companion.core.model.thrust_lag import first_order_lag, slew_limited_lag
from companion.core.model.thrusters import SPAN_US
from sim.fitting.engine.kernels.thrust import impulses, lagged, lagged_slopes, slewed

(_tbtrs,) = get_lapack_funcs(("tbtrs",), dtype=np.float64)


@dataclass(frozen=True)
class ThrustCommands:
    """Steady forces [N] at a gain of one, shape (c, n), in force from `t_s`, shape (c,), until the next.

    `pitch`: what the forces of adjustable thrusters follow from, at any trim.
    """

    t_s: np.ndarray
    force_n: np.ndarray
    pitch: Pitch | None = None

    def at_pitch(self, trim_us: np.ndarray, curve: np.ndarray) -> ThrustCommands:
        """Forces at these trims [us] and curves, each (a,); and, as 2 a columns more, what a microsecond of trim and a

        unit of curve add to each.
        """
        if self.pitch is None:
            return self
        force, by_trim, by_curve = self.pitch.at(trim_us, curve)
        everything = self.force_n.copy()
        everything[:, list(self.pitch.which)] = force
        return ThrustCommands(self.t_s, np.hstack([everything, by_trim, by_curve]))

    def with_astern(self, share: np.ndarray, known: np.ndarray) -> ThrustCommands:
        """Forces astern by `share` (n,) instead of the `known` shares (n,) that they have been made with; and, as n
        columns more, what a unit of share adds to each thruster's.
        """
        n = len(share)
        by_share = np.minimum(self.force_n[:, :n], 0.0) / known
        force = np.maximum(self.force_n[:, :n], 0.0) + by_share * share
        return ThrustCommands(self.t_s, np.hstack([force, self.force_n[:, n:], by_share]))


@dataclass(frozen=True)
class Pitch:
    """Adjustable thrusters `which` (a,): pulse widths from 1500 us, and forces at full pitch [N] ahead and astern as

    things were set at the time, (c, a) each.
    """

    which: tuple[int, ...]
    pulse_us: np.ndarray
    ahead: np.ndarray
    astern: np.ndarray

    def at(self, trim_us: np.ndarray, curve: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Force [N], its derivatives to the trim [N/us] and to the curve [N], each (c, a).

        The pitch map of `companion.core.model.thrusters`, with trim and curve that vary; a test compares the two.
        """
        beyond = (self.pulse_us - trim_us) / SPAN_US
        c = np.clip(beyond, -1.0, 1.0)
        full = np.where(c >= 0, self.ahead, self.astern)
        size, inside = np.abs(c), np.abs(beyond) < 1.0
        slope = full * (1 - curve + 2 * curve * size) / SPAN_US
        return full * c * (1 - curve + curve * size), -slope * inside, full * c * (size - 1)


class ThrustHistory:
    """Forces of one run at a dead time and lag. The first command is taken to have held for ever before."""

    def __init__(self, commands: ThrustCommands, dead_time_s: float, lag_s: float):
        self._t, self._F, self._lag = commands.t_s + dead_time_s, commands.force_n, lag_s
        self._dt = np.diff(self._t)[:, None]
        self._keep = np.exp(-self._dt / lag_s)
        f = _recursion(self._keep, (1 - self._keep) * self._F[:-1], self._F[0])
        self._f = f  # at each change, before it acts
        self._gap = f - self._F

    @cached_property
    def _s(self) -> np.ndarray:
        """df/dT_lag at each change."""
        fresh = self._gap[:-1] * self._keep * self._dt / self._lag**2
        return _recursion(self._keep, fresh, np.zeros_like(self._F[0]))

    @cached_property
    def _impulse(self) -> np.ndarray:
        """Integral of f from the first change to each, (c, n) [N s]."""
        over = self._F[:-1] * self._dt + self._gap[:-1] * self._lag * (1 - self._keep)
        return np.vstack([np.zeros_like(self._F[:1]), np.cumsum(over, axis=0)])

    def force(self, t_s: np.ndarray) -> np.ndarray:
        """f at `t_s` of any shape, (*shape, n)."""
        j, since = _place(self._t, t_s)
        return first_order_lag(self._f.take(j, axis=0), self._F.take(j, axis=0), since, self._lag)

    def mean(self, t_s: np.ndarray, around_s: np.ndarray | None = None) -> np.ndarray:
        """f at `t_s` of any shape, or its mean over instants `around_s` (*shape, m) from there: (*shape, n)."""
        out = np.empty((t_s.size, self._F.shape[1]))
        lagged(self._t, self._F, self._gap, self._lag, *_instants(t_s, around_s), out)
        return out.reshape(*t_s.shape, -1)

    def middle(self, f: np.ndarray, t_s: np.ndarray, around_s: np.ndarray) -> np.ndarray:
        """f in the middle of the steps between the instants `t_s` (w, K + 1), with which a step's impulse is exact.

            f_mid = (6 (J_end - J_start) / h - f_start - f_end) / 4        Simpson's rule, as in Runge-Kutta, solved

        (w, K, n) from `f` (w, K + 1, n) at the instants; J: integral of f, averaged over instants `around_s` like f is.
        """
        J = np.empty((t_s.size, self._F.shape[1]))
        impulses(self._t, self._F, self._gap, self._impulse, self._lag, *_instants(t_s, around_s), J)
        h = np.diff(t_s)[..., None]
        mean = np.divide(np.diff(J.reshape(f.shape), axis=1), h, out=f[:, :-1].copy(), where=h > 0)
        return (6 * mean - f[:, :-1] - f[:, 1:]) / 4

    def at(self, t_s: np.ndarray, around_s: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`mean`, and what a second of dead time and of lag adds to it: each (*shape, n)."""
        by_dead, by_lag = (np.empty((t_s.size, self._F.shape[1])) for _ in range(2))
        lagged_slopes(self._t, self._gap, self._s, self._lag, *_instants(t_s, around_s), by_dead, by_lag)
        f = self.mean(t_s, around_s)
        return f, by_dead.reshape(f.shape), by_lag.reshape(f.shape)


class SlewedHistory:
    """Forces of one run that change no faster than `slew_n_s` [N/s]: f_dot = clip((F - f) / T_lag, -slew, slew)."""

    def __init__(self, commands: ThrustCommands, dead_time_s: float, lag_s: float, slew_n_s: float):
        self._t, self._F = commands.t_s + dead_time_s, commands.force_n
        self._lag, self._slew = lag_s, slew_n_s
        self._f = np.empty_like(self._F)
        slewed(np.diff(self._t), self._F, lag_s, slew_n_s, self._f)

    def force(self, t_s: np.ndarray) -> np.ndarray:
        """f at `t_s` of any shape, (*shape, n)."""
        j, since = _place(self._t, t_s)
        return slew_limited_lag(self._f.take(j, axis=0), self._F.take(j, axis=0), since, self._lag, self._slew)


def _instants(t_s: np.ndarray, around_s: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """In one row (size,), with what is around each (size, m)."""
    around = np.zeros((t_s.size, 1)) if around_s is None else np.ascontiguousarray(around_s)
    return t_s.ravel(), around.reshape(t_s.size, -1)


def _place(changes_s: np.ndarray, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which change was the last at `t_s` (the first, before it), and the time since, (*shape, 1)."""
    j = np.maximum(np.searchsorted(changes_s, t_s, side="right") - 1, 0)
    return j, np.maximum(t_s - changes_s[j], 0.0)[..., None]


def _recursion(keep: np.ndarray, added: np.ndarray, first: np.ndarray) -> np.ndarray:
    """y_{j+1} = keep_j y_j + added_j from y_0 = first; shapes (c - 1, 1), (c - 1, n), (n,) -> (c, n)."""
    bands = np.ones((2, len(keep) + 1))
    bands[1, :-1] = -keep[:, 0]
    return _tbtrs(bands, np.vstack([first, added]), uplo="L", diag="U")[0]
