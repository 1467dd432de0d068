"""CasADi functions on many instants at once against single evaluations, by machine code and by interpreter."""

import casadi as ca
import numpy as np
import pytest

from companion.jit import NotCompiled
from sim.fitting.engine.batched import Batch, Rollout
from sim.trajectory import loops

ways = pytest.mark.parametrize("machine", [True, False], ids=["machine code", "interpreter"])


@pytest.fixture(autouse=True)
def anew(monkeypatch, tmp_path):
    monkeypatch.setenv("ARITRA_CACHE", str(tmp_path))
    loops.loop.cache_clear()
    yield
    loops.loop.cache_clear()


def choose(machine, monkeypatch):
    def none(*_, **__):
        raise NotCompiled("none here")

    if not machine:
        monkeypatch.setattr(loops, "compile_scan", none)


@ways
@pytest.mark.parametrize("count", [1, 7, 8, 9, 50])
def test_a_batch_is_its_function_column_by_column(machine, count, monkeypatch):
    choose(machine, monkeypatch)
    a, b = ca.SX.sym("a", 3), ca.SX.sym("b")
    function = ca.Function("f", [a, b], [ca.sin(a) * b, a[0] / (1 + b**2)])
    batch, rng = Batch(function, count), np.random.default_rng(count)
    for _ in range(2):
        given = rng.normal(size=(count, 3)), rng.normal(size=(count, 1))
        found = [np.array(out) for out in batch(*given)]
        for k in range(count):
            for one, out in zip(function(given[0][k], given[1][k]), found, strict=True):
                assert out[k] == pytest.approx(np.array(one).ravel(), rel=1e-13, abs=1e-15)


@ways
@pytest.mark.parametrize("windows", [1, 3, 20])
def test_a_rollout_is_its_step_again_and_again(machine, windows, monkeypatch):
    choose(machine, monkeypatch)
    x, q, u, h = ca.SX.sym("x", 2), ca.SX.sym("q"), ca.SX.sym("u"), ca.SX.sym("h")
    step = ca.Function("step", [x, q, u, h], [x + h * ca.vertcat(x[1], u - q * ca.sin(x[0]))])
    rng = np.random.default_rng(windows)
    start, constants = rng.normal(size=(windows, 2)), rng.uniform(0.5, 2, (windows, 1))
    series = rng.normal(size=(windows, 12, 1)), rng.uniform(0.01, 0.1, (windows, 12, 1))
    before = start.copy()
    found = Rollout(step)(start, constants, *series)
    assert np.array_equal(start, before) and found.shape == (windows, 12, 2)
    for w in range(windows):
        now = start[w]
        for k in range(12):
            now = np.array(step(now, constants[w], *(s[w, k] for s in series))).ravel()
            assert found[w, k] == pytest.approx(now, rel=1e-12, abs=1e-14)


def test_the_same_function_is_compiled_once():
    a = ca.SX.sym("a", 2)
    for count in (3, 30):
        Batch(ca.Function("f", [a], [ca.cos(a)]), count)
    assert loops.loop.cache_info().misses == 1
