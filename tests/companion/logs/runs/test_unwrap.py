"""Headings over a dropout of the compass: as many turns as the yaw rate tells, else the short way round."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import cumulative_trapezoid

from companion.logs.runs.run import Run
from companion.logs.runs.unwrap import integrated, unwrapped
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.engine.windows import PSI, cut_windows
from sim.world.teleop_log import teleop_run
from tests.companion.logs.readers.run_logs import clean_run
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
CLEAN = clean_run(60.0)


def turning(run: Run, rate_rad_s: float, begin_s: float, end_s: float, *silent: str) -> Run:
    """`run` with a boat that turns steadily; columns `silent` are blank from `begin_s` to `end_s`."""
    t = pl.col("t_s")
    psi = rate_rad_s * t + 0.002 * (40 * t).sin()
    table = run.table.with_columns(psi_rad=pl.arctan2(psi.sin(), psi.cos()), r_rad_s=rate_rad_s + 0.01 * (30 * t).sin())
    there = t.is_between(begin_s, end_s, closed="none")
    return Run(table.with_columns(pl.when(~there).then(pl.col(c)).alias(c) for c in silent), run.meta)


@settings(max_examples=40, deadline=None)
@given(rate=st.floats(-1.0, 1.0), begin=st.floats(2.0, 30.0), length=st.floats(0.1, 25.0))
def test_a_dropout_of_the_compass_does_not_lose_a_turn(rate, begin, length):
    t_s, psi = unwrapped(turning(CLEAN, rate, begin, begin + length, "psi_rad"))
    assert psi - psi[0] == pytest.approx(rate * (t_s - t_s[0]), abs=0.01)


@pytest.mark.parametrize("bias", [-0.2, 0.1])
def test_a_bias_of_the_gyro_adds_no_turn_over_a_dropout(bias):
    still = turning(CLEAN, 0.0, 10.0, 55.0, "psi_rad")
    biased = Run(still.table.with_columns(pl.col("r_rad_s") + bias), still.meta)
    assert np.abs(unwrapped(biased)[1]).max() < 0.01


def test_where_the_rate_is_silent_too_it_is_the_short_way_round():
    there = turning(CLEAN, 0.5, 20.0, 40.0, "psi_rad", "r_rad_s")
    never = Run(there.table.with_columns(r_rad_s=pl.lit(None, pl.Float64)), there.meta)
    for blind in (there, never):
        assert np.array_equal(unwrapped(blind)[1], np.unwrap(blind.samples("psi_rad")[1]))


def test_without_a_dropout_it_is_the_short_way_round_whatever_the_gyro_says():
    biased = Run(CLEAN.table.with_columns(pl.col("r_rad_s") * 1.1 + 0.05), CLEAN.meta)
    assert np.array_equal(unwrapped(biased)[1], np.unwrap(CLEAN.samples("psi_rad")[1]))


def test_the_fit_and_the_smoother_see_all_the_turns():
    """Ten radians within the dropout: 30 in a minute."""
    run = turning(teleop_run(VESSEL, 6, 60.0), 0.5, 20.0, 40.0, "psi_rad")
    seen = cut_windows([run], VESSEL, 2.0).y[..., PSI]
    first, *_, last = seen[np.isfinite(seen)]
    assert last - first == pytest.approx(0.5 * 59.0, abs=0.1)
    psi = smooth(run, SmootherNoise.of(VESSEL)).eta[:, 2]
    assert psi[-1] - psi[0] == pytest.approx(0.5 * 60.0, abs=0.2)


@pytest.mark.parametrize("shape", [(1,), (2,), (500,), (500, 2)])
def test_integrals_over_time_are_those_of_scipy(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(5)
    t_s, values = np.sort(rng.uniform(0.0, 60.0, shape[0])), rng.normal(size=shape)
    np.testing.assert_array_equal(integrated(values, t_s), cumulative_trapezoid(values, t_s, axis=0, initial=0.0))
