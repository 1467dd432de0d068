"""Parts of a run: nothing measured leaks from outside, commands before are known, the clock stays."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.logs.runs.run import Run, RunError
from companion.logs.runs.splits import HISTORY_S, alternate, block_intervals, part, parts, tail
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.engine.thrust.battery import commands_of, pulses_of
from sim.fitting.engine.thrust.history import ThrustHistory
from sim.fitting.engine.windows import cut_windows
from sim.fitting.taylor.pipeline import held_commands, paper_samples, smoother_samples
from sim.world.teleop_log import teleop_run
from tests.companion.logs.readers.run_logs import clean_run
from tests.support.vessel_fixtures import boat

CLEAN = clean_run(60.0)
VESSEL = boat("aritra")
MEASURED = ["psi_rad", "r_rad_s", "ax_m_s2", "north_m"]


@pytest.fixture(scope="module")
def run() -> Run:
    return teleop_run(VESSEL, 6, 60.0)


@settings(max_examples=30, deadline=None)
@given(low=st.floats(0.0, 50.0), length=st.floats(1.0, 60.0))
def test_a_part_holds_what_was_measured_inside_and_nothing_else(low, length):
    high = low + length
    found = part(CLEAN, low, high)
    for column in MEASURED:
        t_s, values = CLEAN.samples(column)
        inside = (t_s >= low) & (t_s <= high)
        got_t, got = found.samples(column)
        assert np.array_equal(got_t, t_s[inside]) and np.array_equal(got, values[inside])


@settings(max_examples=30, deadline=None)
@given(low=st.floats(0.0, 50.0), length=st.floats(1.0, 60.0))
def test_commands_and_voltage_are_as_in_the_whole_run(low, length):
    found = part(CLEAN, low, low + length)
    end = low + length - 1e-6  # a stamp that is later by less than rounding counts as there already
    at = np.linspace(max(low - HISTORY_S, 0.0), min(end, 59.9), 200)
    for mine, whole in zip(held_commands(found, at), held_commands(CLEAN, at), strict=True):
        assert np.array_equal(mine, whole)


def test_cells_that_are_blank_between_two_samples_take_away_no_command(run):
    """Voltage every five seconds, one thruster's pulses where they change, in a whole log and in a part of it."""
    column = f"pwm_{VESSEL.thrusters[0].name}"
    stays = pl.col(column) == pl.col(column).shift(1)
    known = (pl.col("t_s") % 5.0).diff().fill_null(-1.0) < 0
    volts = pl.when(known).then(pl.col("battery_v")).otherwise(None)
    pulses = pl.when(stays).then(None).otherwise(pl.col(column))
    sparse = Run(run.table.with_columns(volts.alias("battery_v"), pulses.alias(column)), run.meta)
    every = Run(sparse.table.with_columns(pl.col("battery_v").forward_fill(), run.table[column]), run.meta)
    at = np.arange(run.commands()[0][0] + 1e-6, 59.0, 0.05)
    for given_, filled in ((sparse, every), (part(sparse, 33.0, 50.0), part(every, 33.0, 50.0))):
        for mine, other in zip(held_commands(given_, at), held_commands(filled, at), strict=True):
            assert np.array_equal(mine, other)
        forces = [ThrustHistory(commands_of(pulses_of(r, VESSEL), VESSEL), 0.1, 0.1) for r in (given_, filled)]
        assert np.array_equal(forces[0].force(at), forces[1].force(at))
    assert len(pulses_of(sparse, VESSEL).t_s) == len(pulses_of(run, VESSEL).t_s) > 100


@settings(max_examples=50, deadline=None)
@given(block_s=st.floats(0.5, 60.0))
def test_blocks_hold_every_row_once(block_s):
    if CLEAN.duration_s < block_s:
        return
    intervals = block_intervals(CLEAN, block_s)
    t_s = CLEAN.table["t_s"].to_numpy()
    rows = np.sum([(t_s >= low) & (t_s <= high) for low, high in intervals], axis=0)
    assert (rows == 1).all()
    lengths = np.array([high - low for low, high in intervals])
    assert lengths[:-1] == pytest.approx(block_s)
    assert 0.499 * block_s < lengths[-1] < 1.501 * block_s


def test_alternate_blocks_and_tail(run):
    fit, out = alternate(run, 10.0)
    assert [round(low) for low, _ in fit] == [0, 20, 40] and [round(low) for low, _ in out] == [10, 30, 50]
    assert all(high < low for (_, high), (low, _) in zip(fit, out, strict=True))
    (low, high), (from_s, to_s) = tail(run, 15.0)
    assert (low, to_s) == (0.0, run.table["t_s"][-1]) and high < from_s == pytest.approx(to_s - 15.0)
    assert parts(run, fit)[1].meta.source == "teleop_run seed 6, 20 to 30 s"


def test_smoothing_of_a_part_begins_with_its_measurements(run):
    """History brings commands, not instants: no sample of a regression comes from before the part."""
    noise = SmootherNoise.of(VESSEL)
    block = part(run, 20.0, 40.0)
    assert block.table["t_s"][0] < 18.2
    smoothed = smooth(block, noise)
    assert smoothed.t_s[0] >= 20.0 and smoothed.t_s[-1] <= 40.0
    ours, whole = smoother_samples(block, VESSEL, smoothed), smooth(run, noise)
    middle = slice(50, 150)
    start = int(np.argmin(np.abs(whole.t_s - smoothed.t_s[0])))
    assert np.abs(ours.nu[middle] - whole.nu[start:][middle]).max() < 0.05
    assert len(paper_samples(block, VESSEL, noise).nu) == len(smoothed.t_s)


def test_the_fit_sees_thrusters_as_in_the_whole_run_and_loses_no_sample(run):
    block = part(run, 20.0, 40.0)
    windows = cut_windows([block], VESSEL, 2.0)
    assert windows.t_s[0, 0] == pytest.approx(20.0, abs=0.04)
    at = windows.t_s[:, 0]
    whole, ours = (
        ThrustHistory(
            commands_of(pulses_of(r, VESSEL), VESSEL), VESSEL.propulsion.dead_time_s, VESSEL.propulsion.lag_s
        ).at(at)[0]
        for r in (run, block)
    )
    assert np.abs(ours - whole).max() < 0.05, "N; the voltage's sag is estimated from each run by itself"
    bare = part(run, 20.0, 40.0, history_s=0.0)
    assert cut_windows([bare], VESSEL, 2.0).t_s[0, 0] > 20.9, "without history the first second is lost"


def test_a_part_after_a_pause_knows_the_command_in_force():
    t_s = pl.col("t_s")
    paused = Run(CLEAN.table.filter((t_s < 10.0) | (t_s > 20.0)), CLEAN.meta)
    found = part(paused, 20.0, 30.0)
    assert found.table["t_s"][0] < 10.0
    assert np.array_equal(held_commands(found, np.array([19.0]))[0], held_commands(paused, np.array([19.0]))[0])


def test_pauses_count_for_nothing_when_the_last_part_is_held_out():
    """10 s before the pause of 10 s, 40 after it: the last 45 s begin 5 s before the pause."""
    paused = Run(CLEAN.table.filter((pl.col("t_s") <= 10.0) | (pl.col("t_s") >= 20.0)), CLEAN.meta)
    (low, high), (from_s, to_s) = tail(paused, 44.98)
    assert (low, to_s) == (0.0, 59.98) and high < from_s == pytest.approx(5.0)
    assert tail(paused, 30.0)[1][0] == pytest.approx(29.98)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda r: part(r, 100.0, 110.0),
            r"seed 6, 100 to 110 s: nothing is measured there; the run is from 0 to 59.97 s",
        ),
        (lambda r: block_intervals(r, 90.0), r"59.97 s cannot be cut into blocks of 90 s"),
        (lambda r: alternate(r, 59.0), r"hold no two blocks of 59 s"),
        (lambda r: tail(r, 60.0), r"cannot hold out 60 s of"),
        (lambda r: tail(r, 0.0), r"cannot hold out 0 s"),
    ],
)
def test_what_cannot_be_cut_is_said(run, call, words):
    with pytest.raises(RunError, match=words):
        call(run)
