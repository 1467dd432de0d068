"""The NMPC keeps off the fence: any shape, also from beyond it, and at no cost where the fence is far."""

from functools import cache

import numpy as np
import pytest

from companion.boat.load_run import setup_of
from companion.core.control.nmpc import Actuation, Nmpc, NmpcSettings
from companion.core.geometry.fence import Fence
from companion.core.guidance.reference_row import Column
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import Pilot
from companion.jit import compile_loops
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup
from tests.companion.core.control.nmpc_world import controller, request, variant
from tests.support.drive_fixture import mission_text, nmpc, setup

MARGIN_M = NmpcSettings().fence_margin_m
WIDE = Fence((((-100.0, -100.0), (100.0, -100.0), (100.0, 100.0), (-100.0, 100.0)),))
NOTCHED = Fence((((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (2.0, 10.0), (2.0, 1.0), (-2.0, 1.0), (-2.0, 10.0),
                  (-10.0, 10.0)),))  # fmt: skip
"""A basin with a jetty, 4 m wide, from the east side to its middle."""


@cache
def planner(fence):
    vessel = variant(4)
    return Nmpc(StructuredModel.of(vessel), Actuation.of(vessel), NmpcSettings(), lambda: 0.0, fence, compile_loops)


def straight(north, east, angle, speed):
    """21 rows of a path from (north, east) at `speed`."""
    rows = np.zeros((21, 8))
    for k, row in enumerate(rows):
        far = 0.2 * k * speed
        row[[Column.NORTH, Column.EAST]] = north + far * np.cos(angle), east + far * np.sin(angle)
        row[[Column.PATH_ANGLE, Column.PSI, Column.U]] = angle, angle, speed
    return rows


def test_a_fence_out_of_reach_changes_nothing():
    asked = request([1.0, 2.0, 0.3, 0.4, 0.0, 0.0, *[0.0] * 4], straight(1.0, 2.0, 0.3, 0.5))
    free, _ = controller().solve(asked, None)
    fenced, _ = planner(WIDE).solve(asked, None)
    assert np.array(fenced.f_n) == pytest.approx(np.array(free.f_n), abs=1e-6)


@pytest.mark.parametrize(
    ("place", "angle"), [((0.0, -1.6), np.pi / 2), ((5.0, 8.0), np.pi), ((-5.0, 8.0), 0.0), ((8.0, 0.0), 0.0)],
    ids=["the jetty's head", "its north side", "its south side", "the north wall"],
)  # fmt: skip
def test_a_path_into_the_fence_is_not_followed_across_it(place, angle):
    """Plans of 4 s at 0.8 m/s towards it: repeated real-time iterations as on the boat, then 4 s along the last one."""
    nmpc, warm = planner(NOTCHED), None
    x0 = [*place, angle, 0.6, 0.0, 0.0, *[3.0] * 4]
    for _ in range(4):
        plan, warm = nmpc.solve(request(x0, straight(*place, angle, 0.8)), warm)
        assert plan.status == "ok", plan.reason
    room = [NOTCHED.clearance(*x[:2]) for x in plan.x]
    free, _ = controller().solve(request(x0, straight(*place, angle, 0.8)), None)
    assert min(NOTCHED.clearance(*x[:2]) for x in free.x) < min(room) - 0.2
    assert min(room) > 0.2, "margin 0.5 m, softly"


def test_from_beyond_the_fence_the_plan_leads_back():
    """Along the north wall, 0.5 m beyond it."""
    plan, _ = planner(NOTCHED).solve(request([10.5, 0.0, -np.pi / 2, 0.4, 0.0, 0.0, *[0.0] * 4],
                                             straight(10.5, 0.0, -np.pi / 2, 0.5)), None)  # fmt: skip
    assert plan.status == "ok"
    room = [NOTCHED.clearance(*x[:2]) for x in plan.x]
    assert room[-1] > room[0] + 0.4 and room[-1] > 0


def driven(fenced):
    """A mission whose second waypoint lies 4 m beyond the basin's north wall, 22 s of it; seed 3."""
    told = setup()
    texts = {**told.files, "mission.toml": mission_text(((25.0, 15.0), (33.5, 15.0)))}
    mine = setup_of(texts, {name: name for name in texts}).pilot
    vessel, quick = mine.vessel, NmpcSettings(rescue_time_s=60.0)
    assert (vessel, mine.fence) == (setup().pilot.vessel, setup().pilot.fence), "the boat of the voyages, and its fence"
    solver = (
        nmpc()
        if fenced
        else Nmpc(StructuredModel.of(vessel), Actuation.of(vessel), quick, lambda: 0.0, compiler=compile_loops)
    )
    world = World(WorldSetup(vessel, mine.site, start=(23.0, 15.0, 0.0)), 3)
    run = SteppedRun(world, Pilot(mine), solver.solve)
    rooms = []

    def look(run):
        rooms.append(mine.fence.clearance(*run.world.plant.motion.x[:2]))
        return run.state.helm.mode == "safe"

    run.run(look, 22.0)
    return run, rooms


def test_a_mission_beyond_the_fence_ends_at_it_and_not_in_an_emergency():
    run, rooms = driven(True)
    assert run.state.helm.mode == "auto" and min(rooms) > 0.1
    assert min(rooms) < 1.0, "it got there"


@pytest.mark.long
def test_without_the_soft_fence_the_table_stops_the_boat_at_it():
    run, rooms = driven(False)
    assert run.state.helm.mode == "safe" and "outside the fence" in run.state.helm.why
    assert -0.3 < rooms[-1] < 0.3, "as soon as the estimate was across"
    leases = [m for m in run.messages if type(m).__name__ == "OverrideLease"]
    assert leases[-1].source == "neutral" and set(leases[-1].pwm_us) == {1500}
