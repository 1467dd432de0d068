"""The paper's preset on its own model repeats the paper (a short course: two legs of 3.5 m, one turn)."""

import numpy as np
import pytest

from companion.core.guidance.path import Path, Waypoint
from companion.core.model.thrusters import configuration_matrix
from sim.bench.controller.paper_problem import PAPER
from sim.fitting.taylor.abkowitz import AbkowitzModel
from sim.studies.paper.closed_loop import metrics, next_leg, run, variants
from sim.studies.paper.nmpc import PaperNmpc
from tests.support.vessel_fixtures import boat

pytestmark = pytest.mark.long

COURSE = ((4.0, 4.0), (4.0, 7.5), (7.5, 7.5))
MODEL = AbkowitzModel(configuration_matrix(boat("aritra")), 0.1)


@pytest.fixture(scope="module")
def tracks():
    """Every variant: without noise through the turn, with noise (seed 1) on the first leg."""
    cases = variants().items()
    quiet = {name: run(MODEL, s, waypoints=COURSE) for name, (s, noisy) in cases if not noisy}
    noise = np.random.default_rng(1)
    return quiet | {name: run(MODEL, s, waypoints=COURSE[:2], noise=noise) for name, (s, noisy) in cases if noisy}


def test_the_preset_is_section_5_1():
    assert (PAPER.s_u, PAPER.s_psi, PAPER.s_v, PAPER.s_c) == (2.0, 1.0, 1.0, 0.001)
    assert (PAPER.stages, PAPER.step_s, PAPER.applied) == (10, 0.1, 1)
    assert (PAPER.c_min_kgf, PAPER.c_max_kgf, PAPER.u_des_m_s) == (-4.0793, 5.1536, 0.5)


def test_it_tracks_the_waypoints_at_half_a_metre_per_second(tracks):
    track, m = tracks["paper"], metrics(tracks["paper"])
    assert track.passed == len(COURSE) - 1
    assert m["converged_share"] == 1.0
    first_leg = track.leg == 0
    assert np.abs(track.nu[first_leg, 0] - 0.5).max() < 0.01
    assert np.abs(track.y_e_m[first_leg]).max() < 0.02
    assert np.abs(track.y_e_m[-1]) < 0.15
    assert track.nu[-1, 0] == pytest.approx(0.5, abs=0.05)


def test_thrust_stays_within_the_bounds(tracks):
    for track in tracks.values():
        assert track.c_kgf.min() >= PAPER.c_min_kgf - 1e-6
        assert track.c_kgf.max() <= PAPER.c_max_kgf + 1e-6


def test_without_control_cost_the_thrust_doubles_and_noise_makes_it_chatter(tracks):
    m = {name: metrics(track) for name, track in tracks.items()}
    assert m["no_control_cost"]["thrust_rms_kgf"] > 1.5 * m["paper"]["thrust_rms_kgf"]
    assert m["no_control_cost_noisy"]["thrust_rms_kgf"] > 3 * m["paper_noisy"]["thrust_rms_kgf"]
    assert m["no_control_cost_noisy"]["thrust_step_rms_kgf"] > 5 * m["paper_noisy"]["thrust_step_rms_kgf"]


def test_two_applied_actions_make_pairs_of_thrusters_oscillate(tracks):
    one, two = metrics(tracks["paper"]), metrics(tracks["two_actions"])
    assert one["thrust_reversals_share"] < 0.05
    assert two["thrust_reversals_share"] > 0.5


def test_the_turn_leaves_the_validity_box_and_the_legs_do_not(tracks):
    track = tracks["paper"]
    assert 0.0 < track.outside < 0.5
    only_leg = run(MODEL, waypoints=COURSE[:2])
    assert only_leg.outside == 0.0


def test_a_missed_waypoint_is_switched_on_along_track_passage():
    path = Path(tuple(Waypoint(*w) for w in COURSE))
    missed = np.array([2.5, 7.55, 0, 0, 0, 0])
    assert next_leg(path, 0, missed) == 1
    assert next_leg(path, 0, np.array([2.5, 7.4, 0, 0, 0, 0])) == 0
    assert next_leg(path, 0, np.array([4.0, 6.6, 0, 0, 0, 0])) == 1


def test_a_plan_says_whether_it_converged():
    plan = PaperNmpc(MODEL).plan(0.0, np.array([0.5, 0, 0]), 0.2)
    assert plan.converged and plan.c_kgf.shape == (10, 4)
    assert plan.c_kgf[0, 0] > plan.c_kgf[0, 1]  # port pushes harder: to starboard
