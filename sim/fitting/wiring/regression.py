"""How well the thrusters of a vessel file explain one log: speeds follow forces, without a model of the hull.

    psi(t + T) - psi(t - T) = integral of r              r = sum_i c_i L_i (N - k (M22 - M11) u v)
    p(t + T) - p(t - T)     = integral of R(psi) [u v]   u = sum_i a_i L_i (X + k M22 v r)
                                                         v = sum_i b_i L_i (Y - k M11 u r)

tau = B f: pulses through map, dead time and lag. L_i: first-order lags of 0.4 to 6 s with gains a, b, c not below zero:
a force pushes the boat where it points and water brakes it, whatever its inertia and damping. Each thruster may be up
to `UNEVEN` times as strong as another; Coriolis and Munk forces count k = 0 to `COUPLING` times, u, v, r in them as
measured. Constant speeds in earth and body axes (current, wind) and the lever arm of the positions are free. Gains have
a wide prior around one over the file's mass: else what hardly acts would be explained by any force, scaled up. Only
heading, positions and pulse widths are used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import nnls
from scipy.signal import lfilter

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import configuration_matrix
from companion.logs.runs.run import Run
from companion.logs.runs.unwrap import integrated, unwrapped
from sim.fitting.engine.thrust.battery import commands_of, pulses_of
from sim.fitting.engine.thrust.history import ThrustHistory
from sim.fitting.wiring.accelerations import interpolated, turned, unbroken

GRID_S = 0.1
STEP_S = 0.5  # between instants t
PLANE_S, YAW_S = 1.0, 0.5  # T: noise of speed and yaw rate below 0.1 m/s and 0.02 rad/s
LAGS_S = (0.4, 1.5, 6.0)  # of small boats: yaw below 2 s, surge and sway up to 10 s
MOST_S = 600.0  # of a log, where its commands change most often: more says nothing new
LEAST = 20  # instants of a log that can be judged
UNEVEN = 1.3  # largest ratio of two thrusters' gains, beside the file's own; assumed
GAIN_SIGMA = 0.6  # of the gains as shares of the file's; assumed
PER_SAMPLE = 4.0  # rows that count as one: neighbours say the same
NOISE_M, NOISE_RAD = 0.05, 0.01  # least error of a row
LEFT = 0.05  # share of the variance that the true wiring leaves unexplained
COUPLING = 1.5  # Coriolis and Munk terms up to so many times those of the file's masses; assumed
AHEAD, ASIDE = np.array([1.0, 0.0]), np.array([0.0, 1.0])
Column = Callable[[np.ndarray], np.ndarray]
"""A speed over the grid (g,) -> its column (m,)."""


@dataclass(frozen=True)
class Axis:
    """A speed on forces. `mass`: the file's, [kg] or [kg m^2]; `coupled` (g,): what inertia couples."""

    column: Column
    mass: float
    coupled: np.ndarray

    def columns(self, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns (m, c) of the thruster forces `force` (g, n) along this axis, and their initial response (c,).

        Response in units of one over mass.
        """
        mixes = _mixes(force.shape[1])
        found, share = [], []
        for lag_s, coupled in zip(LAGS_S, self.of_coupled, strict=True):
            mixed = np.column_stack([self.column(f) for f in lagged(force, lag_s).T]) @ mixes.T
            found += [mixed, mixed[:, :1] + coupled[:, None]]
            share += [*(mixes.mean(axis=1) / lag_s), 1.0 / lag_s]
        return np.column_stack(found) / self.mass, np.array(share)

    @cached_property
    def of_coupled(self) -> list[np.ndarray]:
        """Columns of what inertia couples, by lag."""
        return [self.column(COUPLING * lagged(self.coupled, lag_s)) for lag_s in LAGS_S]


def lagged(x: np.ndarray, lag_s: float) -> np.ndarray:
    """First-order lag of `x` (g, c) on the grid."""
    keep = np.exp(-GRID_S / lag_s)
    return np.asarray(lfilter([1 - keep], [1, -keep], x, axis=0))


@dataclass(frozen=True)
class Regression:
    """`y` (m,) on the forces of `axes`; `basis` (m, q), orthonormal, spans what is free."""

    y: np.ndarray
    basis: np.ndarray
    axes: tuple[Axis, ...]
    sigma2: float

    def residual(self, forces: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, float]:
        """Residuals (m,) with thruster forces `forces` (g, n) that act by the rows `B` (c, n) of these axes.

        And how far the gains are from those of the file, in sigmas squared.
        """
        found = [axis.columns(forces * row) for axis, row in zip(self.axes, B, strict=True)]
        X = without(self.basis, np.column_stack([columns for columns, _ in found]))
        prior = np.asarray(block_diag(*(share for _, share in found))) / GAIN_SIGMA
        own = np.full(len(prior), 1.0 / GAIN_SIGMA)
        weight = 1.0 / np.sqrt(self.sigma2 * PER_SAMPLE)
        full = np.vstack([weight * X, prior])
        scale = np.linalg.norm(full, axis=0) + 1e-9
        gains, _ = nnls(full / scale, np.append(weight * self.y, own))
        gains /= scale
        return self.y - X @ gains, float(((own - prior @ gains) ** 2).sum())


def without(basis: np.ndarray, X: np.ndarray) -> np.ndarray:
    """`X` (m,) or (m, c) without what the orthonormal `basis` (m, q) spans."""
    return X - basis @ (basis.T @ X)


def _mixes(n: int) -> np.ndarray:
    """Gains (s, n), the first all ones, whose positive sums have ratios up to `UNEVEN`; of many, one apart."""
    if n <= 4:
        return np.array([g for g in product((1.0, UNEVEN), repeat=n) if min(g) == 1.0])
    return np.array([np.ones(n), *(1.0 + (UNEVEN - 1.0) * np.eye(n))])


@dataclass(frozen=True)
class LogDesign:
    """Regressions of one log, plane (rows north, then east) and yaw, at the instants `at_s` (k,)."""

    run: Run
    grid_s: np.ndarray
    at_s: np.ndarray
    plane: Regression
    yaw: Regression

    def forces(self, vessel: VesselFile) -> np.ndarray:
        """Lagged forces of the thrusters of `vessel` under the log's pulses, (g, n) [N]."""
        p = vessel.propulsion
        history = ThrustHistory(commands_of(pulses_of(self.run, vessel), vessel), p.dead_time_s, p.lag_s)
        return history.force(self.grid_s) * np.array([t.gain for t in vessel.thrusters])

    def residuals(self, vessel: VesselFile) -> tuple[np.ndarray, np.ndarray, float]:
        """Squared residuals of the plane and of yaw at each instant, (k,) each, by the thrusters of `vessel`."""
        forces, B = self.forces(vessel), configuration_matrix(vessel)
        plane, far = self.plane.residual(forces, B[:2])
        yaw, also = self.yaw.residual(forces, B[2:])
        return (plane.reshape(2, -1) ** 2).sum(axis=0), yaw**2, far + also


def log_design(run: Run, vessel: VesselFile) -> LogDesign | None:
    """The regressions of a log; None where it holds too little."""
    # 1. Instants with heading and positions all around, and the motion on a grid.
    t_psi, psi = unwrapped(run)
    t_fix, fixes = run.samples("north_m", "east_m")
    t_pwm = pulses_of(run, vessel).t_s
    if min(len(t_psi), len(t_fix)) < LEAST or not len(t_pwm):
        return None
    t_fix = t_fix - vessel.sensors.position.latency_s
    span_s = max(PLANE_S, float(np.median(np.diff(t_fix))))
    begin, end = max(t_psi[0], t_fix[0], t_pwm[0]), min(t_psi[-1], t_fix[-1])
    if end - begin > MOST_S:
        begin = _liveliest(run.commands()[0], begin, end - MOST_S)
        end = begin + MOST_S
    grid = np.arange(begin, end, GRID_S)
    at = np.arange(begin + span_s, end - span_s, STEP_S)
    at = np.array([t for t in at if unbroken(t_fix, t, span_s) and unbroken(t_psi, t, span_s)])
    if len(at) < LEAST:
        return None
    heading = np.interp(grid, t_psi, psi)
    r = (np.interp(grid + 0.25, t_psi, psi) - np.interp(grid - 0.25, t_psi, psi)) / 0.5
    moved = interpolated(t_fix, fixes, grid + span_s) - interpolated(t_fix, fixes, grid - span_s)
    u, v = turned(-heading, moved / (2 * span_s)).T
    one = np.ones_like(u)

    # 2. Speeds in body axes as columns.
    def first(t_s: np.ndarray, x: np.ndarray, span_s: float) -> np.ndarray:
        return (interpolated(t_s, x, at + span_s) - interpolated(t_s, x, at - span_s)).T.ravel()

    def along(axis: np.ndarray) -> Column:
        return lambda x: first(grid, integrated(turned(heading, x[:, None] * axis), grid), span_s)

    def about(x: np.ndarray) -> np.ndarray:
        return first(grid, integrated(x[:, None], grid), YAW_S)

    M11, M22, M33 = np.diag(mass_matrix(vessel)).tolist()
    ahead, aside = Axis(along(AHEAD), M11, M22 * v * r), Axis(along(ASIDE), M22, -M11 * u * r)
    arms = [first(grid, turned(heading, axis), span_s) for axis in (AHEAD, ASIDE)]
    free = [ahead.column(one), aside.column(one), *arms, *np.kron(np.eye(2), np.ones(len(at)))]
    plane = _regression(first(t_fix, fixes, span_s), NOISE_M, free, (ahead, aside))
    turn = first(t_psi, psi[:, None], YAW_S)
    yaw = _regression(turn, NOISE_RAD, [about(one)], (Axis(about, M33, (M11 - M22) * u * v),))
    return LogDesign(run, grid, at, plane, yaw)


def _liveliest(changes_s: np.ndarray, low_s: float, high_s: float) -> float:
    """Begin of the `MOST_S` in which commands change most often, between `low_s` and `high_s`."""
    count = np.searchsorted(changes_s, changes_s + MOST_S) - np.arange(len(changes_s))
    return float(np.clip(changes_s[count.argmax()], low_s, high_s))


def _regression(y: np.ndarray, noise: float, free: Sequence[np.ndarray], axes: tuple[Axis, ...]) -> Regression:
    basis, _ = np.linalg.qr(np.column_stack(free))
    y = without(basis, y)
    return Regression(y, basis, axes, noise**2 + LEFT * float(y @ y) / len(y))
