"""A tick of the waves that the bank reckons with, against scipy's matrix exponential and Lyapunov equation."""

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov, solve_discrete_lyapunov

from companion.core.pilot.trust.thrusters.wave_noise import OMEGA_RAD_S, STATIONARY, ZETA, transition

A = np.array([[0.0, 1.0], [-(OMEGA_RAD_S**2), -2 * ZETA * OMEGA_RAD_S]])


@pytest.mark.parametrize("dt_s", [0.01, 0.1, 0.5, 3.0])
def test_a_tick_is_that_of_the_differential_equation(dt_s):
    Phi, new = transition(dt_s)
    np.testing.assert_allclose(Phi, expm(A * dt_s), atol=1e-12)
    np.testing.assert_allclose(solve_discrete_lyapunov(Phi, new), STATIONARY, atol=1e-9)


def test_the_wave_has_variance_1():
    driven = np.diag([0.0, 4 * ZETA * OMEGA_RAD_S])
    np.testing.assert_allclose(solve_continuous_lyapunov(A, -driven), STATIONARY, atol=1e-12)
