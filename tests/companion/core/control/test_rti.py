"""The real-time iteration: its quadratic program against a dense oracle, its plans against IPOPT and fatrop,
its limits, its two ways to be evaluated, its memory.
"""

import gc
import tracemalloc
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.control.nmpc import Actuation, NmpcSettings
from companion.core.control.nmpc.production import production
from companion.core.control.ocp import Ocp
from companion.core.control.rti.iteration import Rti
from companion.core.control.rti.loops import Compiler
from companion.core.guidance.reference_row import Column, near
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import configuration_matrix
from companion.jit import compile_loops, machine
from sim.bench.controller.nlp import Nlp
from sim.bench.controller.paper_problem import paper_ocp
from sim.fitting.taylor.abkowitz import AbkowitzModel
from tests.companion.core.control.nmpc_world import leg_rows, variant

S = NmpcSettings()
WAYS = [
    pytest.param(compile_loops, id="compiled", marks=pytest.mark.skipif(
        not machine.may_run_what_was_written(), reason="the system forbids machine code")),
    pytest.param(None, id="interpreted"),
]  # fmt: skip


def linear_ocp(seed: int, stages: int, rate: bool) -> Ocp:
    """A random linear problem, 3 controls, with or without forces as states: one iteration must solve it exactly."""
    rng = np.random.default_rng(seed)
    n, m = (6, 3) if rate else (4, 3)
    x, c, p = ca.SX.sym("x", n), ca.SX.sym("c", m), ca.SX.sym("p", 1)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    if rate:
        A[3:], B[3:] = np.hstack([np.zeros((3, 3)), np.eye(3) * 0.2]), np.eye(3) * 0.8
    following = ca.DM(A) @ x + ca.DM(B) @ c + p * ca.DM(rng.normal(size=n) * 0.1)
    weight = rng.normal(size=(n, n))
    J = ca.jacobian(following, ca.vertcat(x, c))
    return Ocp(
        stages, x, c, p, ca.SX.sym("q", 0), following, J,
        residual=ca.vertcat(ca.DM(weight) @ x - 0.3, 0.3 * (c - 0.1)), last=2 * ca.DM(weight) @ x,
        c_min=np.full(m, -1.0), c_max=np.array([1.0, 0.5, 1.5]), scale=np.ones(n),
        forces=3 if rate else None, rate_n=0.4 if rate else np.inf,
    )  # fmt: skip


def dense_optimum(ocp: Ocp, x0, p):
    """The same problem by qpOASES, a dense active-set method, on all variables at once: cost, controls."""
    nlp = Nlp(ocp)
    solver = ca.qpsol("oracle", "qpoases", nlp.problem, {"printLevel": "none", "print_time": False})
    answer = nlp.call(solver, np.zeros(nlp.low.size), x0, p, np.zeros(0))
    assert solver.stats()["success"]
    return float(answer["f"]), nlp.split(np.array(answer["x"]).ravel())[1]


@pytest.mark.parametrize("rate", [False, True], ids=["bounds", "bounds and rates"])
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
            if rate:
                x0[3:] = rng.uniform(ocp.c_min, ocp.c_max)
            rti.X[:], rti.C[:], rti.active[:] = x0, 0.0, 0.0
            rti.C[:] = x0[3:] if rate else 0.0
            rti.x0[:], rti.p[:] = x0, p
            rti.iterate()
            came = rti.came()
            if not came.settled and compiler is None:
                continue  # the interpreter has no interior point: its caller asks hpipm
            cost, c = dense_optimum(ocp, x0, p)
            assert came.settled and came.defect < 1e-9 and came.excess < 1e-6
            assert came.cost == pytest.approx(cost, rel=1e-7, abs=1e-9)
            assert np.abs(rti.C - c).max() < 1e-4
            active += np.count_nonzero(rti.active)
    assert active > 9 * len(seeds)


@cache
def boat(compiler: Compiler | None, thrusters: int = 4) -> Rti:
    vessel = variant(thrusters)
    return Rti(production(StructuredModel.of(vessel), Actuation.of(vessel), S), compiler=compiler)


@cache
def oracle(name: str) -> tuple[Nlp, ca.Function]:
    nlp = Nlp(boat(None).ocp, rows=name == "fatrop")
    return nlp, nlp.solver(name, expand=True, tolerance=1e-9)


def near_the_leg(rng, rti: Rti):
    """Anywhere a boat may be on its way along a leg; guess: standing still."""
    x0 = np.r_[rng.normal(size=2), rng.normal() * 0.6, 0.4 + rng.normal() * 0.2, rng.normal(size=2) * 0.1,
               rng.uniform(-10, 10, 4)]  # fmt: skip
    rows = leg_rows(x0, S, angle=rng.normal() * 0.3)
    rows[:, Column.PSI] = near(rows[:, Column.PSI], x0[2])
    d = rng.normal(size=3) * (1.0, 1.0, 0.2)
    rti.X[:], rti.C[:], rti.active[:], rti.shift[0] = x0, x0[6:], 0.0, 0.0
    rti.x0[:], rti.p[:], rti.q[:] = x0, rows, d
    return x0, rows, d


def optimum(name: str, rti: Rti):
    """Cost and commands of a converged solver, from the kernel's own plan."""
    nlp, solver = oracle(name)
    answer = nlp.call(solver, nlp.join(rti.X, rti.C), rti.x0, rti.p, rti.q)
    assert solver.stats()["success"]
    return float(answer["f"]), nlp.split(np.array(answer["x"]).ravel())[1]


@pytest.mark.parametrize("compiler", WAYS)
def test_repeated_it_ends_where_ipopt_and_fatrop_end(compiler):
    """Seed 21: ten states; cost to 1e-6, first command to 1 mN."""
    rng, rti = np.random.default_rng(21), boat(compiler)
    for _ in range(10):
        near_the_leg(rng, rti)
        for k in range(40):
            rti.damped(1.0 if k < 6 else 0.5)
        came = rti.came()
        for name in ("ipopt", "fatrop"):
            cost, c = optimum(name, rti)
            assert came.cost == pytest.approx(cost, rel=1e-6, abs=1e-9)
            assert np.abs(rti.C[0] - c[0]).max() < 1e-3


def anywhere(rng, rti: Rti):
    """States, references and disturbances without any sense, forces within their limits."""
    ocp = rti.ocp
    x0 = np.r_[rng.uniform(-20, 20, 2), rng.uniform(-7, 7), rng.uniform(-1, 1, 3) * (1.5, 0.7, 1.5),
               rng.uniform(ocp.c_min, ocp.c_max)]  # fmt: skip
    rows = leg_rows(x0, S, angle=rng.uniform(-4, 4), start=x0[:2] + rng.normal(size=2) * 3, u=rng.uniform(0, 1))
    rows[:, Column.PSI], rows[:, Column.STATION] = near(rows[:, Column.PSI], x0[2]), rng.integers(2)
    rti.X[:], rti.C[:], rti.active[:] = x0, x0[6:], rng.integers(-2, 3, size=rti.C.shape)
    rti.x0[:], rti.p[:], rti.q[:] = x0, rows, rng.normal(size=3) * (3.0, 3.0, 0.5)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_no_plan_goes_beyond_a_limit(seed):
    """Any state, any reference, any active set to begin with: 1e-6 N, or the kernel says that it did not settle."""
    rti = boat(compile_loops if machine.may_run_what_was_written() else None)
    anywhere(np.random.default_rng(seed), rti)
    for _ in range(3):
        rti.iterate()
        came = rti.came()
        assert not came.settled or came.excess < 1e-6
        if came.settled:
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
        settled += rti.came().settled
    assert settled >= 298


@pytest.mark.parametrize("thrusters", [2, 4, 6])
@pytest.mark.skipif(not machine.may_run_what_was_written(), reason="the system forbids machine code")
def test_both_ways_give_the_same_numbers(thrusters):
    """Seed 23."""
    rng = np.random.default_rng(23)
    quick, slow = boat(compile_loops, thrusters), boat(None, thrusters)
    compared = 0
    for _ in range(40):
        anywhere(rng, quick)
        for name in ("X", "C", "x0", "p", "q", "active", "shift"):
            getattr(slow, name)[:] = getattr(quick, name)
        quick.iterate()
        slow.iterate()
        if slow.came().settled and quick.came().settled:
            compared += 1
            scale = 1 + np.abs(quick.X).max()
            assert np.abs(quick.X - slow.X).max() < 1e-8 * scale and np.abs(quick.C - slow.C).max() < 1e-7 * scale
            assert quick.came().cost == pytest.approx(slow.came().cost, rel=1e-8)
    assert compared > 25


def test_a_dead_thruster_stays_dead():
    vessel = variant(4)
    limits = Actuation.of(vessel)
    limits.force_min_n[1] = limits.force_max_n[1] = 0.0
    rti = Rti(production(StructuredModel.of(vessel), limits, S), compiler=compile_loops)
    rng = np.random.default_rng(24)
    x0, _, _ = near_the_leg(rng, rti)
    x0[7] = 0.0
    rti.x0[7] = rti.X[:, 7] = rti.C[:, 1] = 0.0
    for _ in range(5):
        rti.iterate()
    assert rti.came().settled and np.abs(rti.C[:, 1]).max() < 1e-9 and np.abs(rti.C[:, 0]).max() > 0.1


@pytest.mark.parametrize("compiler", WAYS)
def test_preparation_needs_no_state(compiler):
    """prepare, then the state, then feedback: the same as all at once."""
    rti, rng = boat(compiler), np.random.default_rng(25)
    x0, _, _ = near_the_leg(rng, rti)
    guess = rti.X.copy(), rti.C.copy()
    rti.prepare()
    rti.feedback()
    at_once = rti.C.copy()
    rti.X[:], rti.C[:] = guess
    rti.active[:] = 0.0
    rti.x0[:] = np.nan
    rti.prepare()
    rti.x0[:] = x0
    rti.feedback()
    assert np.array_equal(rti.C, at_once)


@pytest.mark.skipif(not machine.may_run_what_was_written(), reason="the system forbids machine code")
def test_the_feedback_allocates_nothing():
    """Seen from Python (tracemalloc); the machine code has no call that could allocate, which the next test sees to."""
    rti = boat(compile_loops)
    near_the_leg(np.random.default_rng(26), rti)
    rti.prepare()
    for _ in range(3):
        rti.feedback()
    gc.collect()
    gc.disable()
    tracemalloc.start()
    try:
        before = tracemalloc.take_snapshot()
        for _ in range(1000):
            rti.feedback()
        after = tracemalloc.take_snapshot()
    finally:
        tracemalloc.stop()
        gc.enable()
    changes = after.compare_to(before, "filename")
    grown = [s for s in changes if s.size_diff > 0 and "tracemalloc" not in str(s.traceback)]
    assert sum(s.size_diff for s in grown) < 2000, grown


def test_the_machine_code_calls_nothing_but_mathematics(monkeypatch):
    texts, real = [], machine.module
    monkeypatch.setattr(machine, "module", lambda entries: texts.append(real(entries)) or texts[-1])
    vessel = variant(2)
    Rti(production(StructuredModel.of(vessel), Actuation.of(vessel), NmpcSettings(stages=5)), compiler=compile_loops)
    outside = [line for line in texts[0].splitlines() if line.startswith("declare") and "@llvm." not in line]
    assert texts and not outside and "alloca" not in texts[0]


@pytest.mark.parametrize("compiler", WAYS)
def test_nonsense_ends_with_a_status_too(compiler):
    rti = boat(compiler)
    for value in (np.nan, np.inf, 1e300):
        near_the_leg(np.random.default_rng(27), rti)
        rti.X[3, 4] = value
        rti.solve()
        came = rti.came()
        assert not (came.sane and came.settled and came.defect < 1.0)
    near_the_leg(np.random.default_rng(27), rti)
    rti.solve()
    assert rti.came().sane


@pytest.mark.parametrize("compiler", WAYS)
def test_the_papers_problem_too(compiler):
    """From its equilibrium, a heading step of 0.2 rad: IPOPT's cost and thrust."""
    ocp = paper_ocp(AbkowitzModel(configuration_matrix(variant(4)), 0.1))
    rti, nlp = Rti(ocp, compiler=compiler), Nlp(ocp)
    rti.X[:] = rti.x0[:] = (0.0, 0.5, 0.0, 0.0)
    rti.p[:] = 0.2
    for _ in range(12):
        rti.iterate()
    solver = nlp.solver("ipopt", tolerance=1e-9)
    answer = nlp.call(solver, nlp.join(rti.X, rti.C), rti.x0, rti.p, rti.q)
    assert rti.came().cost == pytest.approx(float(answer["f"]), rel=1e-6)
    assert np.abs(rti.C - nlp.split(np.array(answer["x"]).ravel())[1]).max() < 1e-3


@pytest.mark.parametrize("thrusters", [2, 4, 6])
def test_the_jacobian_is_that_of_casadi(thrusters):
    """Seed 28."""
    ocp, rng = boat(None, thrusters).ocp, np.random.default_rng(28)
    own = ca.jacobian(ocp.following, ca.vertcat(ocp.x, ocp.c))
    both = ca.Function("both", [ocp.x, ocp.c, ocp.q], [ocp.jacobian, own])
    for _ in range(20):
        ours, theirs = both(rng.normal(size=ocp.nx), rng.normal(size=ocp.nu) * 10, rng.normal(size=3))
        assert np.array(ours) == pytest.approx(np.array(theirs), rel=1e-9, abs=1e-12)
