"""What guidance asks for: the steering laws on a kinematic vehicle, and the horizon by its properties."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.core.geometry.frames import rotate, ssa, unrotate
from companion.core.guidance.guidance import horizon, start, step
from companion.core.guidance.path import Path, Waypoint
from companion.core.guidance.reference import GuidanceSettings
from companion.core.guidance.reference_row import Column

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


# --- LOS and ILOS on a kinematic vehicle --------------------------------------------------------------


def cross_track_history(config, y_e, psi, current=0.0, seconds=120.0):
    """A vehicle that turns onto psi_ref at up to 1 rad/s, beside a long line north, current to the east."""
    state = start(Path((Waypoint(0, 0), Waypoint(500, 0))), config, REST, REST, 0)
    eta, history = np.array([0.0, y_e, psi]), []
    for i in range(int(seconds * 10)):
        drift = unrotate(eta[2], 0.0, current)
        nu = (0.5 + drift[0], drift[1], 0.0)
        state, ref = step(state, config, eta, nu, i * TICK_NS)
        turn = np.clip(ref.psi_ref_rad - eta[2], -0.1, 0.1)
        eta = eta + np.array([*(0.1 * x for x in rotate(eta[2], nu[0], nu[1])), turn])
        history.append(ref.y_e_m)
    return np.array(history)


@settings(max_examples=12, deadline=None)
@given(st.floats(-8, 8), st.floats(-3, 3), st.floats(1.0, 4.0))
def test_los_converges_to_the_line_from_anywhere(y_e, psi, lookahead):
    config = GuidanceSettings(steering="los", lookahead_m=lookahead)
    assert abs(cross_track_history(config, y_e, psi)[-1]) < 0.01


@pytest.mark.parametrize(("y_e", "current"), [(3.0, -0.15), (-4.0, 0.1), (0.5, 0.2)])
def test_ilos_and_crab_compensation_remove_the_offset_that_a_current_leaves(y_e, current):
    left = cross_track_history(LOS, y_e, 0.0, current, 200.0)[-1]
    expected = LOS.lookahead_m * current / math.sqrt(0.5**2 - current**2)  # sin(psi) = -V_c / U
    assert left == pytest.approx(expected, abs=0.01)
    integral = GuidanceSettings(steering="los", kappa=0.3)
    assert abs(cross_track_history(integral, y_e, 0.0, current, 200.0)[-1]) < 0.02
    crab = GuidanceSettings(steering="los", crab=True)
    assert abs(cross_track_history(crab, y_e, 0.0, current, 200.0)[-1]) < 0.02


def test_los_horizon_is_the_papers_reference():
    state = start(SQUARE, LOS, (9, 9, 0), REST, 0)
    eta = (12.0, 10.0, 0.1)
    state, ref = step(state, LOS, eta, (0.4, 0, 0), TICK_NS)
    rows = horizon(state, LOS, eta, (0.4, 0, 0), TIMES)
    assert ref.psi_ref_rad == pytest.approx(-math.atan(1.0 / 2.0))
    assert rows[:, Column.PSI] == pytest.approx(ref.psi_ref_rad)
    assert rows[:, Column.U] == pytest.approx(0.5)
    assert rows[-1, [Column.NORTH, Column.EAST]] == pytest.approx((13.0, 9.0))
    assert not rows[:, Column.STATION].any()


# --- the horizon --------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(LEGS, st.floats(0, 1), st.floats(-1.5, 1.5), st.floats(-40, 40), st.floats(-0.1, 0.6))
def test_horizon_is_continuous_and_within_the_limits(legs, part, side, psi, u):
    path = path_of(legs)
    state = start(path, COURSE, (0, 0, psi), (u, 0, 0), 0)
    assume(state.course is not None and state.course.length_m > 1)
    for i in range(1, 6):  # let the projection catch up along the course
        north, east, angle = state.course.at(part * min(1.0, 0.3 * i))
        eta = (north - side * math.sin(angle), east + side * math.cos(angle), psi)
        state, ref = step(state, COURSE, eta, (u, 0, 0), i * TICK_NS)
    rows = horizon(state, COURSE, eta, (u, 0, 0), TIMES)
    assert rows.shape == (len(TIMES), len(Column))
    assert np.isfinite(rows).all()
    assert abs(rows[0, Column.PSI] - psi) <= math.pi
    assert rows[0, Column.PSI] == pytest.approx(ref.psi_ref_rad)
    limits = COURSE.limits
    assert np.max(np.abs(np.diff(rows[:, Column.PSI]))) <= 0.1 * limits.yaw_rate_rad_s + 1e-9
    assert np.allclose(np.diff(rows[:, Column.PSI]), 0.1 * rows[:-1, Column.R], atol=1e-12)
    assert np.all(np.diff(rows[:, Column.U]) <= 0.1 * limits.acceleration_m_s2 + 1e-9)
    assert np.all((rows[:, Column.U] >= 0) & (rows[:, Column.U] <= limits.cruise_m_s))
    moved = np.hypot(*np.diff(rows[:, :2], axis=0).T)
    assert np.all(moved <= 0.1 * rows[:-1, Column.U] + 1e-9)
    assert np.all((rows[:, Column.STATION] >= 0) & (rows[:, Column.STATION] <= 1))
    assert not rows[:, Column.V].any()


@settings(max_examples=40, deadline=None)
@given(LEGS, st.floats(-3, 3), st.floats(-50, 50), st.floats(-50, 50), st.sampled_from(["course", "los"]))
def test_turning_and_moving_the_world_turns_and_moves_the_reference(legs, angle, north, east, steering):
    config = GuidanceSettings(steering=steering)

    def moved(n, e):
        dn, de = rotate(angle, n, e)
        return north + dn, east + de

    def references(path, place, turn):
        state = start(path, config, (*place(-2.0, 0.3), 0.2 + turn), REST, 0)
        for i in range(1, 12):
            eta = (*place(-2.0 + 0.3 * i, 0.3 - 0.05 * i), 0.2 + turn)
            state, ref = step(state, config, eta, (0.4, 0, 0), i * TICK_NS)
        return ref, horizon(state, config, eta, (0.4, 0, 0), TIMES)

    path = path_of(legs)
    there = Path(tuple(Waypoint(*moved(w.north_m, w.east_m)) for w in path.waypoints))
    ref, rows = references(path, lambda n, e: (n, e), 0.0)
    assume(abs(abs(ref.psi_ref_rad - 0.2) - math.pi) > 1e-6)
    ref2, rows2 = references(there, moved, angle)
    assert (ref2.leg, ref2.phase) == (ref.leg, ref.phase)
    assert (ref2.x_e_m, ref2.y_e_m) == pytest.approx((ref.x_e_m, ref.y_e_m), abs=1e-6)
    assert rows2[:, Column.PSI] == pytest.approx(rows[:, Column.PSI] + angle, abs=1e-6)
    assert rows2[:, Column.U :] == pytest.approx(rows[:, Column.U :], abs=1e-6)
    expected = np.array([moved(*row[:2]) for row in rows])
    assert rows2[:, :2] == pytest.approx(expected, abs=1e-6)


def test_los_correction_fades_towards_the_end_where_the_position_itself_counts():
    path = Path((Waypoint(0, 0), Waypoint(10, 0)))
    headings = []
    for north in (5.0, 9.3):
        state = start(path, COURSE, REST, REST, 0)
        for i in range(1, 60):
            eta = (min(0.25 * i, north), 0.4, 0.0)
            state, ref = step(state, COURSE, eta, (0.5, 0, 0), i * TICK_NS)
        assert state.phase == "leg"
        headings.append(ref.psi_ref_rad)
    full = -math.atan(0.4 / COURSE.lookahead_m)
    assert headings == pytest.approx([full, 0.7 * full])


def test_the_turn_at_a_reversal_does_not_change_its_mind_under_noise():
    """Seed 3: target heading pi away, measured heading noisy by 3 degrees about 0."""
    rng = np.random.default_rng(3)
    state = start(Path((Waypoint(0, 0), Waypoint(-10, 0))), COURSE, REST, REST, 0)
    psi, signs = 0.0, set()
    for i in range(1, 60):
        seen = (0.0, 0.0, ssa(psi + rng.normal(0, math.radians(3))))
        state, ref = step(state, COURSE, seen, REST, i * TICK_NS)
        lead = ref.psi_ref_rad - seen[2]
        psi += 0.3 * lead if abs(lead) > 0.2 else 0.0
        if i > 5 and abs(ssa(psi - math.pi)) > 0.5:
            signs.add(math.copysign(1, lead))
    assert len(signs) == 1
    assert abs(ssa(psi - math.pi)) < 0.5
