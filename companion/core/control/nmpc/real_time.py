"""The real-time iteration on the production problem: warm start from the last plan, or cold start until convergence."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.control.nmpc.problem import NmpcProblem
from companion.core.control.nmpc.production import production
from companion.core.control.nmpc.settings import Actuation
from companion.core.control.nmpc.warm_start import PSI, WarmStart, rolled_out, shifted, usable
from companion.core.control.rti.iteration import Rti, SolveInfo
from companion.core.control.rti.loops import Compiler
from companion.core.geometry.fence import Fence
from companion.core.model.integrate import FORCES, VesselModel

COST_TOLERANCE = 1e-4
"""Cold start: relative change of the cost in the last step, at most."""
GAP_TOLERANCE = 1e-3
"""Cold start: largest gap of the dynamics at the end, scaled."""
FULL_STEPS, HALF_STEPS = 6, 16
"""Cold start: last iteration with step length 1, and last with 1/2; then 1/4. Where full steps alternate about the
solution, their mean is near it."""
ACTIVE_SET_AGE_S = 0.5
"""Active limits of a plan older than this are discarded [s]; assumed."""


class Solution(NamedTuple):
    """Result of the iterations: states (N + 1, nx), commands (N, nu), cost, largest gap of the dynamics (scaled),
    largest excess over a limit [N], active limits (N, nu) for the next start.
    """

    x: np.ndarray
    c: np.ndarray
    cost: float
    defect: float
    excess: float
    active: np.ndarray | None = None


class RealTimeSolver:
    """Real-time iteration of one vessel. Belongs to one thread at a time."""

    def __init__(
        self,
        problem: NmpcProblem,
        model: VesselModel,
        actuation: Actuation,
        fence: Fence | None,
        compiler: Compiler | None,
    ):
        self._problem = problem
        settings = problem.settings
        self.rti = Rti(
            production(model, actuation, settings, fence),
            iterations=settings.iterations,
            interpreted=settings.interpreted_iterations,
            compiler=compiler if settings.method == "rti" else None,
        )

    def warm(
        self, warm: WarmStart, t_ns: int, x0: np.ndarray, rows: np.ndarray, d: np.ndarray
    ) -> tuple[SolveInfo, int]:
        """From the last plan: `Rti.iterations` steps, more while a gap exceeds the tolerance. Outcome, steps."""
        s, rti = self._problem.settings, self.rti
        share = (t_ns - warm.t_ns) * 1e-9 / s.step_s
        if not usable(self._problem, warm, t_ns):
            return NO_SOLUTION, 0
        if share <= 1.0:
            rti.X[:], rti.C[:], rti.shift[0] = warm.x, warm.c, share
            rti.X[:, PSI] += 2 * np.pi * np.round((x0[PSI] - warm.x[0, PSI]) / (2 * np.pi))
        else:
            w = shifted(self._problem, warm, t_ns, x0)
            assert w is not None, "usable was checked"
            rti.X[:], rti.C[:] = self._problem.split(w)
            rti.shift[0] = 0.0
        rti.active[:] = warm.active if warm.active is not None and share * s.step_s < ACTIVE_SET_AGE_S else 0.0
        rti.x0[:], rti.p[:], rti.q[:] = x0, rows, d
        rti.solve()
        info, count = rti.info(), rti.iterations
        while count < s.most_iterations and info.sane and info.defect > s.defect_tolerance:
            rti.iterate()
            info, count = rti.info(), count + 1
        return info, count

    def cold(self, x0: np.ndarray, f_prev: np.ndarray, rows: np.ndarray, d: np.ndarray) -> tuple[Solution | None, int]:
        """From a roll-out by full steps, and from x0 constant by half steps; the solution of lower cost, and the steps.

        None where neither converges. About one in a hundred random problems has a second local minimum, and the two
        starts seldom end in the same.
        """
        p, rti = self._problem, self.rti
        rti.x0[:], rti.p[:], rti.q[:] = x0, rows, d
        rolled = p.split(rolled_out(p, x0, f_prev, rows, d))
        constant = np.tile(x0, (p.stages + 1, 1)), np.tile(x0[FORCES], (p.stages, 1))
        best, steps = None, 0
        for (X, C), full_steps in ((rolled, FULL_STEPS), (constant, 0)):
            rti.X[:], rti.C[:], rti.active[:] = X, C, 0.0
            info, count = self._converge(full_steps)
            steps += count
            if info is not None and (best is None or info.cost < best.cost):
                best = self.solution(info)
        return best, steps

    def _converge(self, full_steps: int) -> tuple[SolveInfo | None, int]:
        """Iterate from the guess in memory until cost and gaps converge; None where they do not. Also the steps."""
        last, most = np.inf, self._problem.settings.cold_iterations
        for count in range(1, most + 1):
            self.rti.damped(1.0 if count <= full_steps else 0.5 if count <= HALF_STEPS else 0.25)
            info = self.rti.info()
            if not info.sane:
                return None, count
            if info.settled and info.defect < GAP_TOLERANCE and abs(last - info.cost) <= COST_TOLERANCE * info.cost:
                return info, count
            last = info.cost
        return None, most

    def solution(self, info: SolveInfo) -> Solution:
        """A copy of the plan in the solver's memory."""
        rti = self.rti
        return Solution(rti.X.copy(), rti.C.copy(), info.cost, info.defect, info.excess, rti.active.copy())


NO_SOLUTION = SolveInfo(np.inf, np.inf, np.inf, np.inf, np.inf)
"""Outcome without a plan."""
