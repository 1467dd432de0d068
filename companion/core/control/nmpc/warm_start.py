"""First guesses: the last plan shifted by the elapsed time, or a roll-out where there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.control.nmpc.problem import NmpcProblem
from companion.core.model.integrate import ETA

PSI = 2
LARGEST = 1e6
"""Largest absolute entry of a request or a guess; positions in m, forces in N. Assumed."""


@dataclass(frozen=True)
class WarmStart:
    """A plan to start from: states (N + 1, nx), commands (N, nu), first state at `t_ns`; `active`: codes (N, nu)."""

    t_ns: int
    x: np.ndarray
    c: np.ndarray
    active: np.ndarray | None = None


def _at(times: np.ndarray, grid: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Rows of `table` over `grid`, interpolated at `times`; beyond the end the last row."""
    return np.stack([np.interp(times, grid, column) for column in table.T], axis=1)


def usable(problem: NmpcProblem, warm: WarmStart, t_ns: int) -> bool:
    """Whether the plan can start a solve at `t_ns`.

    Not where it has another shape, is not finite, has an entry beyond `LARGEST`, begins after `t_ns` or is older than
    half the horizon.
    """
    N, h = problem.stages, problem.settings.step_s
    if warm.x.shape != (N + 1, problem.nx) or warm.c.shape != (N, problem.nu):
        return False
    if not ((np.abs(warm.x) <= LARGEST).all() and (np.abs(warm.c) <= LARGEST).all()):
        return False
    return 0.0 <= (t_ns - warm.t_ns) * 1e-9 <= 0.5 * N * h


def shifted(problem: NmpcProblem, warm: WarmStart, t_ns: int, x0: np.ndarray) -> np.ndarray | None:
    """`w` of a problem that starts `t_ns - warm.t_ns` later, or None where the plan is not `usable`.

    Headings are unwrapped to the heading of x0; the first state is x0.
    """
    if not usable(problem, warm, t_ns):
        return None
    grid, elapsed = problem.settings.step_s * np.arange(problem.stages + 1), (t_ns - warm.t_ns) * 1e-9
    x = _at(grid + elapsed, grid, warm.x)
    c = _at(grid[:-1] + elapsed, grid[:-1], warm.c)
    x[:, PSI] += 2 * np.pi * np.round((x0[PSI] - x[0, PSI]) / (2 * np.pi))
    x[0] = x0
    return problem.join(x, c)


def rolled_out(problem: NmpcProblem, x0: np.ndarray, f_prev: np.ndarray, rows: np.ndarray, d: np.ndarray) -> np.ndarray:
    """`w` of the last command held over the horizon; of x0 constant where that diverges."""
    c = np.tile(f_prev, (problem.stages, 1))
    disturbance = np.tile(d, (problem.stages, 1))
    x = np.array(problem.roll(x0, c.T, rows[:-1].T, disturbance.T)[0]).T
    if not (np.abs(x[:, ETA] - x0[ETA]) <= 1e3).all() or not (np.abs(x) <= LARGEST).all():
        x = np.tile(x0, (problem.stages, 1))
    return problem.join(np.vstack([x0, x]), c)
