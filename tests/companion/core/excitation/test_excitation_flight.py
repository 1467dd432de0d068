"""Flying an excitation: inside the fence whatever it asks for, back to the middle, within the thrusters' limits."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.configuration.site_file import Site
from companion.core.configuration.tables import ConfigError
from companion.core.control.allocation import force_limits
from companion.core.excitation.file import Idle, Steps, Zigzag
from companion.core.excitation.flight import BEGINNING, HOME_LIMIT_S, Flight
from companion.core.excitation.pen import Pen, stopping_distance_m
from companion.core.geometry.fence import Fence
from sim.world.environment import Weather
from tests.support.excitation_fixture import BASIN, LIBRARY, feasible, flown, of, square
from tests.support.vessel_fixtures import boat

WILD = of(
    Steps(name="run", X=0.6, levels=(1.0, -1.0), hold_s=12.0),
    Steps(name="side", Y=0.9, levels=(1.0, -1.0), hold_s=12.0),
    Steps(name="slant", X=0.3, Y=0.3, N=0.1, hold_s=12.0),
    Idle(name="drift", duration_s=20.0),
)


# --- the pen -----------------------------------------------------------------------------------------------


@given(st.lists(st.floats(-5, 35), min_size=2, max_size=2))
def test_clearance_is_the_distance_to_the_nearest_point_of_the_fence(place):
    """Oracle: points every centimetre along the fence; inside by the site's own rule."""
    corners = np.array(((0.0, 0.0), (20.0, 2.0), (30.0, 25.0), (3.0, 18.0)))
    site = Site(name="x", lat_deg=0, lon_deg=0, fence=tuple(map(tuple, corners)), source="assumed")
    edges = [np.linspace(a, b, 4000) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    far = np.linalg.norm(np.concatenate(edges) - place, axis=1).min()
    got = float(Pen(site).clearance(np.array([place]))[0])
    assert abs(got) == pytest.approx(far, abs=0.01)
    assert far < 0.01 or (got > 0) == site.inside(*place)


@given(st.floats(0, 3), st.floats(1, 100), st.floats(0.1, 50), st.one_of(st.just(0.0), st.floats(0.5, 60)))
def test_stopping_distance_is_that_of_an_integration(speed, mass, damping, force):
    w, s, h = speed, 0.3 * speed, 0.002 * mass / damping
    while w > 1e-4 * speed + 1e-9:
        k = (force + damping * w) / mass
        step = min(h, w / k)
        s += step * (w - step * k / 2)
        w -= step * k
    assert stopping_distance_m(-speed, mass, damping, force, 0.3) == pytest.approx(s, rel=0.01, abs=1e-3)


def test_the_middle_of_a_basin_and_of_a_long_one():
    assert Pen(BASIN).middle == pytest.approx([15.0, 15.0])
    long = Site(name="x", lat_deg=0, lon_deg=0, fence=((0, 0), (10, 0), (10, 40), (0, 40)), source="assumed")
    assert Pen(long).middle == pytest.approx([5.0, 20.0], abs=0.5)


def test_a_fence_that_is_too_small_or_hides_its_corners_is_refused():
    with pytest.raises(ConfigError, match=r"x.toml: margin_m \+ return_m: 4.5 m, but .* more than 4.0 m"):
        Flight(LIBRARY, boat("aritra"), square(8.0), name="x.toml")
    u = ((0, 0), (60, 0), (60, 60), (0, 60), (0, 40), (40, 40), (40, 20), (0, 20))
    with pytest.raises(ConfigError, match="hides some of its corners"):
        Flight(LIBRARY, boat("aritra"), Site(name="u", lat_deg=0, lon_deg=0, fence=u, source="assumed"), name="x.toml")


def test_the_middle_keeps_off_a_zone_of_the_mission_and_a_pen_without_room_is_refused():
    zone = Fence((), (((10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0)),))
    pen = Pen(BASIN, zone)
    clear_m = float(pen.clearance(pen.middle[None])[0])
    assert 5.0 < clear_m <= min(Fence((BASIN.fence,)).clearance(*pen.middle), zone.clearance(*pen.middle))
    inner = Pen(BASIN, Fence((((20.0, 20.0), (28.0, 20.0), (28.0, 28.0), (20.0, 28.0)),)))
    assert inner.middle == pytest.approx([24.0, 24.0], abs=0.1)
    wide = Fence((), (((4.0, 4.0), (26.0, 4.0), (26.0, 26.0), (4.0, 26.0)),))
    with pytest.raises(ConfigError, match=r"x.toml: margin_m .* those of the mission no place is more than 1\.9 m"):
        Flight(LIBRARY, boat("aritra"), BASIN, name="x.toml", others=wide)


# --- the flight --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 3, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2, 4, 5))])
def test_a_boat_a_third_off_its_file_stays_within_the_margin_in_current_and_wind(seed):
    """Twice as much force as the library asks for; the place is told with an error of 0.2 m."""
    rng = np.random.default_rng(seed)
    sky = Weather(
        V_c_m_s=0.1, beta_c_deg=rng.uniform(0, 360), V_w_m_s=3.0, beta_w_deg=rng.uniform(0, 360), gustiness=0.2
    )
    flight = flown(WILD, seed=seed, share=0.33, weather=sky, error_m=0.2)
    assert flight.statuses[-1].phase == "done" and flight.clearance_m > WILD.margin_m - 0.4
    assert np.hypot(*flight.x[:, 3:5].T).max() > 0.8, "it was moving"


@settings(max_examples=8, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(excitation=feasible, seed=st.integers(0, 99))
@pytest.mark.long
def test_whatever_is_asked_for_the_boat_stays_inside_and_within_its_limits(excitation, seed):
    flight = flown(excitation, site=square(24.0), seed=seed, share=0.2, error_m=0.1, limit_s=30.0)
    lower, upper = force_limits(boat("aritra"))
    assert flight.clearance_m > excitation.margin_m - 0.4
    assert (flight.f_n >= lower).all() and (flight.f_n <= upper).all()
    flying = flight.f_n[[s.phase != "done" for s in flight.statuses]]
    assert np.abs(np.diff(flying, axis=0)).max(initial=0) <= 12.0 + 1e-6, "120 N/s at 10 Hz, but neutral at once"


def test_turning_back_is_told_and_the_segment_goes_on_where_it_was_left():
    flight = flown(of(Steps(name="run", X=0.4, hold_s=20.0)))
    told = [n for n in flight.notes if "turned back" in n]
    assert told and "segment 1 of 1, run," in told[0] and any("goes on at" in n for n in flight.notes)
    steps = [s for s in flight.statuses if s.phase == "fly"]
    assert len(steps) == pytest.approx(200, abs=4), "flown for its 20 s in all"
    assert (np.diff([s.elapsed_s for s in steps]) >= 0).all()
    assert flight.notes[-1] == "excitation done" and np.hypot(*flight.x[-1, 3:5]) < 0.1


@pytest.mark.parametrize(("side_m", "X"), [(9.4, 1.0), (10.0, 1.0), (9.4, 0.6)])
def test_it_stays_inside_a_fence_hardly_larger_than_what_is_near_the_middle(side_m, X):
    middle = (side_m / 2, side_m / 2, 0.0)
    flight = flown(of(Steps(name="run", X=X, hold_s=8.0)), site=square(side_m), eta=middle, limit_s=100.0)
    assert any("turned back" in note for note in flight.notes) and flight.clearance_m > 1.5 - 0.1
    assert flight.statuses[-1].phase == "done", "flown to its end in parts"


@pytest.mark.parametrize("name", ["aritra", "twin"])
@pytest.mark.parametrize("eta", [(4.0, 4.0, 0.0), (26.0, 15.0, 1.5), (15.0, 3.0, 3.0)])
def test_from_anywhere_it_goes_to_the_middle_first(name, eta):
    flight = flown(of(Idle(name="rest", duration_s=1.0)), name=name, eta=eta, share=0.3)
    assert flight.statuses[0].phase == "home" and flight.statuses[-1].phase == "done"
    assert np.linalg.norm(flight.x[-1, :2] - 15.0) < 3.2


def test_a_zigzag_swings_by_its_angle_to_both_sides():
    flight = flown(of(Zigzag(name="z", X=0.1, N=0.06, switch_deg=15.0, duration_s=25.0)), seed=2)
    psi = np.array([x[2] for x, s in zip(flight.x, flight.statuses, strict=True) if s.phase == "fly"])
    off = np.rad2deg(psi - psi[0])
    assert 15 < off.max() < 90 and -90 < off.min() < -15


POST = Fence((), (((19.0, 14.0), (20.0, 14.0), (20.0, 16.0), (19.0, 16.0)),))
"""Two metres wide, in view of the middle, which is at north 10.2, east 10.2 m with it."""


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_a_boat_a_third_off_its_file_keeps_out_of_a_zone_of_the_mission_and_comes_home(seed):
    flight = flown(WILD, seed=seed, share=0.33, error_m=0.2, others=POST)
    assert flight.statuses[-1].phase == "done" and flight.clearance_m > WILD.margin_m - 0.4
    assert any("turned back" in note for note in flight.notes)


def test_it_does_not_go_home_through_a_zone_and_starts_nothing_behind_one():
    behind = flown(WILD, eta=(26.0, 18.0, 0.0), others=POST)
    assert behind.notes == [
        "excitation ended: a fence of the mission is on the way to the middle (north 10.2, east 10.2 m): "
        "bring the boat past it"
    ]
    assert not behind.f_n.any() and behind.statuses[-1].phase == "failed"
    flight = Flight(WILD, boat("aritra"), BASIN, name="x", others=POST)
    rooms = [flight.room_m(np.array([25.0, east, 0.0]), np.zeros(3), np.zeros(4)) for east in (18.0, 26.0)]
    assert rooms[0] <= 0.0 and rooms[1] > 1.5, "no room where a zone is between the boat and the middle"


def test_who_cannot_come_home_gives_up_in_neutral():
    """A boat that a rope holds 10 m from the middle."""
    flight, state = Flight(WILD, boat("aritra"), BASIN, name="x"), BEGINNING
    for k in range(round(HOME_LIMIT_S * 10) + 5):
        state, f, note = flight.step(state, np.array([5.0, 15.0, 0.0]), np.zeros(3), k * 100_000_000)
        if note:
            break
    assert state.phase == "failed" and "not back at the middle" in note and not f.any() and flight.is_over(state)


def test_where_the_position_may_be_off_by_more_than_there_is_room_nothing_is_flown():
    """Two sigmas of 3.6 m, as of plain GNSS, in a square of 10 m."""
    excitation = of(Steps(name="run", X=1.0, hold_s=8.0))
    flight, state, notes = Flight(excitation, boat("aritra"), square(10.0), name="x"), BEGINNING, []
    while not flight.is_over(state) and len(notes) < round(HOME_LIMIT_S * 10) + 5:
        t_ns = len(notes) * 100_000_000
        state, f, note = flight.step(state, np.array([5.0, 5.0, 0.0]), np.zeros(3), t_ns, spread_m=3.6)
        assert np.abs(f).max() < 1e-6
        notes.append(note)
    assert [n for n in notes if n] == ["excitation ended: at the middle no rest, or no room to fly, after 90 s"]


def test_after_a_break_it_finds_its_way_back_first():
    flight, state = Flight(WILD, boat("aritra"), BASIN, name="x"), BEGINNING
    middle = np.array([15.0, 15.0, 0.0])
    for k in range(30):
        state, _, _ = flight.step(state, middle, np.zeros(3), k * 100_000_000)
    assert state.phase == "fly" and state.elapsed_s == pytest.approx(2.9)
    away = np.array([15.0, 21.0, 0.0])
    state, _, _ = flight.step(state, away, np.zeros(3), 9_000_000_000)
    assert state.phase == "home" and state.elapsed_s == pytest.approx(2.9)
    state, _, note = flight.step(state, middle, np.zeros(3), 9_100_000_000)
    assert state.phase == "fly" and "goes on at 2.9 s" in note


@pytest.mark.parametrize("period_s", [0.1, 0.6, 1.0])
def test_it_flies_and_turns_back_whatever_the_period(period_s):
    flight = flown(of(Steps(name="run", X=0.4, hold_s=20.0)), period_s=period_s)
    assert flight.statuses[-1].phase == "done" and flight.clearance_m > 1.4
    flying = [s.elapsed_s for s in flight.statuses if s.phase == "fly"]
    assert len(flying) * period_s == pytest.approx(20.0, abs=4 * period_s) and max(flying) > 20.0 - 2 * period_s
    assert any("turned back" in note for note in flight.notes)
    assert np.abs(flight.f_n[0]).max() <= 120.0 * period_s + 1e-6, "from the first tick on by 120 N/s"


def test_room_shrinks_with_speed_and_caution_covers_a_heavier_boat():
    flight = Flight(WILD, boat("aritra"), BASIN, name="x")
    eta = np.array([15.0, 15.0, 0.0])
    rooms = [flight.room_m(eta, np.array([u, 0.0, 0.0]), np.zeros(4)) for u in (0.0, 0.5, 1.0, 1.5)]
    assert (np.diff(rooms) < 0).all() and rooms[0] == pytest.approx(14.5)
    careful = Flight(replace(WILD, caution=3.0), boat("aritra"), BASIN, name="x")
    assert careful.room_m(eta, np.array([1.0, 0.0, 0.0]), np.zeros(4)) < rooms[2] - 1.0
