"""Ghosts: simulations from the boat's states under its commands, reset after every piece."""

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.logs.runs.run import Run
from sim.fitting.engine.split import JobError
from sim.fitting.validate.ghost import GhostModel, overlay
from sim.fitting.validate.models import ConstantVelocity, VesselSimulator
from sim.fitting.validate.protocol import CHANNELS
from sim.world.environment import Weather
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
TRUE = VesselSimulator("true", VESSEL)


@pytest.fixture(scope="module")
def run() -> Run:
    """60 s by hand, seed 4, with the truth."""
    return teleop_run(VESSEL, 4, 60.0)


def without_truth(run: Run) -> Run:
    return Run(run.table.select([c for c in run.table.columns if not c.startswith("true_")]), run.meta)


def test_the_true_model_stays_with_the_boat_and_another_does_not(run):
    heavy = replace(VESSEL, inertia=replace(VESSEL.inertia, mass_kg=1.5 * VESSEL.inertia.mass_kg))
    found = overlay(run, VESSEL, [TRUE, VesselSimulator("heavy", heavy), ConstantVelocity()], every_s=5.0)
    true, heavy_one, still = (ghost.rms(5.0) for ghost in found.ghosts)
    assert true["position"] < 0.02
    assert true["heading"] < 0.05
    for channel in CHANNELS:
        assert true[channel] < heavy_one[channel]
        assert true[channel] < still[channel]


def test_every_piece_begins_where_the_boat_was_and_where_the_last_one_ended_in_time(run):
    found = overlay(run, VESSEL, [TRUE], every_s=5.0)
    (ghost,) = found.ghosts
    np.testing.assert_array_equal(ghost.x[:, 0], found.truth[:, 0])
    assert not ghost.error[:, 0].any()
    np.testing.assert_allclose(np.diff(found.t_s[:, 0]), 5.0, atol=1e-9)
    np.testing.assert_allclose(np.diff(found.t_s, axis=1), 0.1, atol=1e-9)
    np.testing.assert_allclose(found.t_s[:-1, -1], found.t_s[1:, 0], atol=1e-9)


def test_errors_are_those_of_the_drawn_states(run):
    found = overlay(run, VESSEL, [ConstantVelocity()], every_s=4.0)
    (ghost,) = found.ghosts
    off = np.hypot(*(ghost.x - found.truth)[:, 40, :2].T)
    assert ghost.rms(4.0)["position"] == pytest.approx(np.sqrt(np.nanmean(off**2)))


def test_without_the_truth_they_begin_at_the_smoothed_state(run):
    found = overlay(without_truth(run), VESSEL, [TRUE], every_s=5.0)
    assert found.source == "the smoothed measurements"
    assert found.ghosts[0].rms(5.0)["position"] < 0.4  # the smoother's speeds are off by some cm/s
    shared = overlay(run, VESSEL, [TRUE], every_s=5.0)
    assert found.ghosts[0].rms(0.5)["position"] < 0.1
    assert len(shared.t_s) == pytest.approx(len(found.t_s), abs=1)


def test_a_file_that_knows_of_the_current_beats_one_that_does_not():
    drifted = teleop_run(VESSEL, 5, 60.0, weather=Weather(V_c_m_s=0.2, beta_c_deg=90.0))
    current = {"V_c_m_s": 0.2, "beta_c_deg": 90.0, "source": "the test"}
    extended = replace(VESSEL, terms={**VESSEL.terms, "current": current})
    found = overlay(drifted, VESSEL, [TRUE, VesselSimulator("extended", extended)], every_s=5.0)
    base, with_current = (ghost.rms(5.0) for ghost in found.ghosts)
    assert with_current["position"] < 0.2 * base["position"]


def test_nothing_is_simulated_where_nothing_was_measured(run):
    t = pl.col("t_s")
    gap = (t > 20) & (t < 33)
    places = [pl.when(gap).then(None).otherwise(pl.col(c)).alias(c) for c in ("north_m", "east_m")]
    holed = Run(without_truth(run).table.with_columns(places), run.meta)
    found = overlay(holed, VESSEL, [TRUE], every_s=5.0)
    inside = (found.t_s > 24) & (found.t_s < 29)
    assert np.isnan(found.ghosts[0].x[inside]).all()


def test_no_ghost_runs_across_a_pause_of_the_recording(run):
    """2.2 s without any record every 15 s: what was commanded meanwhile nobody knows."""
    t = pl.col("t_s")
    found = overlay(Run(run.table.filter((t < 10) | ((t - 10) % 15 > 2.2)), run.meta), VESSEL, [TRUE], every_s=5.0)
    drawn = np.where(np.isnan(found.ghosts[0].x[..., 0]), np.nan, found.t_s)
    for first in (10.0, 25.0, 40.0):
        assert not ((drawn > first + 0.1) & (drawn < first + 2.1)).any()
        begins = drawn[:, 0]
        assert begins[begins > first].min() == pytest.approx(first + 2.2, abs=0.11)


def test_another_boats_file_is_refused_by_name(run):
    with pytest.raises(JobError, match="another boat's log"):
        overlay(run, boat("twin"), [VesselSimulator("twin", boat("twin"))], every_s=5.0)


def test_a_file_whose_thrusters_stand_in_another_order_is_told_its_own_commands(run):
    turned = replace(VESSEL, thrusters=VESSEL.thrusters[::-1])
    found = overlay(run, VESSEL, [TRUE, GhostModel.of("turned", turned, VESSEL)], every_s=5.0)
    np.testing.assert_allclose(found.ghosts[1].x, found.ghosts[0].x, atol=1e-9)
    with pytest.raises(JobError, match="another boat's vessel file"):
        GhostModel.of("twin.toml", boat("twin"), VESSEL)


def test_a_simulation_that_runs_away_counts_as_gone(run):
    class Gone:
        name = "gone"

        def simulate(self, x0, commands):
            x = np.repeat(x0[:, None], commands.pwm_us.shape[1] + 1, axis=1)
            x[:, 30:] = np.nan
            return x

    found = overlay(run, VESSEL, [Gone()], every_s=5.0)
    assert np.isfinite(found.ghosts[0].rms(1.0)["position"])
    assert found.ghosts[0].rms(5.0)["position"] == np.inf
