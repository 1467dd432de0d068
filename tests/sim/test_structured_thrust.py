"""Thruster forces that change no faster than a limit."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.identify.structured.thrust import Commands, SlewedHistory


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
    got = SlewedHistory(Commands(t, F), dead, lag, slew).force(grid)
    assert np.abs(got - expected).max() < 3 * step * 60 / lag
    assert np.abs(np.diff(got, axis=0)).max() <= slew * step * (1 + 1e-6)
