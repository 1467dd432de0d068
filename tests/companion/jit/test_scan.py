"""Recurrences as machine code: functions of lanes against numpy, any width the same bits, arrays where they are."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.jit import NotCompiled, compile_scan, machine, scan
from companion.jit.elementary import LARGEST_ANGLE

pytest.importorskip("llvmlite", reason="llvmlite is not installed")
if not machine.may_run_what_was_written():
    pytest.skip("the system forbids machine code", allow_module_level=True)

A, B, C, Q = (ca.SX.sym(name) for name in "abcq")
NOTHING = np.zeros((1, 1))


def _shares(a, b):
    return np.sin(-np.arctan2(a, b)) + np.cos(2 * np.arctan2(b, a))


FUNCTIONS = {
    "sin": (ca.sin(A), lambda a, b: np.sin(a)), "cos": (ca.cos(A), lambda a, b: np.cos(a)),
    "exp": (ca.exp(A), lambda a, b: np.exp(a)), "log": (ca.log(ca.fabs(A)), lambda a, b: np.log(np.abs(a))),
    "atan2": (ca.atan2(A, B), np.arctan2), "cube": (A**3, lambda a, b: a**3),
    "pow": (ca.fabs(A) ** B, lambda a, b: np.abs(a) ** b), "root": (ca.fabs(A) ** 0.65, lambda a, b: np.abs(a) ** 0.65),
    "whole": (A ** ca.floor(B), lambda a, b: a ** np.floor(b)), "third": (A / 3.0, lambda a, b: a / 3.0),
    "share": (ca.sin(-ca.atan2(A, B)) + ca.cos(2 * ca.atan2(B, A)), _shares),
    "tanh": (ca.tanh(A), lambda a, b: np.tanh(a)), "fused": (A * B - B, lambda a, b: a * b - b),
}  # fmt: skip


@pytest.fixture(scope="module")
def functions():
    outputs = ca.vertcat(*(expression for expression, _ in FUNCTIONS.values()))
    return compile_scan(ca.Function("f", [C, Q, ca.vertcat(A, B)], [C, outputs]))


def applied(loop, pairs):
    rows = np.empty((1, len(pairs), len(FUNCTIONS)))
    loop(np.zeros((1, 1)), NOTHING, [np.array(pairs, dtype=float)[None]], rows)
    return dict(zip(FUNCTIONS, rows[0].T, strict=True))


@pytest.mark.parametrize("size", [1e-3, 1.0, 30.0, 1e3])
def test_functions_of_lanes_are_numpys(functions, size):
    """Seed 1; numpy in extended precision. a^b = exp(b log a) loses digits as |b log a| grows."""
    pairs = np.random.default_rng(1).normal(size=(4000, 2)) * size
    got = applied(functions, pairs)
    a, b = pairs.T.astype(np.longdouble)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        for name, (_, told) in FUNCTIONS.items():
            want = told(a, b).astype(float)
            exponent = np.abs(b * np.log(np.abs(a))).astype(float) if name in ("pow", "whole") else 0.0
            usual = np.isfinite(want) & (np.abs(want) > 1e-300)
            scale = np.abs(a * b).astype(float) if name == "fused" else 4.0 * (name == "share")
            slack = (2e-15 + 3e-16 * exponent) * np.abs(want) + 3e-16 * scale
            assert (np.abs(got[name] - want) <= slack)[usual].all(), name
            assert (got[name] == want)[np.isinf(want)].all(), name


@given(st.floats(allow_nan=True, width=64), st.floats(allow_nan=True, width=64))
@settings(max_examples=300, deadline=None)
def test_functions_of_lanes_answer_anything_as_the_c_library_does(functions, a, b):
    """But for what the module says: angles beyond FAR, subnormals, powers of and to infinities."""
    got = {name: values[0] for name, values in applied(functions, [(a, b)]).items()}
    with np.errstate(all="ignore"):
        for name in ("sin", "cos", "exp", "log", "atan2", "root"):
            want = float(FUNCTIONS[name][1](np.float64(a), np.float64(b)))
            if (name in ("sin", "cos") and abs(a) > LARGEST_ANGLE) or (name == "atan2" and np.isinf(a) and np.isinf(b)):
                assert np.isnan(got[name])
            elif name == "exp" and a < -708.0:
                assert got[name] == 0.0
            else:
                assert got[name] == pytest.approx(want, rel=2e-13, nan_ok=True), name


def spring():
    """A nonlinear oscillator with a constant and two series; the row is not the carry."""
    x, q, u, w = ca.SX.sym("x", 2), ca.SX.sym("q", 2), ca.SX.sym("u"), ca.SX.sym("w")
    force = u - q[0] * ca.sin(x[0]) - q[1] * ca.fabs(x[1]) * x[1] / (1 + ca.exp(w))
    after = ca.vertcat(x[0] + 0.1 * x[1], x[1] + 0.1 * force / q[1])
    return ca.Function("spring", [x, q, u, w], [after, ca.vertcat(after[0], force, 3.0)])


def stepped(x, q, u, w):
    """The same in CasADi, one by one."""
    function, rows = spring(), np.empty((len(x), u.shape[1], 3))
    for i in range(len(x)):
        for k in range(u.shape[1]):
            x[i], rows[i, k] = (np.array(v).ravel() for v in function(x[i], q[i], u[i, k], w[min(i, len(w) - 1), 0]))
    return rows


def drawn(m, count, seed=2):
    rng = np.random.default_rng(seed)
    x, q = rng.normal(size=(m, 2)), rng.uniform(0.5, 2.0, (m, 2))
    return x, q, rng.normal(size=(m, count, 1)), rng.normal(size=(1, 1, 1))


@pytest.mark.parametrize("m", [1, 2, 3, 8, 11])
def test_a_loop_is_the_function_again_and_again(m):
    x, q, u, w = drawn(m, 50)
    want_x, rows = x.copy(), np.empty((m, 50, 3))
    want = stepped(want_x, q, u, w)
    compile_scan(spring())(x, q, [u, w], rows)
    np.testing.assert_allclose(rows, want, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(x, want_x, rtol=1e-11, atol=1e-13)


def test_every_width_gives_the_same_bits(monkeypatch):
    """Seed 2. One after the other in narrow code, all in wide code, and the wide code of four."""
    results = []
    for lanes, together in ((8, False), (8, True), (4, True)):
        monkeypatch.setattr(scan, "LANES", lanes)
        loop, (x, q, u, w) = compile_scan(spring()), drawn(13, 200)
        rows = np.empty((13, 200, 3))
        for part in [slice(0, 13)] if together else [slice(i, i + 1) for i in range(13)]:
            mine = x[part]
            loop(mine, q[part], [u[part], w], rows[part])
            x[part] = mine
        results.append((rows, x))
    for rows, x in results[1:]:
        np.testing.assert_array_equal(rows, results[0][0])
        np.testing.assert_array_equal(x, results[0][1])


def test_rows_may_lie_in_a_larger_array_and_nothing_else_is_touched():
    x, q, u, w = drawn(3, 20)
    large = np.full((5, 22, 3), 7.0)
    compile_scan(spring())(x, q, [u, w], large[1:4, 1:21])
    outside = np.ones(large.shape, dtype=bool)
    outside[1:4, 1:21] = False
    assert (large[outside] == 7.0).all()
    assert (large[1:4, 1:21, 2] == 3.0).all()
    compile_scan(spring())(x, q, [u[:, :0], w], large[1:4, :0])
    assert (large[outside] == 7.0).all()


def test_an_operation_without_counterpart_is_refused():
    with pytest.raises(NotCompiled, match="no counterpart"):
        compile_scan(ca.Function("f", [C, Q, A], [ca.erf(C), A]))
