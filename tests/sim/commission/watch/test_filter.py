"""Belief and likelihood in information form, against covariance formulas by another way."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from sim.commission.watch.filter import Belief, Likelihood

seeds = st.integers(0, 2**32 - 1)
N = 4


def spd(rng: np.random.Generator, n: int = N) -> np.ndarray:
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.3 * np.eye(n)


def measured(rng: np.random.Generator, rows: int) -> tuple[np.ndarray, np.ndarray, Likelihood]:
    """H, y of y = H theta + noise of unit variance, and the same as a likelihood."""
    H, y = rng.normal(size=(rows, N)), rng.normal(size=rows)
    return H, y, Likelihood(H.T @ H, H.T @ y)


@given(seeds, st.integers(1, 6))
def test_an_update_is_that_of_a_kalman_filter(seed, rows):
    rng = np.random.default_rng(seed)
    H, y, seen = measured(rng, rows)
    m, P = rng.normal(size=N), spd(rng)
    after = Belief(m, P).after(seen)
    S = H @ P @ H.T + np.eye(rows)
    K = P @ H.T @ np.linalg.inv(S)
    np.testing.assert_allclose(after.mean, m + K @ (y - H @ m), atol=1e-8)
    np.testing.assert_allclose(after.covariance, P - K @ H @ P, atol=1e-8)


@given(seeds, st.integers(1, 6))
def test_evidence_between_two_beliefs_is_the_ratio_of_the_probabilities_of_the_data(seed, rows):
    rng = np.random.default_rng(seed)
    H, y, seen = measured(rng, rows)

    def exact(m, P):
        return multivariate_normal(H @ m, H @ P @ H.T + np.eye(rows)).logpdf(y)

    one, other = ((rng.normal(size=N), spd(rng)) for _ in range(2))
    ours = Belief(*one).after(seen).log_p - Belief(*other).after(seen).log_p
    assert ours == pytest.approx(exact(*one) - exact(*other), abs=1e-6)


@given(seeds, st.integers(1, 3), st.floats(1.0, 5.0))
def test_weighing_adds_to_the_covariance_also_where_a_log_says_nothing_of_some_direction(seed, rows, scale):
    rng = np.random.default_rng(seed)
    H, y, seen = measured(rng, rows)  # of rank below N
    error = rng.uniform(0.0, 2.0, N)
    m, P = rng.normal(size=N), spd(rng)
    ours = Belief(m, P).after(seen.weighed(scale, error))
    noise = scale * np.eye(rows) + H @ np.diag(error) @ H.T
    S = H @ P @ H.T + noise
    np.testing.assert_allclose(ours.mean, m + P @ H.T @ np.linalg.solve(S, y - H @ m), atol=1e-7)


@given(seeds)
def test_surprise_is_the_squared_innovation_over_its_dimension(seed):
    rng = np.random.default_rng(seed)
    H, y, seen = measured(rng, N)
    assume(np.linalg.cond(H) < 1e4)  # else a direction counts as not seen at all
    m, P = rng.normal(size=N), spd(rng)
    e = np.linalg.solve(H, y) - m
    expected = e @ np.linalg.solve(np.linalg.inv(H.T @ H) + P, e) / N
    assert Belief(m, P).surprise(seen) == pytest.approx(expected, rel=1e-5)


def test_a_step_is_found_where_there_is_one():
    d = np.array([0.0, 1.0, 0.0, 0.0])
    belief = Belief(np.zeros(N), 1e-4 * np.eye(N)).with_step(0.5)
    A = np.column_stack([np.eye(N), d])
    seen = Likelihood(1e6 * np.eye(N), 1e6 * 0.3 * d)
    after = belief.after(seen.through(A))
    assert after.mean[-1] == pytest.approx(0.3, abs=0.01)
    np.testing.assert_allclose(after.through(A).mean, 0.3 * d, atol=1e-3)
