"""The solvers behind one call: state and parameters in, plan out; each keeps its own last plan, shifted by a tick."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import casadi as ca
import numpy as np

from companion.core.control.rti.iteration import Rti
from companion.jit import compile_loops
from sim.bench.controller.nlp import Nlp

SHIFT_S = 0.1


class PlannedControls(NamedTuple):
    """States (N + 1, nx), controls (N, nu), cost, and whether the solver calls it solved."""

    x: np.ndarray
    c: np.ndarray
    cost: float
    solved: bool


class Planner(Protocol):
    """One solver on one problem."""

    name: str

    def begin(self, x0: np.ndarray, p: np.ndarray, q: np.ndarray) -> None:
        """Forget, and plan from nothing, as well as it takes."""
        ...

    def solve(self, x0: np.ndarray, p: np.ndarray, q: np.ndarray) -> PlannedControls:
        """Plan a tick after the last one."""
        ...


class CasadiPlanner:
    """A solver that CasADi brings, on `Nlp`, from the last plan; `solver` as `Nlp.solver` or `Nlp.one_step` make it."""

    def __init__(self, name: str, nlp: Nlp, step_s: float, solver: ca.Function, settle: int = 1):
        """`settle`: calls from nothing at the beginning. More than one: a single step, solved where it has numbers."""
        self.name = name
        self._nlp, self._share, self._settle = nlp, SHIFT_S / step_s, settle
        self._solver = solver
        self.x, self.c = np.zeros((nlp.ocp.stages + 1, nlp.ocp.nx)), np.zeros((nlp.ocp.stages, nlp.ocp.nu))

    def begin(self, x0: np.ndarray, p: np.ndarray, q: np.ndarray) -> None:
        """From standing still at x0."""
        self.x[:], self.c[:] = x0, 0.0
        self.c += np.clip(0.0, self._nlp.ocp.c_min, self._nlp.ocp.c_max)
        for _ in range(self._settle):
            self._called(x0, p, q)

    def solve(self, x0: np.ndarray, p: np.ndarray, q: np.ndarray) -> PlannedControls:
        """Shift, one call of the solver."""
        self.x[:-1] += self._share * (self.x[1:] - self.x[:-1])
        self.c[:-1] += self._share * (self.c[1:] - self.c[:-1])
        return self._called(x0, p, q)

    def _called(self, x0: np.ndarray, p: np.ndarray, q: np.ndarray) -> PlannedControls:
        nlp = self._nlp
        self.x[0] = x0
        answer = nlp.call(self._solver, nlp.join(self.x, self.c), x0, p, q)
        x, c = nlp.split(np.array(answer["x"]).ravel())
        self.x[:], self.c[:] = x, c
        cost = float(answer["f"])
        solved = bool(np.isfinite(cost)) if self._settle > 1 else bool(self._solver.stats()["success"])
        return PlannedControls(self.x, self.c, cost, solved)


class RtiPlanner:
    """The real-time iteration; `to` > 0: iterated until the cost changes by less than that share of it."""

    def __init__(
        self, name: str, nlp: Nlp, step_s: float, *,
        iterations: int = 2, to: float = 0.0, compiled: bool = True,
    ):  # fmt: skip
        self.name, self._to = name, to
        self.rti = Rti(nlp.ocp, iterations=iterations, compiler=compile_loops if compiled else None)
        self._share = SHIFT_S / step_s

    def begin(self, x0: np.ndarray, p: np.ndarray, q: np.ndarray) -> None:
        """From standing still at x0; twenty iterations."""
        r = self.rti
        r.X[:], r.active[:] = x0, 0.0
        r.C[:] = np.clip(0.0, r.ocp.c_min, r.ocp.c_max)
        r.x0[:], r.p[:], r.q[:], r.shift[0] = x0, p, q, 0.0
        for _ in range(20):
            r.iterate()

    def rehearse(self) -> None:
        """The last solve once more, as the boat does shortly before a tick; leaves no trace but in the caches."""
        r = self.rti
        kept = [(array, array.copy()) for array in (r.X, r.C, r.active)]
        r.solve()
        r.info()
        for array, before in kept:
            array[:] = before

    def solve(self, x0: np.ndarray, p: np.ndarray, q: np.ndarray) -> PlannedControls:
        """Shift, iterate."""
        r = self.rti
        r.x0[:], r.p[:], r.q[:], r.shift[0] = x0, p, q, self._share
        r.solve()
        info = r.info()
        if self._to:
            last = np.inf
            for _ in range(20):
                if abs(last - info.cost) <= self._to * info.cost and info.defect < 1e-6:
                    break
                last = info.cost
                r.iterate()
                info = r.info()
        return PlannedControls(r.X, r.C, info.cost, info.settled and info.sane)
