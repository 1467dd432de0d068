"""Covariance of nodes against the dense inverse; correlation of residuals; bins of the pictures."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.fitting.diagnose.report.pictures import means_by_bin
from sim.fitting.diagnose.selection.residual_forces import LAGS, autocorrelation
from sim.fitting.engine.block_tridiagonal import Chain


def chain(W: int, L: int, seed: int) -> tuple[Chain, np.ndarray]:
    """A random chain and its dense Hessian."""
    rng = np.random.default_rng(seed)
    dense = np.zeros((W * L, W * L))
    for w in range(W):
        J = rng.normal(size=(3 * L, (2 if w + 1 < W else 1) * L))
        at = slice(w * L, w * L + J.shape[1])
        dense[at, at] += J.T @ J
    A = np.array([dense[w * L : (w + 1) * L, w * L : (w + 1) * L] for w in range(W)])
    after = [dense[w * L : (w + 1) * L, (w + 1) * L : (w + 2) * L] for w in range(W - 1)]
    nothing = np.zeros((W, L, 0)), np.zeros((0, 0)), np.zeros((W, L)), np.zeros(0)
    return Chain(A, np.array([*after, np.zeros((L, L))]), *nothing), dense


@given(st.integers(1, 6), st.integers(1, 4), st.integers(0, 1000))
def test_covariance_of_nodes_is_that_of_the_dense_inverse(W, L, seed):
    found, dense = chain(W, L, seed)
    inverse = np.linalg.inv(dense)
    wanted = [inverse[w * L : (w + 1) * L, w * L : (w + 1) * L] for w in range(W)]
    assert found.covariance() == pytest.approx(np.array(wanted), rel=1e-6, abs=1e-9)


@given(st.integers(2, 6), st.integers(1, 4), st.integers(0, 1000))
def test_nodes_alone_are_solved_as_the_dense_matrix_has_it(W, L, seed):
    """Oracle: numpy on the whole matrix."""
    found, dense = chain(W, L, seed)
    found.g[:] = np.random.default_rng(seed).normal(size=found.g.shape)
    dz, log_det = found.solve_nodes()
    assert dz.ravel() == pytest.approx(-np.linalg.solve(dense, found.g.ravel()), rel=1e-6, abs=1e-9)
    assert log_det == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-9, abs=1e-9)
    found.A[1] *= -1
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        found.solve_nodes()


class Residuals:
    def __init__(self, channels: np.ndarray, fixes: np.ndarray):
        self.residuals, self.fix_residuals = channels, fixes


def test_correlation_finds_what_hangs_together_and_stands_outliers():
    rng = np.random.default_rng(3)
    white = rng.normal(size=4000)
    slow = np.zeros(4000)
    for k in range(1, 4000):
        slow[k] = 0.8 * slow[k - 1] + 0.6 * white[k]
    gaps = white.copy()
    gaps[::3] = np.nan
    channels = np.stack([slow, white, gaps, np.full(4000, np.nan)], axis=-1).reshape(40, 100, 4)
    wild = rng.normal(size=(300, 2))
    wild[100] = 1e6
    found = autocorrelation(Residuals(channels, wild))  # type: ignore[arg-type]  # stands for a point
    assert found["heading"][:3] == pytest.approx([0.8, 0.64, 0.512], abs=0.06)
    for name in ("yaw rate", "a_x", "north", "east"):
        assert np.abs(found[name]).max() < 0.25
    assert np.isnan(found["a_y"]).all() and len(found["a_y"]) == LAGS


def test_a_bin_with_few_windows_has_no_mean():
    mean, se = means_by_bin(
        np.array([0.1, 0.2, 0.3, 0.4, 1.5]), np.array([1.0, 2.0, 3.0, 2.0, 9.0]), np.array([0.0, 1.0, 2.0])
    )
    assert mean[0] == 2.0 and np.isnan(mean[1]) and np.isnan(se[1])
