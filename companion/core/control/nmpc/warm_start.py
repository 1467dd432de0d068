"""First guesses: the last plan shifted by the time that went by, or a roll-out where there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.control.nmpc.problem import NmpcProblem
from companion.core.model.integrate import ETA

PSI = 2
LARGEST = 1e6
"""No entry of a request or of a guess may be larger: positions in m, forces in N."""


@dataclass(frozen=True)
class WarmStart:
    """A plan to start from: states (N + 1, nx), commands (N, nu), first state at `t_ns`; `active`: its limits."""

    t_ns: int
    x: np.ndarray
    c: np.ndarray
    active: np.ndarray | None = None


def _at(times: np.ndarray, grid: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Rows of `table` over `grid`, interpolated at `times`; the last row holds beyond the end."""
    return np.stack([np.interp(times, grid, column) for column in table.T], axis=1)


def usable(problem: NmpcProblem, warm: WarmStart, t_ns: int) -> bool:
    """Whether the plan can serve at `t_ns`.

    It cannot when it has another shape, is not finite or huge, is younger than the request or older than half the
    horizon.
    """
    N, h = problem.stages, problem.settings.step_s
    if warm.x.shape != (N + 1, problem.nx) or warm.c.shape != (N, problem.nu):
        return False
    if not ((np.abs(warm.x) <= LARGEST).all() and (np.abs(warm.c) <= LARGEST).all()):
        return False
    return 0.0 <= (t_ns - warm.t_ns) * 1e-9 <= 0.5 * N * h


def shifted(problem: NmpcProblem, warm: WarmStart, t_ns: int, x0: np.ndarray) -> np.ndarray | None:
    """W for a problem that starts `t_ns - warm.t_ns` later, or None where the plan is not `usable`.

    Headings are brought to the turn of x0; x0 itself takes the first place.
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
    """W of the last command held over the horizon; standing still where that ends in no numbers."""
    c = np.tile(f_prev, (problem.stages, 1))
    along = np.tile(d, (problem.stages, 1))
    x = np.array(problem.roll(x0, c.T, rows[:-1].T, along.T)[0]).T
    if not (np.abs(x[:, ETA] - x0[ETA]) <= 1e3).all() or not (np.abs(x) <= LARGEST).all():
        x = np.tile(x0, (problem.stages, 1))
    return problem.join(np.vstack([x0, x]), c)
