"""Derivatives of what sensors should say to nodes and parameters, as rows of J: whole blocks of windows at a time.

Columns of J: the node's L, then P of parameters. `place` (C,) tells where each column of the sensitivities stands.
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
    """What each column beyond the node's adds to nu_dot: at nodes (W, K+1, 3, P), and what the middles of steps have

    beyond the mean of both ends (W, K, 3, B), for the columns `bumped` (B,).
    """

    nodes: np.ndarray
    bump: np.ndarray
    bumped: np.ndarray

    @classmethod
    def of(cls, nodes: np.ndarray, bump: np.ndarray) -> AccelerationPartials:
        """From all columns of the middles, (W, K, 3, P), most of them nil."""
        bumped = np.flatnonzero(bump.any(axis=(0, 1, 2)))
        return cls(nodes, np.ascontiguousarray(bump[..., bumped]), bumped)

    def part(self, windows: slice) -> AccelerationPartials:
        """Some of the windows."""
        return AccelerationPartials(self.nodes[windows], self.bump[windows], self.bumped)


def sensitivities(A: np.ndarray, pushes: AccelerationPartials, h_s: np.ndarray) -> np.ndarray:
    """dx/d[x0, d, ..] at all nodes of some windows, (W, K+1, 6, X0_D + P); A (W, K+1, 6, 6), h_s (W, K)."""
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
    """Rows (W, K, 4, columns) of psi, r, a_x, a_y, whitened; nil where nothing was measured (`known`, (W, K, 4)).

    slopes (W, K, 4, 9): to x y psi u v r u_dot v_dot r_dot; direct (W, K, 4, P or 0): of the columns beyond the node's.
    `windows`: steps [s] and what is left of a heading's wander since each began, both (W, K).
    """
    h_s, fade = windows
    J = np.zeros((*known.shape, columns))
    scale = known / np.array(noise.white)
    scale[..., PSI] = 1.0  # for the filter, which takes what is not known as well
    fill_imu_rows(S, A, pushes.nodes, slopes, direct, scale, place, J)
    for channel, column in ((RATE, BIAS_R), (SURGE, BIAS_AX), (SWAY, BIAS_AY)):
        J[..., channel, column] = scale[..., channel]
    J[..., PSI, WANDER], J[..., PSI, OFFSET] = fade, 1.0
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
    """Rows (m, 2, columns) of position samples, times `scale` (m,). `at`: window of S and step before each, (m,).

    slopes (m, 2, 6): to the state there; direct (m, 2, P or 0): of the columns beyond the node's.
    """
    J = np.zeros((len(scale), 2, columns))
    fill_fix_rows(S, *at, slopes, direct, scale, place, J)
    return J


def fade(windows: Windows, noise: Noise) -> np.ndarray:
    """What is left of a heading's wander since the beginning of each window, (W, K)."""
    t = windows.t_s[:, :-1]
    return np.exp(-(t - t[:, :1]) / noise.wander_time_s)


def jacobian_columns(moving: np.ndarray) -> np.ndarray:
    """Of the columns of S in J; `moving`: which parameters those beyond the node's are of."""
    return np.concatenate([np.arange(X0_D), L + moving])


def side_by_side(columns: np.ndarray) -> np.ndarray:
    """Columns one after the other (P, ..) as columns side by side, (n, P)."""
    flat = columns.reshape(len(columns), int(np.prod(columns.shape[1:])))
    out = np.empty(flat.shape[::-1])
    transposed_into(flat, out)
    return out
