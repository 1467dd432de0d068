"""Evidence against closed forms of a linear Gaussian model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from sim.fitting.diagnose.catalogue.effect import ABSENT, TOLERANCE
from sim.fitting.diagnose.posterior.evidence import Prior, ReducedNormalEquations
from tests.sim.fitting.diagnose.posterior_fixture import bench


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 5))
def test_evidence_is_that_of_a_linear_gaussian_model(seed, count):
    """Oracle: scipy's density of y = J theta + e with theta and e normal."""
    rng = np.random.default_rng(seed)
    J, y = rng.normal(size=(8, count)), rng.normal(size=8)
    sigma, mean, theta0 = rng.uniform(0.2, 3.0, count), rng.normal(size=count), rng.normal(size=count)
    prior = Prior(sigma, mean)
    residual = J @ theta0 - y
    constant = -0.5 * float(residual @ residual) - 4 * np.log(2 * np.pi)
    reduced = ReducedNormalEquations(J.T @ J, -J.T @ residual, theta0, constant)
    expected = multivariate_normal(J @ mean, J @ np.diag(sigma**2) @ J.T + np.eye(8)).logpdf(y)
    assert reduced.evidence(prior) == pytest.approx(expected, abs=1e-6)
    gone = slice(0, 1)
    other = J[:, 1:]
    rest = multivariate_normal(other @ mean[1:], other @ np.diag(sigma[1:] ** 2) @ other.T + np.eye(8)).logpdf(y)
    if count > 1:
        posterior = reduced.posterior(prior)
        assert expected + posterior.nats_if_absent(gone) == pytest.approx(rest, abs=1e-6)
        wider = Prior(np.append(3 * sigma[0], sigma[1:]), np.append(mean[0] - 1, mean[1:]))
        gain, values, covariance = posterior.under_prior(gone, wider.part(gone))
        assert expected + gain == pytest.approx(reduced.evidence(wider), abs=1e-6)
        again = reduced.posterior(wider)
        assert values == pytest.approx(again.values[gone]) and covariance == pytest.approx(again.covariance[gone, gone])


def test_tolerance_is_half_a_size_and_nothing_for_places():
    by_id = bench()[1]
    assert by_id["lag"].tolerance() == pytest.approx([TOLERANCE * by_id["lag"].parameters[0].smallest])
    onset = next(e for e in by_id.values() if e.id.startswith("thruster_fouling"))
    assert onset.tolerance()[0] == pytest.approx(ABSENT * onset.parameters[0].smallest)
