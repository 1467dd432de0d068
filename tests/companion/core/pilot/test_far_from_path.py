"""A boat that is far from where it should be comes back as slowly as it drives, and turns round at a corner."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.boat.load_run import EXAMPLES, load_setup, setup_of
from companion.core.geometry.frames import rotate, unrotate
from companion.core.guidance.guidance import start, step
from companion.core.guidance.path import Path, Waypoint
from companion.core.guidance.progress import Passage
from companion.core.guidance.reference import GuidanceSettings, within_reach
from companion.core.guidance.reference_row import REACH_M, Column
from companion.core.messages import GroundTruth, GuidanceReference, OperatorCommand
from companion.core.pilot.pilot import Pilot
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup
from tests.support.drive_fixture import nmpc, setup, voyage

TICK_NS = 100_000_000
FAR = 'name = "far"\n[[waypoints]]\nnorth_m = 20\neast_m = 12\nacceptance_m = 15\n'
"""Passed at once, 12 m away: the boat then keeps its station there."""


@cache
def far_pilot() -> Pilot:
    texts = {**load_setup(EXAMPLES / "aritra.toml").files, "mission.toml": FAR}
    return Pilot(setup_of(texts, {name: name for name in texts}).pilot)


def test_a_station_far_away_is_gone_to_no_faster_than_the_boat_drives():
    known = setup().pilot
    run = SteppedRun(World(WorldSetup(known.vessel, known.site, start=(8.0, 12.0, 0.0)), 4), far_pilot(), nmpc().solve)
    run.run(lambda _: False, 45.0)
    truths = run.of(GroundTruth)
    assert max(math.hypot(t.u_m_s, t.v_m_s) for t in truths) < 1.0
    assert math.dist((truths[-1].north_m, truths[-1].east_m), (20.0, 12.0)) < 0.3


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3), st.floats(0, 1))
def test_the_reference_comes_within_reach_of_a_boat_that_is_far_from_it(ahead_m, aside_m, angle, weight):
    rows = np.tile([2.0, -1.0, angle, angle, 0.5, 0.0, 0.0, weight], (5, 1))
    rows[:, Column.NORTH] += 0.05 * np.arange(5)
    north, east = rotate(angle, ahead_m, aside_m)
    eta = (2.0 + north, -1.0 + east, 0.3)
    moved = within_reach(rows.copy(), eta)
    assert moved - moved[0] == pytest.approx(rows - rows[0], abs=1e-9)  # as a whole
    x_e, y_e = unrotate(angle, eta[0] - moved[0, 0], eta[1] - moved[0, 1])
    assert y_e == pytest.approx(max(-REACH_M, min(REACH_M, aside_m)), abs=1e-9)
    counts = weight * ahead_m
    assert x_e == pytest.approx(ahead_m - counts + max(-REACH_M, min(REACH_M, counts)), abs=1e-9)
    if abs(counts) <= REACH_M and abs(aside_m) <= REACH_M:
        assert (moved == rows).all()


def test_a_boat_that_stands_a_little_before_a_reversal_turns_round():
    path = Path((Waypoint(0, 0), Waypoint(4, 0), Waypoint(0, 0)))
    state = start(path, GuidanceSettings(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0)
    for k in range(1, 200):
        state, reference = step(
            state, GuidanceSettings(), (min(0.05 * k, 3.96), 0.0, 0.0), (0.0, 0.0, 0.0), k * TICK_NS
        )
    assert abs(reference.psi_ref_rad) > 0.5
    assert state.passed[1] == Passage(1, "circle", pytest.approx(0.04), state.passed[1].t_ns)


def test_who_holds_in_between_has_passed_what_it_has():
    run = voyage(6)
    run.run(lambda r: bool(r.of(GuidanceReference)) and r.of(GuidanceReference)[-1].waypoints_passed == 1, 60.0)
    run.feed([OperatorCommand(t_ns=run.world.t_ns, command="hold")])
    run.run(lambda _: False, 1.0)
    assert run.of(GuidanceReference)[-1].phase == "station"
    assert run.of(GuidanceReference)[-1].waypoints_passed == 1
