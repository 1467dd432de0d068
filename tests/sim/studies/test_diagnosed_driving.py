"""Missions with base and extended vessel files in a boat that has something wrong with it. Seeds stated."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.model.load_vessel import load_vessel
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.vessel_text import vessel_toml
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.vessel_edits.extend import with_model_error
from sim.fitting.identify.structured_fit import with_latent
from sim.studies.driving.diagnosed import (
    GOALS,
    TRUTH,
    Trip,
    away_m,
    imperfect,
    mended,
    off_leg_m,
    pooled,
    trips,
)
from sim.world.score import TrueTrack
from sim.world.teleop_log import teleop_logs
from tests.support.vessel_fixtures import boat

BASE = boat("aritra")
SETTINGS = load_setup(EXAMPLES / "aritra.toml").pilot
WEAK = replace(BASE, thrusters=tuple(replace(t, gain=0.5 if t.name == "rear_port" else t.gain) for t in BASE.thrusters))
SMALL = {"dead_time_s": 0.02, "lag_s": 0.015, "latency_s": 0.02, "x_m": 0.015, "y_m": 0.015}
"""Half of the smallest sizes worth a name (docs/diagnose.md)."""


def trip(cross: float, error: float, missed: int = 0) -> Trip:
    return Trip("", 0, cross, {k: error * goal for k, goal in GOALS.items()}, missed, 1.0)


@given(seed=st.integers(0, 10_000))
def test_imperfections_stay_below_what_is_worth_a_name(seed):
    found = imperfect(BASE, np.random.default_rng(seed))
    assert found != BASE and load_vessel(vessel_toml(found), name="x") == found
    for table, was in ((found.propulsion, BASE.propulsion), (found.sensors.uwb, BASE.sensors.uwb)):
        for key in SMALL.keys() & set(table.__struct_fields__):
            assert abs(getattr(table, key) - getattr(was, key)) <= SMALL[key] + 1e-9, key
    assert all(abs(t.gain - 1.0) <= 0.025 for t in found.thrusters)
    assert abs(found.sensors.imu.heading_offset_rad) <= math.radians(0.5)
    assert (found.propulsion.dead_time_s / 0.01) == pytest.approx(round(found.propulsion.dead_time_s / 0.01))


def test_logs_hide_the_truth_and_say_what_the_pilot_believes():
    """Adrift: no thrust, a current of 0.2 m/s to the east, a tag that is 0.5 s late. Seed 61."""
    uwb = replace(BASE.sensors.uwb, latency_s=0.58)
    dead = tuple(replace(t, gain=0.0) for t in BASE.thrusters)
    current = {"V_c_m_s": 0.2, "beta_c_deg": 90.0, "source": "test"}
    true = replace(BASE, thrusters=dead, terms={"current": current}, sensors=replace(BASE.sensors, uwb=uwb))
    (run,) = teleop_logs(true, BASE, [61], 60.0)
    assert not [c for c in run.table.columns if c.startswith(TRUTH)]
    assert run.meta.latency_s == BASE.sensors.uwb.latency_s
    assert run.samples(*(f"pwm_{t}" for t in run.thrusters))[1].std() > 50.0
    t_s, place = run.samples("north_m", "east_m")
    late = t_s > 20.0
    assert np.polyfit(t_s[late], place[late], 1)[0] == pytest.approx([0.0, 0.2], abs=0.02)


def test_off_the_leg_is_the_distance_to_the_piece_of_line_that_is_being_driven():
    """Start (0, 0); waypoints (10, 0), (10, 10): 1 m beside the way in, 3 m beyond the first, 2 m beside the second."""
    truth = np.zeros((4, 6))
    truth[:, :2] = [(0, 0), (5, 1), (13, 0), (8, 5)]
    leg = np.array([-1, -1, -1, 0])
    points = np.array([(10.0, 0.0), (10.0, 10.0)])

    def track(on: bool) -> TrueTrack:
        return TrueTrack(np.arange(4.0), truth, truth, np.zeros((4, 6, 6)), np.zeros(4), leg, np.full(4, on))

    assert off_leg_m(track(True), points) == pytest.approx(math.sqrt((0 + 1 + 9 + 4) / 4))
    assert math.isnan(off_leg_m(track(False), points))
    assert away_m(track(True), points) == pytest.approx([3.0, math.sqrt(29)])


def test_the_estimators_error_is_one_where_every_goal_is_just_met_and_missions_are_pooled():
    assert trip(0.1, 1.0).estimator_error == pytest.approx(1.0)
    both = pooled([trip(0.3, 1.0), trip(0.4, 2.0)])
    assert both["cross_track_rms_m"] == pytest.approx(math.sqrt(0.125))
    assert both["estimator_error"] == pytest.approx(math.sqrt(2.5))
    assert not trip(0.1, 1.0, missed=1).finished


@pytest.mark.long
def test_a_boat_that_cannot_move_has_not_finished():
    """All thrusters dead. Seed 62: it rests 1.4 m from the first waypoint; and its filter knows."""
    adrift = replace(BASE, thrusters=tuple(replace(t, gain=0.0) for t in BASE.thrusters))
    (found,) = trips(adrift, BASE, SETTINGS, [62], name="base", limit_s=15.0)
    assert not found.finished and found.missed == len(SETTINGS.mission.path.points)
    assert set(found.rmse) == set(GOALS) and 0.0 < found.rmse["position_rmse_m"] < 1.0
    assert 0.0 <= found.cross_track_rms_m < 20.0 and found.seconds == pytest.approx(15.0)
    (never,) = trips(adrift, BASE, SETTINGS, [62], limit_s=0.5)
    assert math.isnan(never.cross_track_rms_m) and math.isnan(never.estimator_error) and not never.finished


def test_what_the_fit_leaves_over_is_a_force_and_never_nothing():
    noise = with_latent(stated_noise(BASE), np.array([0.05, 1e-4, 0.2]))
    error = with_model_error(BASE, noise, "test").model_error
    assert error is not None
    M = np.diag(mass_matrix(BASE))
    assert (error.X_sigma_N, error.N_sigma_N_m) == pytest.approx((2 * 0.05 * M[0], 2 * 0.2 * M[2]), abs=1e-3)
    assert error.Y_sigma_N == pytest.approx(0.6)  # a fifth of the filter's 3 N
    assert load_vessel(vessel_toml(with_model_error(BASE, noise, "test")), name="x").model_error == error


@pytest.mark.long
def test_a_weak_thruster_is_found_and_the_extended_file_estimates_better(tmp_path: Path):
    """Logs 63, 64 of 90 s, mission 65 for 60 s: rear port thruster at half its force."""
    found = mended(teleop_logs(WEAK, BASE, [63, 64], 90.0), BASE)
    assert found.named == ("thruster_gain:rear_port",) and found.not_in_file == {}
    extended = found.vessels["extended"]
    assert extended.thrusters[2].gain == pytest.approx(0.5, abs=0.05) and extended.model_error is not None
    before, after = (trips(WEAK, v, SETTINGS, [65], limit_s=60.0)[0] for v in (BASE, extended))
    assert after.estimator_error < before.estimator_error
