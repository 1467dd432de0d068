"""scipy's least_squares on `CasadiProblem`, from the structured fit's own start to its optimum, to compare times.

`plain_fit` is the obvious call. `casadi_fit` is the quickest variant found: trust region, steps by LSMR on the sparse
Jacobian ("exact" would be a singular value decomposition of 68,000 x 9,700 numbers for 13,840 samples), and two
measures without which it takes many times as long:

- Ties are stiff: with `x_scale="jac"` LSMR needs 250 to 1,300 products a step. So unknowns are y = R x with
  R^T R = J^T J by Cholesky where a call of `least_squares` begins, and there is a call every two steps.
- Ties are slack at first, as in `structured_fit.solve`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky_banded, get_lapack_funcs, solve_triangular
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator

from sim.fitting.engine.noise import L
from sim.fitting.identify.structured_fit import SLACK
from sim.studies.peers.casadi_problem import CasadiProblem

(_tbtrs,) = get_lapack_funcs(("tbtrs",), dtype=np.float64)

ENOUGH = 0.5  # nats: a call that gains less is the last one, as in `structured_fit.ENOUGH`
EVALUATIONS = 3  # of the residual by one call, the one where it begins among them
LSMR = 1e-4  # relative tolerance of a step


@dataclass(frozen=True)
class CasadiFit:
    """Solution w (P,), nodes (W, L), cost [nats]; wall and processor time [s]; evaluations of Jacobian and residual."""

    w: np.ndarray
    z: np.ndarray
    cost: float
    seconds: float
    processor_s: float
    jacobians: int
    residuals: int


class White:
    """R of R^T R = J^T J: nodes as a band, the parameters (P of them, first in x) as its border."""

    def __init__(self, J: csr_array, P: int):
        H = (J.T @ J).tocsr()
        nodes = H[P:, P:].tocoo()
        below = nodes.row >= nodes.col
        band = np.zeros((2 * L, nodes.shape[0]))
        band[(nodes.row - nodes.col)[below], nodes.col[below]] = nodes.data[below]
        self.P, self.band = P, cholesky_banded(band, lower=True)
        self.border = _tbtrs(self.band, H[P:, :P].toarray(), uplo="L")[0]
        self.corner = np.linalg.cholesky(H[:P, :P].toarray() - self.border.T @ self.border)

    def forward(self, x: np.ndarray) -> np.ndarray:
        """R x."""
        w, z = x[: self.P], x[self.P :]
        out = self.border @ w
        for k, diagonal in enumerate(self.band):
            out[: len(z) - k] += diagonal[: len(z) - k] * z[k:]
        return np.concatenate([self.corner.T @ w, out])

    def back(self, y: np.ndarray) -> np.ndarray:
        """x of y."""
        w = solve_triangular(self.corner, y[: self.P], lower=True, trans=1)
        z = _tbtrs(self.band, (y[self.P :] - self.border @ w)[:, None], uplo="L", trans="T")[0]
        return np.concatenate([w, z[:, 0]])

    def transposed(self, g: np.ndarray) -> np.ndarray:
        """R^-T g."""
        z = _tbtrs(self.band, g[self.P :, None], uplo="L")[0][:, 0]
        w = solve_triangular(self.corner, g[: self.P] - self.border.T @ z, lower=True)
        return np.concatenate([w, z])


class Whitened(LinearOperator):
    """J R^-1: the Jacobian with respect to y."""

    def __init__(self, J: csr_array, white: White):
        super().__init__(J.dtype, J.shape)
        self._J, self._white = J, white

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        return self._J @ self._white.back(np.ravel(x))

    def _rmatvec(self, x: np.ndarray) -> np.ndarray:
        return self._white.transposed(self._J.T @ np.ravel(x))


@dataclass(frozen=True)
class PlainFit:
    """Result of a plain call: least cost [nats], processor time [s], evaluations; whether it ended by itself."""

    cost: float
    processor_s: float
    residuals: int
    ended: bool


class _OverError(Exception):
    """Time is over."""


def plain_fit(problem: CasadiProblem, most_s: float) -> PlainFit:
    """`least_squares` with the residual and its sparse Jacobian, in the Jacobian's own scale and otherwise by default.

    Given up at the first residual after `most_s` of processor time.
    """
    began, costs = time.process_time(), []

    def residual(x: np.ndarray) -> np.ndarray:
        r = problem.residual(x)
        costs.append(float(r @ r) / 2)
        if time.process_time() - began > most_s:
            raise _OverError
        return r

    ended = True
    try:
        least_squares(residual, problem.start, jac=problem.jacobian, x_scale="jac")  # pyright: ignore[reportArgumentType]
    except _OverError:
        ended = False
    return PlainFit(min(costs), time.process_time() - began, len(costs), ended)


def casadi_fit(problem: CasadiProblem, *, enough: float = ENOUGH, most: int = 50) -> CasadiFit:
    """Solve it with at most `most` calls. Making the CasADi functions is not in the time."""
    began, began_cpu = time.perf_counter(), time.process_time()
    x, cost, kept, residuals = problem.start, np.inf, CasadiResult(problem), 0
    for call in range(most):
        slack = SLACK[min(call, len(SLACK) - 1)]
        kept.slacken(slack)
        solution, x = _call(kept, x)
        residuals += solution.nfev
        gained, cost = cost - solution.cost, float(solution.cost)
        if call >= len(SLACK) and gained < enough:
            break
    seconds, processor_s = time.perf_counter() - began, time.process_time() - began_cpu
    return CasadiFit(*problem.split(x), cost, seconds, processor_s, kept.count, residuals)


def _call(kept: CasadiResult, x: np.ndarray) -> tuple[OptimizeResult, np.ndarray]:
    """One call of `least_squares` from x; what it says and where it ends."""
    white = White(kept(x), len(kept.problem.parameters.names))

    def jacobian(y: np.ndarray) -> LinearOperator:
        return Whitened(kept(white.back(y)), white)

    solution = least_squares(
        lambda y: kept.problem.residual(white.back(y)),
        white.forward(x),
        jac=jacobian,  # pyright: ignore[reportArgumentType]
        method="trf",
        tr_solver="lsmr",
        tr_options={"atol": LSMR, "btol": LSMR},
        max_nfev=EVALUATIONS,
    )
    return solution, white.back(solution.x)


class CasadiResult:
    """A problem with its latest Jacobian cached; `count`: how many were computed."""

    def __init__(self, problem: CasadiProblem):
        self.problem, self.count = problem, 0
        self._at, self._J, self._slack = np.empty(0), None, 0.0

    def slacken(self, slack: float) -> None:
        """Change the slack of the ties; the cached Jacobian is then dropped."""
        if slack != self._slack:
            self.problem.slacken(slack)
            self._slack, self._J = slack, None

    def __call__(self, x: np.ndarray) -> csr_array:
        """The Jacobian at x."""
        if self._J is None or not np.allclose(x, self._at, rtol=1e-12, atol=1e-12):
            self._at, self._J, self.count = x, self.problem.jacobian(x), self.count + 1
        return self._J
