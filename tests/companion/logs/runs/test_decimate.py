"""Logs with fewer inertial samples."""

from __future__ import annotations

import numpy as np
import polars as pl
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.logs.runs.decimate import decimated
from companion.logs.runs.run import Run, RunMeta


def log(rate_hz: float, seconds: float, seed: int, hole: tuple[float, float] | None = None) -> Run:
    """Inertial samples at `rate_hz`, positions at 5 Hz in between, a command that changes every 0.7 s."""
    rng = np.random.default_rng(seed)
    inertial = np.arange(0, seconds, 1 / rate_hz)
    if hole:
        inertial = inertial[(inertial < hole[0]) | (inertial > hole[1])]
    places = np.arange(0.013, seconds, 0.2)
    t = np.unique(np.concatenate([inertial, places]))
    psi = (3.0 + 0.3 * t + np.pi) % (2 * np.pi) - np.pi
    known = np.isin(t, inertial)
    columns = {
        "t_s": t,
        "pwm_port": 1500.0 + 50 * (np.floor(t / 0.7) % 3),
        "battery_v": np.full(len(t), 16.0),
        "phi_rad": np.full(len(t), np.nan),
        "theta_rad": np.full(len(t), np.nan),
        "psi_rad": np.where(known, psi, np.nan),
        "r_rad_s": np.where(known, 0.3 + 0.01 * rng.normal(size=len(t)), np.nan),
        "ax_m_s2": np.where(known, 2.0 * t, np.nan),
        "ay_m_s2": np.where(known, rng.normal(size=len(t)), np.nan),
        "north_m": np.where(np.isin(t, places), t, np.nan),
        "east_m": np.where(np.isin(t, places), -t, np.nan),
    }
    return Run(pl.DataFrame(columns).fill_nan(None), RunMeta(source="made up"))


@settings(max_examples=20, deadline=None)
@given(rate=st.sampled_from((20.0, 30.0, 40.0, 50.0)), seed=st.integers(0, 1000))
def test_means_carry_no_delay_and_nothing_else_is_lost(rate, seed):
    run = log(rate, 12.0, seed)
    fewer, width_s, at, around = decimated(run)
    assert abs(width_s - 0.1) < 0.035
    assert np.array_equal(at, fewer.samples("ax_m_s2")[0]) and np.abs(around.sum(axis=1)).max() < 1e-9
    samples = (at[:, None] + around).ravel()
    assert np.abs(samples[:, None] - run.samples("ax_m_s2")[0]).min(axis=1)[: -around.shape[1]].max() < 1e-9
    t, a = fewer.samples("ax_m_s2")
    assert np.abs(a - 2.0 * t).max() < 1e-9  # what grows steadily lies on its line
    t, psi = fewer.samples("psi_rad")
    off = (psi - 3.0 - 0.3 * t + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(off).max() < 1e-9  # also where the heading wraps
    assert np.allclose(fewer.samples("north_m")[0], run.samples("north_m")[0])
    for had, has in zip(run.commands(), fewer.commands(), strict=True):
        assert np.array_equal(had, has)
    before, after = run.samples("r_rad_s")[1], fewer.samples("r_rad_s")[1]
    assert abs(before.mean() - after.mean()) < 0.01 and after.std() < 0.8 * before.std()


def test_no_mean_reaches_across_a_hole():
    run = log(30.0, 12.0, 1, hole=(4.0, 7.5))
    t, a = decimated(run).run.samples("ax_m_s2")
    assert not ((t > 4.01) & (t < 7.49)).any()
    assert np.abs(a - 2.0 * t).max() < 1e-9


def test_a_slow_log_stays_as_it_is():
    run = log(10.0, 12.0, 1)
    as_it_is = decimated(run)
    assert as_it_is.run is run and as_it_is.width_s == 0.0


SENSOR = ("r_rad_s", "ax_m_s2", "ay_m_s2")


def thinned(run: Run, every: int, *columns: str) -> Run:
    """Each `every`-th inertial row alone has a value of `columns`."""
    kept = run.samples(columns[0])[0][::every]
    return Run(
        run.table.with_columns(pl.when(pl.col("t_s").is_in(kept)).then(pl.col(c)).alias(c) for c in columns), run.meta
    )


def test_a_sensor_that_comes_slowly_beside_a_fast_heading_stays_as_it_is():
    """ATTITUDE at 50 Hz, RAW_IMU at 10 Hz: a mean of five would span half a second."""
    run = thinned(log(50.0, 12.0, 1), 5, *SENSOR)
    fewer, width_s, at, around = decimated(run)
    for column in SENSOR:
        for had, has in zip(run.samples(column), fewer.samples(column), strict=True):
            assert np.array_equal(had, has)
    assert len(fewer.samples("psi_rad")[0]) == 120 and width_s == 0.0
    of_force = np.isin(at, fewer.samples("ax_m_s2")[0])
    assert not around[of_force].any(), "force is no mean, so neither is the thrust that it shows"


def test_a_fast_sensor_beside_a_slow_heading_is_averaged():
    run = thinned(log(50.0, 12.0, 1), 5, "psi_rad")
    fewer, width_s, _, _ = decimated(run)
    assert np.array_equal(fewer.samples("psi_rad")[1], run.samples("psi_rad")[1])
    t, a = fewer.samples("ax_m_s2")
    assert len(t) == 120 and np.abs(a - 2.0 * t).max() < 1e-9 and abs(width_s - 0.1) < 1e-9


def test_offsets_of_two_rates_are_those_of_the_samples():
    """100 Hz and 33 Hz: means of ten and of three; every offset leads to a sample, all as often."""
    run = thinned(log(100.0, 12.0, 1), 3, *SENSOR)
    fewer, width_s, at, around = decimated(run)
    assert abs(width_s - 0.09) < 1e-9
    for column, count in (("psi_rad", 10), ("ax_m_s2", 3)):
        mine, stamps = np.isin(at, fewer.samples(column)[0]), run.samples(column)[0]
        instants = (at[mine][:-1, None] + around[mine][:-1]).round(9)
        assert all(len(set(row)) == count and np.isin(row, stamps.round(9)).all() for row in instants)
        assert np.abs(around[mine][:-1].sum(axis=1)).max() < 1e-9
