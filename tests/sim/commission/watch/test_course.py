"""Changes are told by evidence with their size, and hardly ever where there are none; missions made up by their law."""

from dataclasses import replace

import numpy as np
import pytest

from sim.commission.watch.causes import DRIFT, FIRST, unexplained, watched
from sim.commission.watch.course import BoatCourse, course, threshold_nats
from sim.commission.watch.mission_fit import MissionInformation, boat_effects
from sim.fitting.engine.parameters import HULL, file_values
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
WATCHED = watched(VESSEL, boat_effects(VESSEL))
B = len(WATCHED.names)
CALM, ROUGH = (0.01, 0.005, 0.005), (0.05, 0.05, 0.05)
THRUST = (0.11, 0.06, 0.18)


def cause(name: str):
    return next(c for c in WATCHED.causes if c.name == name)


def seen_by_a_log() -> np.ndarray:
    """J (B - 2, B): what motion shows of theta. Fouling is all damping, load is inertia: neither is seen by itself."""
    J = np.diag(1 / WATCHED.scale)
    M = dict(zip(HULL, file_values(VESSEL), strict=False))
    own = {name: i for i, name in enumerate(WATCHED.names)}
    for name in ("X_u_N_s_m", "Y_v_N_s_m", "N_r_N_m_s", "X_uu_N_s2_m2", "Y_vv_N_s2_m2", "N_rr_N_m_s2"):
        J[own[f"base:{name}"], own["hull_fouling"]] = 1.0
    for name in ("M11_kg", "M22_kg"):
        J[own[f"base:{name}"], own["payload"]] = 1.0 / M[name]
    return np.delete(J, [own["hull_fouling"], own["payload"]], axis=0)


J = seen_by_a_log()
SIGMA = 0.005
PRECISION = J.T @ J / SIGMA**2


def missions(seed: int, count: int, change=lambda k: np.zeros(B), latent=CALM, excess: float = 1.0):
    """Missions by the very model that a watch assumes; `excess`: variance of what a log says over what it claims."""
    rng = np.random.default_rng(seed)
    theta, out = FIRST * WATCHED.scale * rng.normal(size=B), []
    for k in range(count):
        theta = theta + DRIFT * WATCHED.scale * rng.normal(size=B)
        blank = MissionInformation(WATCHED.names, PRECISION, np.zeros(B), {}, latent, THRUST)
        feigned = unexplained(blank) * WATCHED.scale * rng.normal(size=B)
        seen = J @ (theta + change(k) + feigned) + np.sqrt(excess) * SIGMA * rng.normal(size=len(J))
        out.append(replace(blank, eta=J.T @ seen / SIGMA**2))
    return out


def taken(logs) -> BoatCourse:
    return course(logs, WATCHED, [np.zeros(B)] * len(logs))


def step(name: str, size: float, onset: int):
    return lambda k: size * cause(name).direction * (k >= onset)


@pytest.mark.parametrize("excess", [1.0, 6.0])
@pytest.mark.long
def test_no_change_is_told_in_two_hundred_missions_without_one(excess):
    found = taken(missions(1, 200, excess=excess))
    assert found.changes == ()
    assert max(m.best[0] for m in found.missions) < threshold_nats(len(WATCHED.causes))


@pytest.mark.parametrize("name", [c.name for c in WATCHED.causes])
def test_every_cause_is_told_by_its_name_within_two_missions_with_its_size(name):
    own = cause(name)
    size = {"thruster": -3 * own.smallest, "surge drag": 1.0}.get(own.kind, 3 * own.smallest)  # a gust looks like drag
    (change,) = taken(missions(2, 14, step(name, size, 9))).changes
    assert change.cause.name == name and change.onset == 9 and change.told <= 10
    assert abs(change.size) == pytest.approx(abs(size), rel=0.2)
    assert change.ci95[0] < change.size < change.ci95[1]


def test_a_change_below_the_smallest_size_worth_a_name_is_learned_but_not_told():
    own = cause("thruster_gain:rear_port")
    found = taken(missions(3, 20, step(own.name, -0.6 * own.smallest, 9)))
    assert found.changes == ()
    learned = found.missions[-1].belief.mean - found.missions[8].belief.mean
    assert own.direction @ learned == pytest.approx(-0.6 * own.smallest, abs=0.015)


def test_a_change_during_a_mission_gets_its_size_from_the_next_one():
    own = cause("hull_fouling")
    found = taken(missions(4, 12, lambda k: own.direction * (0.0, 0.12, 0.4)[min(max(k - 8, 0), 2)]))
    (change,) = found.changes
    assert change.during and change.onset == 9
    assert change.size == pytest.approx(0.4, rel=0.2)


def test_rough_missions_say_less_so_that_a_change_is_told_later_or_not_at_all():
    logs = missions(5, 9) + missions(5, 11, step("hull_fouling", 0.2, 0), latent=ROUGH)[9:]
    rough, calm = taken(logs), taken(missions(5, 11, step("hull_fouling", 0.2, 9)))
    assert max(m.best[0] for m in rough.missions[9:]) < calm.missions[-1].best[0] / 3


def test_two_changes_one_after_the_other_are_both_told():
    first, second = step("thruster_gain:front_port", -0.25, 6), step("payload", 9.0, 14)
    found = taken(missions(6, 20, lambda k: first(k) + second(k)))
    assert [c.cause.name for c in found.changes] == ["thruster_gain:front_port", "payload"]


def test_belief_follows_a_change_and_predicts_the_next_missions_better_than_the_file():
    found = taken(missions(7, 16, step("hull_fouling", 0.4, 9)))
    assert all(m.gain_nats > 10 for m in found.missions[11:])


def test_surprising_logs_count_for_less():
    plain, wild = (taken(missions(8, 20, excess=x)).missions[-1].scale for x in (1.0, 12.0))
    assert wild > 1.5 * plain


def test_the_course_of_the_first_missions_does_not_depend_on_later_ones():
    logs = missions(9, 14, step("hull_fouling", 0.3, 9))
    for one, other in zip(taken(logs[:8]).missions, taken(logs).missions, strict=False):
        np.testing.assert_array_equal(one.belief.mean, other.belief.mean)
