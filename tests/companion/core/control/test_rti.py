"""The real-time iteration: its quadratic program against a dense oracle, its plans against IPOPT and fatrop."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.control.ocp import Ocp
from companion.core.control.rti.iteration import Rti
from companion.jit import compile_loops, machine
from sim.bench.controller.nlp import Nlp
from tests.companion.core.control.rti_fixture import WAYS, anywhere, boat, near_the_leg


def linear_ocp(seed: int, stages: int, rate: float | np.ndarray | None) -> Ocp:
    """A random linear problem, 3 controls, with or without forces as states: one iteration must solve it exactly."""
    rng = np.random.default_rng(seed)
    n, m = (4, 3) if rate is None else (6, 3)
    x, c, p = ca.SX.sym("x", n), ca.SX.sym("c", m), ca.SX.sym("p", 1)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    if rate is not None:
        A[3:], B[3:] = np.hstack([np.zeros((3, 3)), np.eye(3) * 0.2]), np.eye(3) * 0.8
    following = ca.DM(A) @ x + ca.DM(B) @ c + p * ca.DM(rng.normal(size=n) * 0.1)
    weight = rng.normal(size=(n, n))
    J = ca.jacobian(following, ca.vertcat(x, c))
    return Ocp(
        stages, x, c, p, ca.SX.sym("q", 0), following, J,
        residual=ca.vertcat(ca.DM(weight) @ x - 0.3, 0.3 * (c - 0.1)), last=2 * ca.DM(weight) @ x,
        c_min=np.full(m, -1.0), c_max=np.array([1.0, 0.5, 1.5]), scale=np.ones(n),
        forces=None if rate is None else 3, rate_n=np.inf if rate is None else rate,
    )  # fmt: skip


def dense_optimum(ocp: Ocp, x0, p):
    """The same problem by qpOASES, a dense active-set method, on all variables at once: cost, controls."""
    nlp = Nlp(ocp)
    solver = ca.qpsol("oracle", "qpoases", nlp.problem, {"printLevel": "none", "print_time": False})
    answer = nlp.call(solver, np.zeros(nlp.low.size), x0, p, np.zeros(0))
    assert solver.stats()["success"]
    return float(answer["f"]), nlp.split(np.array(answer["x"]).ravel())[1]


@pytest.mark.parametrize(
    "rate",
    [None, pytest.param(0.4, marks=pytest.mark.long), np.array([0.4, 0.2, 0.8])],
    ids=["bounds", "bounds and rates", "bounds and a rate for each"],
)
@pytest.mark.parametrize("seeds", [(1, 2), pytest.param((3, 4, 5, 6), marks=pytest.mark.long)])
@pytest.mark.parametrize("compiler", WAYS)
def test_a_linear_problem_is_solved_exactly_in_one_iteration(compiler, seeds, rate):
    """Random problems, five starts each, most with several limits active at once."""
    active = 0
    for seed in seeds:
        ocp, rng = linear_ocp(seed, 5 + seed, rate), np.random.default_rng(seed)
        rti = Rti(ocp, compiler=compiler)
        for _ in range(5):
            x0, p = rng.normal(size=ocp.nx) * 2, rng.normal(size=(ocp.stages + 1, 1))
            if rate is not None:
                x0[3:] = rng.uniform(ocp.c_min, ocp.c_max)
            rti.X[:], rti.C[:], rti.active[:] = x0, 0.0, 0.0
            rti.C[:] = 0.0 if rate is None else x0[3:]
            rti.x0[:], rti.p[:] = x0, p
            rti.iterate()
            info = rti.info()
            if not info.settled and compiler is None:
                continue  # the interpreter has no interior point: its caller asks hpipm
            cost, c = dense_optimum(ocp, x0, p)
            assert info.settled and info.defect < 1e-9 and info.excess < 1e-6
            assert info.cost == pytest.approx(cost, rel=1e-7, abs=1e-9)
            assert np.abs(rti.C - c).max() < 1e-4
            active += np.count_nonzero(rti.active)
    assert active > 9 * len(seeds)


@cache
def oracle(name: str) -> tuple[Nlp, ca.Function]:
    nlp = Nlp(boat(None).ocp, rows=name == "fatrop")
    return nlp, nlp.solver(name, expand=True, tolerance=1e-9)


def optimum(name: str, rti: Rti):
    """Cost and commands of a converged solver, from the kernel's own plan."""
    nlp, solver = oracle(name)
    answer = nlp.call(solver, nlp.join(rti.X, rti.C), rti.x0, rti.p, rti.q)
    assert solver.stats()["success"]
    return float(answer["f"]), nlp.split(np.array(answer["x"]).ravel())[1]


@pytest.mark.parametrize("compiler", WAYS)
@pytest.mark.long
def test_repeated_it_ends_where_ipopt_and_fatrop_end(compiler):
    """Seed 21: ten states; cost to 1e-6, first command to 1 mN."""
    rng, rti = np.random.default_rng(21), boat(compiler)
    for _ in range(10):
        near_the_leg(rng, rti)
        for k in range(40):
            rti.damped(1.0 if k < 6 else 0.5)
        info = rti.info()
        for name in ("ipopt", "fatrop"):
            cost, c = optimum(name, rti)
            assert info.cost == pytest.approx(cost, rel=1e-6, abs=1e-9)
            assert np.abs(rti.C[0] - c[0]).max() < 1e-3


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_no_plan_goes_beyond_a_limit(seed):
    """Any state, any reference, any active set to begin with: 1e-6 N, or the kernel says that it did not settle."""
    rti = boat(compile_loops if machine.may_run_what_was_written() else None)
    anywhere(np.random.default_rng(seed), rti)
    for _ in range(3):
        rti.iterate()
        info = rti.info()
        assert not info.settled or info.excess < 1e-6
        if info.settled:
            assert np.all(rti.C - rti.ocp.c_min >= -1e-6) and np.all(rti.C - rti.ocp.c_max <= 1e-6)
            assert np.abs(rti.C - rti.X[:-1, 6:]).max() <= rti.ocp.rate_n + 1e-6


def test_almost_every_program_is_settled():
    """Seed 22: of 300 first iterations from anywhere; one in ten goes round in circles without a second method."""
    rng, rti = np.random.default_rng(22), boat(compile_loops if machine.may_run_what_was_written() else None)
    settled = 0
    for _ in range(300):
        anywhere(rng, rti)
        rti.active[:] = 0.0
        rti.iterate()
        settled += rti.info().settled
    assert settled >= 298
