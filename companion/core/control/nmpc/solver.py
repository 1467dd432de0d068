"""Repeated solution of the production problem: always a result with a status, never an exception.

    1. usable warm start   real-time iteration (`rti`): 2 steps, more while the dynamics do not close
    2. 1 failed            the same by hpipm
    3. no warm start, or 2 failed   real-time iteration from a roll-out until convergence
    4. 3 failed            IPOPT from the roll-out, bounded

`ok`: finite, within its limits, and the dynamics close to `defect_tolerance`. `not_converged`: finite and within limits
only. `failed`: no plan. A result that is not ok leaves no warm start. An instance belongs to one thread at a time.
Source of the scheme: Diehl, Bock, Schloeder (2005), SIAM J. Control Optim. 43(5).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from companion.core.control.nmpc.hpipm_step import QpStep, Step
from companion.core.control.nmpc.problem import NmpcProblem, build
from companion.core.control.nmpc.real_time import RealTimeSolver, Solution
from companion.core.control.nmpc.settings import Actuation, NmpcSettings
from companion.core.control.nmpc.warm_start import LARGEST, PSI, WarmStart, rolled_out, shifted
from companion.core.control.rti.loops import Compiler
from companion.core.geometry.fence import Fence
from companion.core.guidance.reference_row import COLUMNS, Column, near
from companion.core.messages import PlanResult, SolveRequest
from companion.core.model.integrate import FORCES, VesselModel

BOUND_TOLERANCE = 1e-6
"""[N] by which a planned command may exceed a limit before it is clipped, times `strength`; more is a failure."""


class PlanQuery(NamedTuple):
    """A request as arrays: x0 (nx,), rows (N + 1, 8), disturbance (3,), last command (nu,)."""

    x0: np.ndarray
    rows: np.ndarray
    d: np.ndarray
    f_prev: np.ndarray


class Nmpc:
    """The production NMPC of one vessel, which keeps inside `fence`. `clock` [s] only times the solves."""

    def __init__(
        self,
        model: VesselModel,
        actuation: Actuation,
        settings: NmpcSettings,
        clock: Callable[[], float],
        fence: Fence | None = None,
        compiler: Compiler | None = None,
    ):
        """`compiler` makes machine code of the real-time iteration; None: CasADi's interpreter."""
        self.problem: NmpcProblem = build(model, actuation, settings, fence)
        self._actuation, self._clock = actuation, clock
        self._step = QpStep(self.problem)
        kernel = settings.method != "hpipm"
        self._real_time = RealTimeSolver(self.problem, model, actuation, fence, compiler) if kernel else None
        self._rescue = ca.nlpsol("rescue", "ipopt", self.problem.nlp, ipopt_options(settings))
        self._bound_tolerance = BOUND_TOLERANCE * actuation.strength
        self._scale = np.concatenate([np.ones(6), np.full(self.problem.nu, actuation.equal_change)])

    def solve(self, request: SolveRequest, warm: WarmStart | None) -> tuple[PlanResult, WarmStart | None]:
        """Plan for `request`, and the warm start of the next. Never raises, never returns NaN."""
        started = self._clock()
        query = self._query(request)
        if isinstance(query, str):
            return self._failed(request, query, started, 0)
        solution, reason, steps = self._warm(request, query, warm) if warm else (None, "cold start", 0)
        if solution is None:
            solution, more = self._cold(query)
            steps += more
        if solution is None:
            return self._failed(request, f"{reason}; rescue failed", started, steps)
        return self._finish(request, query, solution, reason, started, steps)

    @property
    def why_not_compiled(self) -> str:
        """Why the steps are not machine code; empty where they are."""
        return self._real_time.rti.why_not_compiled if self._real_time else "hpipm takes the steps"

    def _warm(self, request: SolveRequest, query: PlanQuery, warm: WarmStart) -> tuple[Solution | None, str, int]:
        """From the last plan: real-time iteration, then hpipm. Solution or None, reason, steps."""
        steps, tolerance = 0, self.problem.settings.defect_tolerance
        if self._real_time:
            info, steps = self._real_time.warm(warm, request.t_ns, query.x0, query.rows, query.d)
            if info.sane and info.settled and info.defect <= tolerance and info.excess <= self._bound_tolerance:
                return self._real_time.solution(info), "", steps
        first = shifted(self.problem, warm, request.t_ns, query.x0)
        if first is None:
            return None, "warm start not usable", steps
        step, more = self._iterate(first, query)
        if step is None:
            return None, "real-time iteration did not close", steps + more
        return self._solution(step), "hpipm took over" if self._real_time else "", steps + more

    def _cold(self, query: PlanQuery) -> tuple[Solution | None, int]:
        """From a roll-out: real-time iteration, then IPOPT. Solution or None, and steps."""
        steps = 0
        if self._real_time:
            solution, steps = self._real_time.cold(query.x0, query.f_prev, query.rows, query.d)
            if solution is not None and solution.excess <= self._bound_tolerance:
                return solution, steps
        step, more = self._solve_by_ipopt(query)
        return self._solution(step) if step else None, steps + more

    def _solution(self, step: Step) -> Solution:
        """Solution of hpipm or IPOPT."""
        return Solution(*self.problem.split(step.w), step.cost, self._defect(step), self._excess(step))

    def _query(self, request: SolveRequest) -> PlanQuery | str:
        """The request as arrays, or the reason why it is invalid. Forces in x0 are clipped to their limits."""
        p, low, high = self.problem, self._actuation.force_min_n, self._actuation.force_max_n
        sizes = {"x0": p.nx, "disturbance_n": 3, "f_prev_n": p.nu}
        for name, size in sizes.items():
            if len(getattr(request, name)) != size:
                return f"{name}: expected {size} numbers, found {len(getattr(request, name))}"
        rows = request.reference
        if len(rows) != p.stages + 1 or any(len(row) != len(COLUMNS) for row in rows):
            return f"reference: expected {p.stages + 1} rows of {len(COLUMNS)}"
        fields = (request.x0, rows, request.disturbance_n, request.f_prev_n)
        x0, table, d, f_prev = (np.array(numbers, dtype=float) for numbers in fields)
        query = PlanQuery(x0, table, d, f_prev)
        for name, array in zip(("x0", "reference", "disturbance_n", "f_prev_n"), query, strict=True):
            if not (np.abs(array) <= LARGEST).all():
                return f"{name}: not finite, or beyond {LARGEST:g}"
        query.x0[FORCES] = np.clip(query.x0[FORCES], low, high)
        query.rows[:, Column.PSI] = near(query.rows[:, Column.PSI], query.x0[PSI])
        return query._replace(f_prev=np.clip(query.f_prev, low, high))

    def _iterate(self, w: np.ndarray, query: PlanQuery) -> tuple[Step | None, int]:
        """Steps of hpipm from `w`, and their number; None where the dynamics do not close."""
        s = self.problem.settings
        step = None
        for count in range(1, max(s.iterations, s.most_iterations) + 1):
            step = self._step(w, query.rows, query.d)
            if step is None or not step.solved:
                return None, count
            if count >= s.iterations and self._defect(step) <= s.defect_tolerance:
                return step, count
            w = step.w
        return None, max(s.iterations, s.most_iterations)

    def _solve_by_ipopt(self, query: PlanQuery) -> tuple[Step | None, int]:
        """IPOPT from a roll-out, and its iterations; None where the result is not finite."""
        p = self.problem
        w = rolled_out(p, query.x0, query.f_prev, query.rows, query.d)
        low, high = p.w_min.copy(), p.w_max.copy()
        low[: p.nx] = high[: p.nx] = query.x0
        try:
            solution = self._rescue(
                x0=w,
                p=np.concatenate([query.rows.ravel(), query.d]),
                lbx=low, ubx=high, lbg=p.g_min, ubg=p.g_max,
            )  # fmt: skip
        except RuntimeError:  # CasADi's only exception: a function that could not be evaluated
            return None, 0
        w, count = np.array(solution["x"]).ravel(), int(self._rescue.stats().get("iter_count", 0))
        w[: p.nx] = query.x0
        step = Step(w, 0.0, float(solution["f"]), np.array(solution["g"]).ravel())
        return (step if step.solved else None), count

    def _defect(self, step: Step) -> float:
        """Largest gap of the dynamics, scaled."""
        p = self.problem
        gaps = step.g.reshape(p.stages, p.nx + p.nu)[:, : p.nx]
        return float(np.max(np.abs(gaps) / self._scale))

    def _excess(self, step: Step) -> float:
        """Largest violation of force and rate limits [N]."""
        p = self.problem
        rates = step.g.reshape(p.stages, p.nx + p.nu)[:, p.nx :]
        _, c = p.split(step.w)
        low, high = self._actuation.force_min_n - c, c - self._actuation.force_max_n
        return float(max(low.max(), high.max(), (np.abs(rates) - p.g_max[-p.nu :]).max()))

    def _finish(
        self, request: SolveRequest, query: PlanQuery, solution: Solution, reason: str, started: float, steps: int
    ) -> tuple[PlanResult, WarmStart | None]:
        """Status of the plan by its residuals; the result and the next warm start."""
        x, c, defect = solution.x, solution.c, solution.defect
        x[0] = query.x0
        if not (np.isfinite(solution.cost) and np.isfinite(x).all()) or not solution.excess <= self._bound_tolerance:
            return self._failed(request, f"{reason}; limits exceeded by {solution.excess:.3g} N", started, steps)
        c = np.clip(c, self._actuation.force_min_n, self._actuation.force_max_n)
        ok = defect <= self.problem.settings.defect_tolerance
        result = PlanResult(
            t_ns=request.t_ns,
            index=request.index,
            status="ok" if ok else "not_converged",
            reason=reason if ok else f"{reason}; dynamics open by {defect:.3g}".removeprefix("; "),
            solve_time_s=self._clock() - started,
            iterations=steps,
            cost=solution.cost,
            f_n=tuple(map(tuple, c.tolist())),
            x=tuple(map(tuple, x.tolist())),
        )
        return result, WarmStart(request.t_ns, x, c, solution.active) if ok else None

    def _failed(self, request: SolveRequest, reason: str, started: float, steps: int) -> tuple[PlanResult, None]:
        """A result without a plan and without a warm start."""
        return PlanResult(
            t_ns=request.t_ns,
            index=request.index,
            status="failed",
            reason=reason.removeprefix("; "),
            solve_time_s=self._clock() - started,
            iterations=steps,
            cost=None,
            f_n=(),
            x=(),
        ), None


def ipopt_options(settings: NmpcSettings) -> dict[str, Any]:
    """Silent, bounded in iterations and time, expanded to scalar operations; otherwise IPOPT's defaults."""
    return {
        "expand": True,
        "error_on_fail": False,
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.tol": 1e-6,
        "ipopt.max_iter": settings.rescue_iterations,
        "ipopt.max_wall_time": settings.rescue_time_s,
    }
