"""Rows of the measurement Jacobian J, for blocks of windows at a time.

A measurement y = h(x, nu_dot, q) of window w depends on the window's node and on the parameters alone. Its row of J has
the L columns of the node, then the P of the parameters:

    dy/d[x0, d, q] = h_x S + h_nu_dot d(nu_dot)/d[x0, d, q] + h_q,    S = dx/d[x0, d, q]

S has C columns: X0_D of the node (its state x0 and latent acceleration d), then those of the parameters that move the
boat. `place` (C,) holds the column of J for each of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.fitting.engine.kernels.windows import (
    X0_D,
    fill_fix_rows,
    fill_imu_rows,
    propagate_sensitivities,
    transposed_into,
    whiten_rows,
)
from sim.fitting.engine.noise import BIAS_AX, BIAS_AY, BIAS_R, OFFSET, WANDER, L, Noise
from sim.fitting.engine.windows import PSI, RATE, SURGE, SWAY, Windows

BLOCK = 32  # windows whose rows are in memory at a time: a few megabytes, near a core's cache


@dataclass(frozen=True)
class AccelerationPartials:
    """Partial derivatives d(nu_dot)/dq along all windows, of the P parameters that move the boat.

    nodes   (W, K+1, 3, P) at the ends of the steps; between them the derivative is taken as linear in time
    bump    (W, K, 3, B) in the middle of each step beyond the mean of both ends (a parabola), where that is not enough
    bumped  (B,) indices of the parameters that `bump` belongs to
    """

    nodes: np.ndarray
    bump: np.ndarray
    bumped: np.ndarray

    @classmethod
    def of(cls, nodes: np.ndarray, bump: np.ndarray) -> AccelerationPartials:
        """From bumps of all P columns, (W, K, 3, P); columns of zeros are dropped."""
        bumped = np.flatnonzero(bump.any(axis=(0, 1, 2)))
        return cls(nodes, np.ascontiguousarray(bump[..., bumped]), bumped)

    def part(self, windows: slice) -> AccelerationPartials:
        """The same for the windows of a slice."""
        return AccelerationPartials(self.nodes[windows], self.bump[windows], self.bumped)


def sensitivities(A: np.ndarray, pushes: AccelerationPartials, h_s: np.ndarray) -> np.ndarray:
    """S = dx/d[x0, d, q] along some windows, (W, K+1, 6, X0_D + P).

    A (W, K+1, 6, 6): d(x_dot)/dx; h_s (W, K): step lengths [s].
    """
    S = np.empty((*A.shape[:3], X0_D + pushes.nodes.shape[3]))
    propagate_sensitivities(A, pushes.nodes, pushes.bump, pushes.bumped, h_s, S)
    return S


def imu_jacobian(
    S: np.ndarray,
    A: np.ndarray,
    pushes: AccelerationPartials,
    slopes: np.ndarray,
    direct: np.ndarray,
    known: np.ndarray,
    windows: tuple[np.ndarray, np.ndarray],
    noise: Noise,
    place: np.ndarray,
    columns: int,
) -> np.ndarray:
    """Rows (W, K, 4, columns) of psi, r, a_x, a_y, whitened; 0 where nothing was measured (`known`, (W, K, 4)).

    S, A, pushes  as of `sensitivities`
    slopes        (W, K, 4, 9) partial derivatives of the four by x y psi u v r u_dot v_dot r_dot
    direct        (W, K, 4, P) direct partial derivatives by the parameters, h_q; or (W, K, 4, 0): there are none
    windows       steps [s] and the decay of the heading's wander since the node (`fade`), (W, K) each
    """
    h_s, decay = windows
    J = np.zeros((*known.shape, columns))
    # 1. State and parameters, rows over their white noise. Heading rows are scaled later: the whitening filter needs
    #    their values at all steps, measured or not.
    scale = known / np.array(noise.white)
    scale[..., PSI] = 1.0
    fill_imu_rows(S, A, pushes.nodes, slopes, direct, scale, place, J)
    # 2. Sensor errors of the node.
    for channel, column in ((RATE, BIAS_R), (SURGE, BIAS_AX), (SWAY, BIAS_AY)):
        J[..., channel, column] = scale[..., channel]
    J[..., PSI, WANDER], J[..., PSI, OFFSET] = decay, 1.0
    # 3. Heading rows as innovations.
    whiten_rows(J, PSI, known[..., PSI], h_s, noise.white[PSI], noise.wander_rad, noise.wander_time_s)
    return J


def position_jacobian(
    S: np.ndarray,
    at: tuple[np.ndarray, np.ndarray],
    slopes: np.ndarray,
    direct: np.ndarray,
    scale: np.ndarray,
    place: np.ndarray,
    columns: int,
) -> np.ndarray:
    """Rows (m, 2, columns) of position samples, times `scale` (m,).

    at      window (an index of S) and step at or before each sample, (m,) each
    slopes  (m, 2, 6) partial derivatives of north and east by the state at that step
    direct  (m, 2, P) direct partial derivatives by the parameters; or (m, 2, 0): there are none
    """
    J = np.zeros((len(scale), 2, columns))
    fill_fix_rows(S, *at, slopes, direct, scale, place, J)
    return J


def fade(windows: Windows, noise: Noise) -> np.ndarray:
    """Decay of the heading's wander since the beginning of its window, exp(-(t - t_w) / tau), (W, K)."""
    t = windows.t_s[:, :-1]
    return np.exp(-(t - t[:, :1]) / noise.wander_time_s)


def jacobian_columns(moving: np.ndarray) -> np.ndarray:
    """Column of J for each column of S, (C,). `moving`: indices in q of the parameters of S."""
    return np.concatenate([np.arange(X0_D), L + moving])


def side_by_side(columns: np.ndarray) -> np.ndarray:
    """P arrays stacked along the first axis, (P, ..), as the columns of one array (n, P), contiguous by row."""
    flat = columns.reshape(len(columns), int(np.prod(columns.shape[1:])))
    out = np.empty(flat.shape[::-1])
    transposed_into(flat, out)
    return out
