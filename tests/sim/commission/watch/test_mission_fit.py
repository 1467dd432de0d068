"""What one log says of the boat: right about a weak thruster, silent about the weather, by itself."""

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from sim.commission.watch.filter import Belief, Likelihood
from sim.commission.watch.mission_fit import MissionInformation, boat_effects, mission_information
from sim.fitting.diagnose.vessel_edits.public_form import family
from sim.fitting.wiring.levelling import without_tilt
from sim.world.environment import Weather
from sim.world.teleop_log import teleop_run
from tests.sim.fitting.tilt_fixture import following_acceleration
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
NAMES = tuple(e.id for e in boat_effects(VESSEL))
WINDY = Weather(V_c_m_s=0.12, beta_c_deg=70.0, V_w_m_s=3.0, beta_w_deg=200.0)


SIGMA = np.array([2.0 if n == "payload" else 0.02 if n in ("lag", "dead_time") else 0.05 for n in NAMES])


def theta_of(found: MissionInformation) -> np.ndarray:
    """Theta by one log and the belief before any, 5 % of everything; load in shares of the boat's mass."""
    after = Belief(np.zeros(len(NAMES)), np.diag(SIGMA**2)).after(Likelihood(found.precision, found.eta))
    return after.mean / np.where(np.array(NAMES) == "payload", VESSEL.inertia.mass_kg, 1.0)


def believed(run) -> dict[str, float]:
    return dict(zip(NAMES, theta_of(mission_information(run, VESSEL)).tolist(), strict=True))


@pytest.fixture(scope="module")
def windy():
    return mission_information(teleop_run(VESSEL, 5, 90.0, weather=WINDY), VESSEL)


@pytest.mark.long
def test_names_are_those_of_the_boat_alone(windy):
    assert windy.names == NAMES
    assert {family(n) for n in NAMES if not n.startswith("base:")} == {
        "thruster_gain", "hull_fouling", "payload", "dead_time", "lag"
    }  # fmt: skip
    assert windy.precision.shape == (len(NAMES), len(NAMES)) and np.isfinite(windy.eta).all()


def test_the_information_is_symmetric_and_never_negative(windy):
    np.testing.assert_array_equal(windy.precision, windy.precision.T)
    values = np.linalg.eigvalsh(windy.precision)
    assert values[0] > -1e-6 * values[-1]


def test_current_and_wind_belong_to_the_day(windy):
    assert windy.day["current.north_m_s"] == pytest.approx(0.12 * np.cos(np.radians(70)), abs=0.03)
    assert windy.day["current.east_m_s"] == pytest.approx(0.12 * np.sin(np.radians(70)), abs=0.03)


@pytest.mark.long
def test_a_weak_thruster_is_seen_in_wind_and_current():
    thrusters = tuple(replace(t, gain=0.7 * t.gain) if t.name == "rear_port" else t for t in VESSEL.thrusters)
    weak = replace(VESSEL, thrusters=thrusters)
    before = believed(teleop_run(VESSEL, 6, 90.0, weather=WINDY, believed=VESSEL))
    after = believed(teleop_run(weak, 6, 90.0, weather=WINDY, believed=VESSEL))
    change = {n: after[n] - before[n] for n in NAMES if n.startswith("thruster_gain:")}
    assert min(change, key=lambda n: change[n]) == "thruster_gain:rear_port"
    assert change["thruster_gain:rear_port"] < -0.12


@pytest.mark.long
def test_a_tilt_that_follows_the_acceleration_is_left_out():
    """As of a basin's autopilot, without GPS: levelled by it, coefficients were off by up to six sigmas."""
    run = following_acceleration(teleop_run(VESSEL, 5, 90.0))
    found, bare = mission_information(run, VESSEL), mission_information(without_tilt(run), VESSEL)
    np.testing.assert_array_equal(found.eta, bare.eta)


@pytest.mark.long
def test_accelerometers_of_a_hull_that_stands_level_are_worth_as_much_without_roll_and_pitch():
    """A stated 0.4 m/s^2 in their place made coefficients known 10 % worse, and a thruster 11 % weak was told late."""
    run = teleop_run(VESSEL, 5, 90.0)
    level, bare = (mission_information(r, VESSEL).precision for r in (run, without_tilt(run)))
    level_sigma, bare_sigma = (np.sqrt(np.diag(np.linalg.inv(p + np.diag(SIGMA**-2)))) for p in (level, bare))
    assert (bare_sigma / level_sigma).max() < 1.07


@pytest.mark.long
def test_positions_far_astray_are_as_if_they_were_not_there(windy):
    run = teleop_run(VESSEL, 5, 90.0, weather=WINDY)
    known = run.table["north_m"].is_not_null().to_numpy().nonzero()[0]
    hit = np.random.default_rng(3).choice(known, len(known) // 8, replace=False)

    def moved(by_m: float):
        columns = {name: run.table[name].to_numpy().copy() for name in ("north_m", "east_m")}
        for name, share in (("north_m", 1.0), ("east_m", 0.0)):
            columns[name][hit] += share * by_m
        table = run.table.with_columns(pl.Series(k, v, nan_to_null=True) for k, v in columns.items())
        return mission_information(type(run)(table, run.meta), VESSEL)

    astray, gone = moved(2.0), moved(float("nan"))
    assert np.linalg.norm(astray.eta - gone.eta) < 1e-3 * np.linalg.norm(gone.eta)
    assert np.linalg.norm(windy.eta - gone.eta) > 1e-3 * np.linalg.norm(gone.eta)
