"""Machine code from CasADi expressions against CasADi itself: every operation, loops, lanes, the store."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.control.rti.loops import Fetch, Kernel, Loop, NotCompiled, Operand, Repeat, over_stages
from companion.jit import compile_loops, machine

pytest.importorskip("llvmlite", reason="llvmlite is not installed")

A, B = ca.SX.sym("a"), ca.SX.sym("b")
OPERATIONS = {
    "add": A + B, "sub": A - B, "mul": A * B, "div": A / B, "neg": -A, "sq": A**2, "twice": 2 * A, "inv": 1 / A,
    "sqrt": ca.sqrt(ca.fabs(A)), "abs": ca.fabs(A), "sign": ca.sign(A), "floor": ca.floor(A), "ceil": ca.ceil(A),
    "sin": ca.sin(A), "cos": ca.cos(A), "tan": ca.tan(A), "asin": ca.asin(ca.sin(A)), "acos": ca.acos(ca.cos(A)),
    "atan": ca.atan(A), "atan2": ca.atan2(A, B), "sinh": ca.sinh(A), "cosh": ca.cosh(A), "tanh": ca.tanh(A),
    "exp": ca.exp(A), "log": ca.log(ca.fabs(A)), "pow": ca.fabs(A) ** B, "constpow": ca.fabs(A) ** 1.7,
    "min": ca.fmin(A, B), "max": ca.fmax(A, B), "copysign": ca.copysign(A, B), "if": ca.if_else(A < B, A, B),
    "le": A <= B, "eq": ca.eq(A, B), "ne": ca.ne(A, B), "and": ca.logic_and(A > 0, B > 0),
    "or": ca.logic_or(A > 0, B > 0), "not": ca.logic_not(A > 0), "constant": ca.SX(3.25) + 0 * A,
}  # fmt: skip


def run(function, values, width):
    """`function` of each row of `values` by machine code, and by CasADi."""
    count, wide, high = len(values), function.size1_in(0), function.size1_out(0)
    memory = np.concatenate([values.ravel(), np.zeros(count * high)])
    lane = (wide, high) if width > 1 else (None, None)
    kernel = Kernel(
        function,
        [Operand(0, wide, range(wide), lane[0])],
        [Operand(values.size, high, range(high), lane[1])],
        width,
    )  # fmt: skip
    compile_loops({"all": [over_stages([kernel], count)]}, memory)["all"]()
    return memory[values.size :].reshape(count, high), np.array(function.map(count)(values.T)).T


@pytest.mark.parametrize("width", [1, 4, 8])
def test_every_operation_means_what_casadi_means(width):
    """Seed 1. 21 is no multiple of the lanes: the last ones overlap."""
    rng = np.random.default_rng(1)
    values = np.vstack([rng.normal(size=(17, 2)) * 3, [[1, 1], [0.5, -0.5], [-2, 2], [1e6, -1e-6]]])
    function = ca.Function("f", [ca.vertcat(A, B)], [ca.densify(ca.vertcat(*OPERATIONS.values()))])
    ours, theirs = run(function, values, width)
    for k, name in enumerate(OPERATIONS):
        assert ours[:, k] == pytest.approx(theirs[:, k], rel=1e-12, abs=1e-13, nan_ok=True), name


@given(st.lists(st.floats(-1e3, 1e3), min_size=8, max_size=8), st.integers(0, 1))
@settings(max_examples=10, deadline=None)
def test_a_matrix_product_is_that_of_numpy(numbers, transposed):
    M = np.array(numbers).reshape(2, 4)
    x = ca.SX.sym("x", 8)
    left = ca.reshape(x, 4, 2).T
    product = left @ left.T if not transposed else left.T @ left
    ours, _ = run(ca.Function("f", [x], [ca.vec(product)]), M.reshape(1, 8), 1)
    expected = M @ M.T if not transposed else M.T @ M
    assert ours.reshape(expected.shape) == pytest.approx(expected.T, rel=1e-12, abs=1e-9)


def counting(most):
    """memory[0] counts up to 3 in steps of 1, then memory[1], the flag, is nil."""
    n = ca.SX.sym("n")
    step = ca.Function("step", [n], [n + 1, ca.SX(n + 1 < 3)])
    kernel = Kernel(step, [Operand(0, 0, (0,))], [Operand(0, 0, (0,)), Operand(1, 0, (0,))])
    memory = np.array([0.0, 1.0])
    compile_loops({"count": [Repeat([Loop([kernel], 1)], 1, most)]}, memory)["count"]()
    return memory.tolist()


def test_a_repeat_ends_with_its_flag_or_its_count():
    assert counting(10) == [3.0, 0.0]
    assert counting(2) == [2.0, 1.0]


def test_a_loop_runs_backwards():
    """Fibonacci from the end of the array to its beginning: each step needs the two before."""
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    kernel = Kernel(
        ca.Function("f", [a, b], [a + b]),
        [Operand(1, 1, (0,)), Operand(2, 1, (0,))],
        [Operand(0, 1, (0,))],
    )
    memory = np.zeros(10)
    memory[8:] = 1.0
    compile_loops({"all": [Loop([kernel], 8, 7, -1)]}, memory)["all"]()
    assert memory.tolist() == [55.0, 34.0, 21.0, 13.0, 8.0, 5.0, 3.0, 2.0, 1.0, 1.0]


@pytest.mark.parametrize("end", [0, 1])
def test_calling_code_into_the_cache_changes_no_number(end):
    """Up to the second kernel, and up to the first: then there is nothing to call."""
    kernels = [Kernel(ca.Function("f", [A], [A * 3 + k]), [Operand(0, 1, (0,))], [Operand(4, 1, (0,))]) for k in (0, 1)]
    memory = np.arange(8.0)
    steps = [Loop(kernels[:1], 4), Loop(kernels[1:], 2)]
    compile_loops({"all": [Fetch(kernels[end]), *steps]}, memory)["all"]()
    assert memory[4:].tolist() == [1.0, 4.0, 6.0, 9.0]


class Kept(dict):
    """A store in memory."""

    put = dict.__setitem__
    elsewhere: bytes | None = None

    def made(self, text: str) -> bytes | None:
        return self.elsewhere


def doubling(memory, store=None, factor=2.0):
    a = ca.SX.sym("a")
    kernel = Kernel(ca.Function("f", [a], [factor * a]), [Operand(0, 0, (0,))], [Operand(0, 0, (0,))])
    return compile_loops({"go": [Loop([kernel], 1)]}, memory, store)["go"]


def test_kept_code_is_used_again_and_other_code_is_not_mistaken_for_it(monkeypatch):
    store, memory = Kept(), np.array([1.0])
    doubling(memory, store)()
    assert memory[0] == 2.0 and len(store) == 1
    monkeypatch.setattr("llvmlite.binding.create_pass_builder", lambda *_: pytest.fail("compiled again"))
    doubling(memory, store)()
    assert memory[0] == 4.0
    monkeypatch.undo()
    doubling(memory, store, 3.0)()
    assert memory[0] == 12.0 and len(store) == 2


def test_code_that_the_store_makes_elsewhere_is_taken_and_kept(monkeypatch):
    here, memory = Kept(), np.array([1.0])
    doubling(memory, here)
    elsewhere = Kept()
    elsewhere.elsewhere = next(iter(here.values()))
    monkeypatch.setattr("llvmlite.binding.create_pass_builder", lambda *_: pytest.fail("compiled here"))
    doubling(memory, elsewhere)()
    assert memory[0] == 2.0 and dict(elsewhere) == dict(here)


def test_an_entry_keeps_its_code_and_memory_alive():
    entry = doubling(np.array([1.0]))
    for _ in range(100):
        doubling(np.array([1.0]))
    entry()


def test_where_llvmlite_is_absent_it_says_so(monkeypatch):

    def absent(name, *args, **kwargs):
        raise ImportError(name)

    monkeypatch.setattr(machine.importlib, "import_module", absent)
    with pytest.raises(NotCompiled, match="llvmlite is not installed"):
        doubling(np.array([1.0]))


def test_where_the_system_forbids_it_says_so(monkeypatch):
    monkeypatch.setattr(machine, "may_run_what_was_written", lambda: False)
    with pytest.raises(NotCompiled, match="MemoryDenyWriteExecute"):
        doubling(np.array([1.0]))


def test_an_unknown_operation_is_refused():
    a = ca.SX.sym("a")
    kernel = Kernel(ca.Function("f", [a], [ca.erf(a)]), [Operand(0, 0, (0,))], [Operand(0, 0, (0,))])
    with pytest.raises(NotCompiled, match="no counterpart"):
        compile_loops({"go": [Loop([kernel], 1)]}, np.zeros(1))
