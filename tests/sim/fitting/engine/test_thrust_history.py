"""Thruster forces that change no faster than a limit."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.fitting.engine.thrust.history import SlewedHistory, ThrustCommands, ThrustHistory


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), slew=st.floats(5.0, 80.0), lag=st.floats(0.05, 0.3))
def test_slewed_forces_are_those_of_their_differential_equation(seed: int, slew: float, lag: float) -> None:
    """Oracle: f_dot = clip((F - f) / T, -slew, slew) in small Euler steps."""
    rng = np.random.default_rng(seed)
    t, F = np.cumsum(rng.uniform(0.02, 0.4, 20)), rng.uniform(-30, 30, (20, 2))
    step, dead = 2e-4, 0.05
    grid = np.arange(t[0], t[-1], step)
    f, wanted = F[0].copy(), F[np.maximum(np.searchsorted(t + dead, grid, side="right") - 1, 0)]
    expected = np.empty_like(wanted)
    for k, target in enumerate(wanted):
        expected[k] = f
        f = f + step * np.clip((target - f) / lag, -slew, slew)
    got = SlewedHistory(ThrustCommands(t, F), dead, lag, slew).force(grid)
    assert np.abs(got - expected).max() < 3 * step * 60 / lag
    assert np.abs(np.diff(got, axis=0)).max() <= slew * step * (1 + 1e-6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 4), lag=st.floats(0.05, 0.3), dead=st.floats(0.0, 0.2))
def test_averaged_forces_are_means_of_samples_and_know_their_derivatives(
    seed: int, count: int, lag: float, dead: float
) -> None:
    rng = np.random.default_rng(seed)
    commands = ThrustCommands(np.cumsum(rng.uniform(0.02, 0.4, 20)), rng.uniform(-30, 30, (20, 3)))
    history = ThrustHistory(commands, dead, lag)
    t = rng.uniform(commands.t_s[0] - 0.5, commands.t_s[-1] + 0.5, (4, 7))  # in no order, before and after all commands
    around = rng.uniform(-0.2, 0.2, (4, 7, count))
    single = history.force(t[..., None] + around).mean(axis=2)
    f, by_dead, by_lag = history.at(t, around)
    np.testing.assert_allclose(f, single, atol=1e-10)
    np.testing.assert_allclose(history.mean(t), history.force(t), atol=1e-10)
    h = 1e-6
    numeric = (ThrustHistory(commands, dead, lag + h).mean(t, around) - f) / h
    np.testing.assert_allclose(by_lag, numeric, rtol=1e-3, atol=0.05)
    kinks = np.abs(t[..., None, None] + around[..., None] - commands.t_s - dead).min(axis=(2, 3))
    numeric, clear = (ThrustHistory(commands, dead + h, lag).mean(t, around) - f) / h, kinks > 2 * h
    np.testing.assert_allclose(by_dead[clear], numeric[clear], rtol=1e-3, atol=0.05)
