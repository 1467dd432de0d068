"""Real-time iteration: Gauss-Newton steps on one problem, by machine code where it can be had.

    x_k+1 = x_k + dx, c_k+1 = c_k + dc,    (dx, dc) from the quadratic program with the Gauss-Newton Hessian 2 J' J

    write X, C, x0, p, q -> `solve` (shift, `iterations` times prepare and feedback, look) -> read X, C, `info`

`prepare` needs no state: it may run before the state is known; `feedback` then costs a roll-out. Neither allocates,
and both end after a bounded number of operations. Source: Diehl, Bock, Schloeder (2005), SIAM J. Control Optim. 43(5).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.core.control.ocp import Ocp
from companion.core.control.rti.compiled import CompiledRti
from companion.core.control.rti.interpreted import InterpretedRti
from companion.core.control.rti.loops import Compiler, NotCompiled
from companion.core.control.rti.stage_functions import stage_functions

ITERATIONS = 2
"""Steps of one solve: the second brings the open-loop cost within 3e-5 of the optimum (docs/benchmarks/speed.md)."""


class SolveInfo(NamedTuple):
    """Outcome: cost, largest gap of the dynamics over its scale, largest excess over a limit [N], sum of the squared
    gaps, and the number of active limits that still changed in the last quadratic program.
    """

    cost: float
    defect: float
    excess: float
    squares: float
    changed: float

    @property
    def settled(self) -> bool:
        """Whether the last quadratic program was solved exactly."""
        return self.changed == 0.0

    @property
    def sane(self) -> bool:
        """Every number finite. `squares` is tested because the largest value, `defect`, does not show NaN."""
        return math.isfinite(self.cost + self.squares)


class Rti:
    """One problem, ready to be solved again and again. Belongs to one thread at a time.

    Arrays to write before and to read after: X (N + 1, nx), C (N, nu) the guess and the plan, x0 (nx,), p (N + 1, .),
    q, active (N, nu) codes of the active limits (`riccati`), shift (1,) in stages.
    """

    def __init__(
        self, ocp: Ocp, *,
        iterations: int = ITERATIONS, interpreted: int | None = None, compiler: Compiler | None = None,
    ):  # fmt: skip
        """`iterations`: steps of a solve; `interpreted`: the same without machine code, None: as many.

        `compiler` makes the machine code; None: CasADi's interpreter.
        """
        self.ocp = ocp
        functions = stage_functions(ocp)
        self.why_not_compiled = "" if compiler else "not asked for"
        self._way: CompiledRti | InterpretedRti | None = None
        if compiler:
            try:
                self._way = CompiledRti(functions, iterations, compiler)
            except NotCompiled as reason:
                self.why_not_compiled = str(reason)
        self.iterations = iterations if self._way or interpreted is None else interpreted
        way = self._way = self._way or InterpretedRti(functions, self.iterations)
        view = way.view
        self.X, self.C, self.x0, self.p, self.q = (view[name] for name in ("X", "C", "x0", "p", "q"))
        self.active, self.shift, self.dx, self.dc = (view[name] for name in ("active", "shift", "dx", "dc"))
        self._info = view["info"]
        self.prepare, self.feedback, self.solve, self.iterate = way.prepare, way.feedback, way.solve, way.iterate
        self.look = way.look

    def damped(self, share: float) -> None:
        """One iteration with step length `share`; limits are kept, as both ends keep them and they are convex."""
        X, C = self.X.copy(), self.C.copy()
        self.prepare()
        self.feedback()
        self.X[:] = X + share * (self.X - X)
        self.C[:] = C + share * (self.C - C)
        self.look()

    def info(self) -> SolveInfo:
        """Outcome of the last solve or iteration."""
        return SolveInfo(*self._info.tolist())
