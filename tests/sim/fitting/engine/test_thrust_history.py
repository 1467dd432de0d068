"""Thruster forces over whole logs: against the boat's own lag, slew and force map, and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.configuration.vessel_file import PitchMap
from companion.core.model.thrust_lag import first_order_lag, slew_limited_lag
from companion.core.model.thrusters import force_from_pwm
from sim.fitting.engine.thrust.history import Pitch, SlewedHistory, ThrustCommands, ThrustHistory
from tests.support.vessel_fixtures import boat


@pytest.mark.long
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


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 5), lag=st.floats(0.03, 0.3), dead=st.floats(0.0, 0.2))
def test_a_step_of_a_tenth_of_a_second_gives_the_hull_what_the_thrusters_gave(
    seed: int, count: int, lag: float, dead: float
) -> None:
    """Oracle: the averaged force added up in steps of 0.1 ms; a command may fall anywhere, steps may have no length."""
    rng = np.random.default_rng(seed)
    commands = ThrustCommands(np.cumsum(rng.uniform(0.05, 0.3, 12)), rng.uniform(-30, 30, (12, 2)))
    history = ThrustHistory(commands, dead, lag)
    t = commands.t_s[0] - 0.2 + 0.1 * np.minimum(np.arange(15), 13)[None]
    around = np.broadcast_to(0.02 * (np.arange(count) - (count - 1) / 2), (1, 15, count))
    f = history.mean(t, around)
    middle = history.middle(f, t, around)
    fine = 1000
    parts = t[:, :-1, None] + np.diff(t)[..., None] * (np.arange(fine) + 0.5) / fine
    mean = history.mean(parts[0].ravel()[:, None] + around[0, :1], None).mean(axis=1).reshape(14, fine, 2).mean(axis=1)
    simpson = (f[0, :-1] + 4 * middle[0] + f[0, 1:]) / 6
    np.testing.assert_allclose(simpson, mean, atol=0.02)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), slew=st.floats(5.0, 500.0), lag=st.floats(0.05, 0.3))
def test_kernels_follow_the_one_definition_of_the_lag(seed: int, slew: float, lag: float) -> None:
    """From change to change, each force is what the one before becomes under the command between."""
    rng = np.random.default_rng(seed)
    t, F = np.cumsum(rng.uniform(0.02, 0.4, 20)), rng.uniform(-30, 30, (20, 2))
    f = slewed = F[0]
    commands = ThrustCommands(t, F)
    for j in range(19):
        since = np.array([t[j + 1] - t[j]])
        f, slewed = first_order_lag(f, F[j], since, lag), slew_limited_lag(slewed, F[j], since, lag, slew)
        np.testing.assert_allclose(ThrustHistory(commands, 0.1, lag).mean(t[j + 1 : j + 2] + 0.1), f[None], atol=1e-9)
        got = SlewedHistory(commands, 0.1, lag, slew).force(t[j + 1 : j + 2] + 0.1)
        np.testing.assert_allclose(got, slewed[None], atol=1e-9)


@given(pulse=st.integers(-500, 500), trim=st.floats(-50, 50), curve=st.floats(-0.9, 0.9))
def test_pitch_of_the_fits_is_the_pitch_of_the_force_map(pulse: int, trim: float, curve: float) -> None:
    fmap = PitchMap(setting="speed", nominal_setting=0.4, ahead_N=2.0, astern_N=1.5, curve=curve, source="test")
    thruster = replace(boat("cse1").thrusters[0], gain=1.0, trim_us=trim)
    pitch = Pitch((0,), np.array([[float(pulse)]]), np.array([[2.0]]), np.array([[1.5]]))
    force, _, _ = pitch.at(np.array([trim]), np.array([curve]))
    assert force.item() == pytest.approx(force_from_pwm(thruster, fmap, 1500 + pulse, 12.0), abs=1e-12)
