"""The real-time iteration as machine code: the same numbers, no allocation, a status for nonsense."""

import gc
import tracemalloc

import casadi as ca
import numpy as np
import pytest

from companion.core.control.nmpc import Actuation, NmpcSettings
from companion.core.control.nmpc.production import production
from companion.core.control.rti.iteration import Rti
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import configuration_matrix
from companion.jit import compile_loops, machine
from sim.bench.controller.nlp import Nlp
from sim.bench.controller.paper_problem import paper_ocp
from sim.fitting.taylor.abkowitz import AbkowitzModel
from tests.companion.core.control.nmpc_world import variant
from tests.companion.core.control.rti_fixture import WAYS, S, anywhere, boat, near_the_leg


@pytest.mark.parametrize("thrusters", [2, 4, 6])
@pytest.mark.skipif(not machine.may_run_what_was_written(), reason="the system forbids machine code")
@pytest.mark.long
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
        if slow.info().settled and quick.info().settled:
            compared += 1
            scale = 1 + np.abs(quick.X).max()
            assert np.abs(quick.X - slow.X).max() < 1e-8 * scale and np.abs(quick.C - slow.C).max() < 1e-7 * scale
            assert quick.info().cost == pytest.approx(slow.info().cost, rel=1e-8)
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
    assert rti.info().settled and np.abs(rti.C[:, 1]).max() < 1e-9 and np.abs(rti.C[:, 0]).max() > 0.1


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
        info = rti.info()
        assert not (info.sane and info.settled and info.defect < 1.0)
    near_the_leg(np.random.default_rng(27), rti)
    rti.solve()
    assert rti.info().sane


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
    assert rti.info().cost == pytest.approx(float(answer["f"]), rel=1e-6)
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
