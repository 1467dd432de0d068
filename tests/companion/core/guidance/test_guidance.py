"""Guidance in closed loop: the square, passing waypoints, station keeping. The horizon: test_reference.

The dynamic boat (60, 70 kg and 8 kg m^2 with added mass, linear damping, a force-limited PD follower of the
first horizon stage) stands in for plant and NMPC; its numbers are assumed. Noise is seeded.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.geometry.frames import rotate, ssa, unrotate
from companion.core.guidance.guidance import IDLE, GuidanceState, hold, horizon, start, step
from companion.core.guidance.path import Path, Waypoint
from companion.core.guidance.reference import GuidanceSettings
from companion.core.guidance.reference_row import Column
from companion.core.messages import GuidanceReference
from tests.companion.core.guidance.polyline import distance_m

SQUARE = Path(tuple(Waypoint(n, e) for n, e in [(9, 9), (21, 9), (21, 21), (9, 21), (9, 12)]))
TIMES = [0.1 * k for k in range(21)]
COURSE = GuidanceSettings()
LOS = GuidanceSettings(steering="los")
TICK_NS = 100_000_000
REST = (0.0, 0.0, 0.0)
LEGS = st.lists(st.tuples(st.floats(-math.pi, math.pi), st.floats(1.0, 8.0)), min_size=1, max_size=4)


def path_of(legs):
    north, east, angle = 0.0, 0.0, 0.0
    waypoints = [Waypoint(north, east)]
    for turn, length in legs:
        angle += turn
        north, east = north + length * math.cos(angle), east + length * math.sin(angle)
        waypoints.append(Waypoint(north, east))
    return Path(tuple(waypoints))


def pose_to_follow(row, eta):
    """Body-frame error that the row asks to close: cross-track always, along-track by the station weight."""
    x, y = unrotate(row[Column.PATH_ANGLE], eta[0] - row[Column.NORTH], eta[1] - row[Column.EAST])
    return unrotate(eta[2], *rotate(row[Column.PATH_ANGLE], row[Column.STATION] * x, y))


@dataclass
class Run:
    state: GuidanceState
    eta: np.ndarray  # (T, 3)
    nu: np.ndarray  # (T, 3)
    refs: list[GuidanceReference]

    def first(self, phase):
        return next(r.t_ns * 1e-9 for r in self.refs if r.phase == phase)

    def on_legs(self):
        return np.array([r.phase == "leg" and r.leg >= 0 for r in self.refs])


def drive(path, *, eta=(9.0, 9.0, 0.0), seconds=130.0, current=(0.0, 0.0), noise_m=0.0, seed=1, heading=None):
    """The dynamic boat under the course reference; wrapped headings go in, as from a real estimator."""
    rng = np.random.default_rng(seed)
    mass, damping, most = np.array([60.0, 70, 8]), np.array([20.0, 60, 8]), np.array([40.0, 40, 12])
    eta, nu = np.array(eta, dtype=float), np.zeros(3)
    state = start(path, COURSE, eta, nu, 0, end_heading_rad=heading)
    run = Run(state, np.empty((0, 3)), np.empty((0, 3)), [])
    etas, nus = [], []
    for i in range(int(seconds * 10)):
        seen = (*(eta[:2] + rng.normal(0, noise_m, 2)), ssa(eta[2]))
        state, ref = step(state, COURSE, seen, nu, i * TICK_NS)
        row = horizon(state, COURSE, seen, nu, TIMES[:3])[1]
        bx, by = pose_to_follow(row, seen)
        want = row[Column.U : Column.STATION] - nu - [0.5 * bx, 0.6 * by, 1.5 * (seen[2] - row[Column.PSI])]
        tau = np.clip(2 * mass * want + damping * nu, -most, most)
        for _ in range(5):
            drift = np.array([*unrotate(eta[2], *current), 0.0])
            coriolis = np.array([nu[1] * nu[2] * 70 / 60, -nu[0] * nu[2] * 60 / 70, 0.0])
            nu = nu + 0.02 * ((tau - damping * (nu - drift)) / mass + coriolis)
            eta = eta + 0.02 * np.array([*rotate(eta[2], nu[0], nu[1]), nu[2]])
        etas.append(eta)
        nus.append(nu)
        run.refs.append(ref)
    run.state, run.eta, run.nu = state, np.array(etas), np.array(nus)
    return run


def cross_track_rms(path, run):
    distances = [distance_m(path, *p) for p in run.eta[run.on_legs(), :2]]
    return float(np.sqrt(np.mean(np.square(distances))))


# --- the square in closed loop ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("conditions", "rms_m"), [({}, 0.03), ({"noise_m": 0.05}, 0.05), ({"current": (0.07, 0.07)}, 0.06)]
)
def test_square_is_driven_within_the_bars(conditions, rms_m):
    run = drive(SQUARE, **conditions)
    assert [p.waypoint for p in run.state.passed] == [0, 1, 2, 3, 4]
    assert all(p.miss_m < 0.35 for p in run.state.passed)
    assert run.first("station") < 100.0
    assert run.state.phase == "done"
    assert cross_track_rms(SQUARE, run) < rms_m
    assert max(run.eta[:, 0]) < 21.3  # overshoot of the right angle
    assert max(run.eta[:, 1]) < 21.3
    assert run.eta[-1, :2] == pytest.approx((9, 12), abs=0.1)
    assert ssa(run.eta[-1, 2] + math.pi / 2) == pytest.approx(0.0, abs=0.05)
    surge_error = np.array([r.u_ref_m_s for r in run.refs]) - run.nu[:, 0]
    assert np.sqrt(np.mean(surge_error[run.on_legs()] ** 2)) < 0.05


def test_end_heading_of_the_mission_is_held_and_arrival_is_smooth():
    run = drive(SQUARE, heading=0.5, seconds=120.0)
    assert run.state.phase == "done"
    assert ssa(run.eta[-1, 2] - 0.5) == pytest.approx(0.0, abs=0.02)
    arrived = int(run.first("station") * 10)
    assert np.max(np.abs(np.diff(run.nu[arrived:, 0]))) < 0.03  # below 0.3 m/s^2, twice the limit
    assert np.max(np.abs(run.nu[arrived:, 1])) < 0.1


@pytest.mark.parametrize("eta", [(9.0, 9.0, math.pi), (12.0, 3.0, -2.0), (2.0, 20.0, 3.0)])
def test_from_rest_facing_anywhere_it_turns_first_and_then_goes(eta):
    run = drive(SQUARE, eta=eta, seconds=150.0)
    assert [p.waypoint for p in run.state.passed] == [0, 1, 2, 3, 4]
    assert run.state.phase == "done"
    assert cross_track_rms(SQUARE, run) < 0.06
    assert np.max(np.abs(run.nu[:, 2])) < 1.0


@pytest.mark.parametrize("seed", range(3))
def test_reversals_and_crossings_are_driven_in_order(seed):
    path = Path(tuple(Waypoint(*p) for p in [(0, 0), (8, 0), (0, 0), (8, 2), (4, -3), (4, 3)]))
    run = drive(path, eta=(0, 0, 0), seconds=200.0, noise_m=0.03, seed=seed)
    assert [p.waypoint for p in run.state.passed] == list(range(6))
    assert all(p.miss_m < 0.4 for p in run.state.passed)
    assert run.state.phase == "done"


def test_a_single_waypoint_is_driven_to_and_held():
    run = drive(Path((Waypoint(12, 9),)), seconds=25.0)
    assert run.state.phase == "done"
    assert run.eta[-1, :2] == pytest.approx((12, 9), abs=0.05)
    run = drive(Path((Waypoint(9.2, 9),)), seconds=10.0)
    assert run.refs[0].phase == "station"
    assert run.eta[-1, :2] == pytest.approx((9.2, 9), abs=0.05)


# --- waypoints ------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(LEGS, st.sampled_from(["course", "los"]), st.integers(0, 2**32 - 1))
def test_every_waypoint_is_passed_in_order_whatever_the_path_and_the_weather(legs, steering, seed):
    """A vehicle blown about by up to 0.6 m: passed by circle or beside it, never waited for."""
    path, config = path_of(legs), GuidanceSettings(steering=steering)
    rng = np.random.default_rng(seed)
    eta, gust, u = np.zeros(3), np.zeros(2), 0.0
    state = start(path, config, eta, REST, 0)
    for i in range(int(30 * (path.length_m + 10 * len(legs)))):
        seen = eta + np.array([*gust, 0.0])
        state, ref = step(state, config, seen, (u, 0, 0), i * TICK_NS)
        if state.phase != "leg":
            break
        u, turn = ref.u_ref_m_s, np.clip(ref.psi_ref_rad - eta[2], -0.08, 0.08)
        eta = eta + np.array([*(0.1 * x for x in rotate(eta[2], u, 0.0)), turn])
        gust = np.clip(0.95 * gust + rng.normal(0, 0.05, 2), -0.6, 0.6)
    assert state.phase in ("station", "done")
    assert [p.waypoint for p in state.passed] == list(range(len(path.waypoints)))
    assert [p.t_ns for p in state.passed] == sorted(p.t_ns for p in state.passed)
    for passage in state.passed:
        if passage.reason == "circle":
            assert passage.miss_m <= config.limits.acceptance_m


def test_a_waypoint_missed_beside_is_recorded_with_its_distance_and_reason():
    path = Path((Waypoint(0, 0), Waypoint(10, 0, acceptance_m=1.0), Waypoint(20, 0)))
    state = start(path, LOS, REST, REST, 0)
    for i in range(13):
        state, ref = step(state, LOS, (float(i), 2.0, 0.0), (0.5, 0, 0), i * TICK_NS)
        assert ref.waypoints_passed == (1 if i < 10 else 2)
    assert (state.passed[1].waypoint, state.passed[1].reason) == (1, "along-track")
    assert state.passed[1].miss_m == pytest.approx(2.0)
    assert state.passed[1].t_ns == 10 * TICK_NS


def test_a_corner_cut_on_the_inside_counts_as_passed_beside_it():
    """0.2 m inside of both legs the boat is never abeam of the waypoint, but rounds the course's corner."""
    path = Path((Waypoint(0, 0), Waypoint(10, 0, acceptance_m=0.1), Waypoint(10, 20)))
    state = start(path, COURSE, REST, REST, 0)
    for i in range(1, 300):
        along = 0.05 * i
        place = (along, 0.2, 0.0) if along < 9.8 else (9.8, along - 9.6, math.pi / 2)
        state, _ = step(state, COURSE, place, (0.5, 0, 0), i * TICK_NS)
    assert (state.passed[1].reason, state.target) == ("along-track", 2)
    assert state.passed[1].miss_m == pytest.approx(0.2 * math.sqrt(2), abs=0.05)


def test_the_ilos_integral_starts_anew_on_every_leg():
    config = GuidanceSettings(steering="los", kappa=0.5)
    state = start(SQUARE, config, (9, 9, 0), REST, 0)
    for i in range(1, 40):
        state, _ = step(state, config, (9 + 0.4 * i, 9.4, 0.0), (0.5, 0, 0), i * TICK_NS)
        assert (state.y_int_m > 0) == (state.target == 1)
        if state.target == 2:
            break
    assert state.target == 2


def test_the_miss_is_the_closest_approach_even_after_the_circle_was_entered():
    path = Path((Waypoint(0, 0), Waypoint(10, 0, acceptance_m=1.0), Waypoint(20, 0)))
    state = start(path, COURSE, REST, REST, 0)
    for i in range(1, 24):
        state, _ = step(state, COURSE, (0.5 * i, 0.25, 0.0), (0.5, 0, 0), i * TICK_NS)
    assert state.passed[1].reason == "circle"
    assert state.passed[1].miss_m == pytest.approx(0.25)


def test_one_step_never_passes_two_waypoints():
    path = Path(tuple(Waypoint(0.1 * k, 0) for k in range(6)))
    state = start(path, COURSE, REST, REST, 0)
    for i in range(1, 6):
        assert len(state.passed) == i
        state, _ = step(state, COURSE, REST, REST, i * TICK_NS)
    assert state.phase == "station"


def test_an_interrupted_mission_goes_on_with_the_waypoints_that_are_left():
    state = start(SQUARE, COURSE, (9, 9, 0), REST, 0)
    for i in range(1, 60):
        state, _ = step(state, COURSE, (9 + 0.25 * i, 9.0, 0.0), (0.5, 0, 0), i * TICK_NS)
    held = hold(COURSE, (15, 12, 0), REST, 60 * TICK_NS, passed=state.passed)
    resumed = start(SQUARE, COURSE, (15, 12, 0), REST, 61 * TICK_NS, passed=held.passed)
    assert [p.waypoint for p in resumed.passed] == [0, 1]
    assert resumed.route is not None
    assert resumed.route.points[:2] == ((15, 12), (21, 21))
    finished = start(SQUARE, COURSE, (9, 12, 0), REST, 0, passed=drive(SQUARE).state.passed)
    assert finished.phase == "station"
    assert len(finished.passed) == 5


# --- station keeping and idling ----------------------------------------------------------------------


def test_idle_asks_for_nothing_and_its_horizon_stays_here():
    eta = (3.0, 4.0, 7.0)
    state, ref = step(IDLE, COURSE, eta, (0.2, 0, 0), 5)
    assert (state.phase, ref.phase, ref.waypoints_passed) == ("idle", "idle", 0)
    assert (ref.psi_ref_rad, ref.u_ref_m_s, ref.x_e_m, ref.y_e_m) == (7.0, 0.0, 0.0, 0.0)
    rows = horizon(state, COURSE, eta, (0.2, 0, 0), TIMES)
    assert np.allclose(rows, [3.0, 4.0, 7.0, 7.0, 0, 0, 0, 1])


def test_hold_here_stops_where_braking_ends_and_never_is_done():
    eta, nu = (3.0, 4.0, math.pi / 2), (0.45, 0.0, 0.0)
    state = hold(COURSE, eta, nu, 0)
    for i in range(1, 100):
        state, ref = step(state, COURSE, eta, nu, i * TICK_NS)
    assert ref.phase == "station"
    assert (ref.north_ref_m, ref.east_ref_m) == pytest.approx((3.0, 4.0 + 0.45**2 / 0.3))
    rows = horizon(state, COURSE, (3.3, 4.0, 0.0), REST, TIMES)
    assert np.all(rows[:, Column.STATION] == 1)
    assert np.allclose(rows[:, :2], [3.0, 4.675])
    assert np.all(np.diff(rows[:, Column.PSI]) >= 0)


def test_settling_starts_again_when_the_boat_is_pushed_away():
    state = start(Path((Waypoint(0, 0),)), COURSE, REST, REST, 0)
    for i in range(1, 60):
        away = 1.0 if i == 20 else 0.0
        state, ref = step(state, COURSE, (away, 0, 0), REST, i * TICK_NS)
        assert ref.phase == ("done" if i >= 51 else "station")


def test_array_scalars_do_not_leak_into_the_message():
    state = start(SQUARE, COURSE, np.array([9.0, 9, 0]), np.zeros(3), 0)
    _, ref = step(state, COURSE, np.array([9.5, 9, 0]), np.zeros(3), TICK_NS)
    assert all(type(getattr(ref, name)) in (float, int, str) for name in ref.__struct_fields__)


@pytest.mark.parametrize(
    ("key", "value"), [("lookahead_m", 0.0), ("kappa", -1.0), ("settle_s", -1.0), ("lag_rad", math.nan)]
)
def test_settings_out_of_range_are_refused_by_name(key, value):
    with pytest.raises(ValueError, match=key):
        GuidanceSettings(**{key: value})
