"""The study's other ways to machine code mean what ours means: a comparison of wrong code would compare nothing."""

import shutil

import casadi as ca
import numpy as np
import pytest

from companion.core.control.rti.loops import Kernel, Loop, Operand, Repeat, over_stages
from companion.jit import machine
from sim.studies.machine_code.ways import COMPILERS, SCANS

pytest.importorskip("llvmlite", reason="llvmlite is not installed")
pytest.importorskip("numba", reason="numba is not installed")
if not machine.may_run_what_was_written():
    pytest.skip("the system forbids machine code", allow_module_level=True)

A, B = ca.SX.sym("a"), ca.SX.sym("b")
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
OTHERS = ["numba", pytest.param("loops in C", marks=needs_gcc)]


@pytest.fixture(autouse=True)
def anew(monkeypatch, tmp_path):
    monkeypatch.setenv("ARITRA_CACHE", str(tmp_path))


def ran(way: str) -> np.ndarray:
    """11 lanes of a function by eights, summed up again and again until the sum is past a bound."""
    f = ca.Function("f", [ca.vertcat(A, B)], [ca.if_else(A < B, ca.sin(A) ** 2 / B, ca.fmax(A, 0.1) ** 1.7 - B)])
    each = Kernel(f, [Operand(0, 2, (0, 1), 2)], [Operand(22, 1, (0,), 1)], 8)
    total = ca.Function("total", [A, B], [A + ca.fabs(B)])
    add = Kernel(total, [Operand(33, 0, (0,)), Operand(22, 1, (0,))], [Operand(33, 0, (0,))])
    on = Kernel(ca.Function("on", [A], [A < 20.0]), [Operand(33, 0, (0,))], [Operand(34, 0, (0,))])
    memory = np.concatenate([np.random.default_rng(1).normal(size=22), np.zeros(12), [1.0]])
    compiler = COMPILERS[way]()
    assert compiler is not None
    run = compiler({"all": [over_stages([each], 11), Repeat([Loop([add], 11, 10, -1), Loop([on], 1)], 34, 50)]}, memory)
    memory[33:] = 0.0, 1.0
    run["all"]()
    return memory


@pytest.mark.parametrize("way", OTHERS)
def test_loops_mean_the_same(way):
    want = ran("emitter")
    assert want[33] >= 20.0 and want[34] == 0.0
    np.testing.assert_allclose(ran(way), want, rtol=1e-13)


@pytest.mark.parametrize("way", [*OTHERS, "emitter, C library's functions", "interpreter"])
def test_a_recurrence_means_the_same(way):
    x, q, u = ca.SX.sym("x", 2), ca.SX.sym("q"), ca.SX.sym("u")
    after = ca.vertcat(x[0] + 0.1 * x[1], x[1] - 0.1 * (ca.sin(x[0]) * q + ca.atan2(u, 2.0)))
    function, rng, found = ca.Function("f", [x, q, u], [after, after[0] * 2]), np.random.default_rng(2), []
    start, constants, series = rng.normal(size=(3, 2)), rng.normal(size=(3, 1)), rng.normal(size=(3, 20, 1))
    for name in ("emitter", way):
        carry, rows = start.copy(), np.empty((3, 20, 1))
        SCANS[name](function)(carry, constants, [series], rows)
        found.append(np.concatenate([carry.ravel(), rows.ravel()]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-11, atol=1e-13)
