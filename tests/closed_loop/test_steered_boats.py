"""A rudder boat and an azimuth boat over the same wires on the stepped clock: driven, held, stopped, fallen silent."""

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.constants import NEUTRAL_US
from companion.core.messages import (
    Alert,
    ManualInput,
    MissionPoint,
    NewMission,
    OperatorCommand,
    OverrideLease,
    PlanResult,
    Tick,
)
from companion.core.pilot.thrust_command import DRIFTS
from sim.world.environment import Weather
from sim.world.stepped import PEER, SteppedRun
from sim.world.world import World, WorldSetup
from tests.support.drive_fixture import CORNER, START, driving, figures, nmpc, pilot, settled, setup, voyage

ROUGH = {"weather": Weather(V_c_m_s=0.1, beta_c_deg=70.0, V_w_m_s=3.0, beta_w_deg=200.0, gustiness=0.2),
         "mismatch": 0.1}  # fmt: skip
CROSS_M = 0.3
"""Largest cross-track error, RMS on straight parts, in calm water."""
BOATS = ["rudder", pytest.param("azimuth", marks=pytest.mark.long)]


def no_plan(request, warm):
    """A solver that fails."""
    return PlanResult(t_ns=request.t_ns, index=request.index, status="failed", reason="test", solve_time_s=0.0,
                      iterations=0, cost=0.0, f_n=(), x=()), warm  # fmt: skip


@cache
def driven(name: str):
    run = voyage(1, vessel=name)
    assert run.run(settled(3.0), 110.0), f"not done: {run.state.guidance.phase}, {run.state.helm}"
    return run


@pytest.mark.parametrize("name", BOATS)
@pytest.mark.long
def test_it_passes_all_waypoints_on_its_path_by_its_plans(name):
    run = driven(name)
    assert [p.waypoint for p in run.state.passed] == list(range(len(CORNER)))
    assert figures(run)["cross_track_rms_m"] <= CROSS_M
    ours = [lease for lease in run.of(OverrideLease) if lease.source != "neutral"]
    assert sum(lease.source == "plan" for lease in ours) >= 0.99 * len(ours) > 250
    assert [lease.index for lease in run.of(OverrideLease)] == [tick.index for tick in run.of(Tick)]
    assert {len(lease.f_command_n) for lease in ours} == {len(run.pilot.settings.vessel.controls)}
    assert all(a.level == "info" or a.text == DRIFTS for a in run.of(Alert)), [a.text for a in run.of(Alert)]


@pytest.mark.long
def test_at_the_end_the_rudder_boat_is_neutral_and_drifts_and_says_so():
    run = driven("rudder")
    last = run.of(OverrideLease)[-1]
    assert (last.source, last.reason, set(last.pwm_us)) == ("neutral", DRIFTS, {NEUTRAL_US})
    assert np.abs(run.world.plant.motion.x[6:]).max() < 0.01, "thrust is off, the servo centred"
    assert [a.text for a in run.of(Alert)].count(DRIFTS) == 1


@pytest.mark.long
def test_at_the_end_the_azimuth_boat_keeps_station():
    got = figures(driven("azimuth"))
    assert got["station_error_m"] <= 0.4 and got["station_error_deg"] <= 6.0


@pytest.mark.parametrize("name", BOATS)
@pytest.mark.long
def test_stop_and_silence_are_neutral_for_every_actuator(name):
    run = voyage(5, vessel=name)
    assert run.run(lambda r: driving(r) and r.state.guidance.s_m > 1.0, 40.0)
    assert set(run.of(OverrideLease)[-1].pwm_us) != {NEUTRAL_US}
    run.feed([OperatorCommand(t_ns=run.world.t_ns, command="stop")])
    run.run(lambda r: False, 1.5)
    assert set(run.of(OverrideLease)[-1].pwm_us) == {NEUTRAL_US}
    assert np.abs(run.world.plant.motion.x[6:]).max() < 0.01
    again = voyage(5, vessel=name)
    assert again.run(lambda r: driving(r) and r.state.guidance.s_m > 1.0, 40.0)
    again.world.rover.receive = lambda data, peer, t_ns: b""  # nothing of ours arrives any more
    again.run(lambda r: False, 2.5)
    outputs = again.world.rover.outputs_us[: len(again.world.vessel.controls)]
    assert set(outputs) == {NEUTRAL_US}, "the autopilot's own time-out and gate"
    again.world.rover.remove_link(PEER)
    again.run(lambda r: False, 4.0)
    assert set(again.of(OverrideLease)[-1].pwm_us) == {NEUTRAL_US}


def test_hold_is_refused_in_words_by_a_boat_that_cannot():
    run = voyage(2, vessel="rudder")
    assert run.run(lambda r: driving(r) and r.state.guidance.s_m > 1.0, 40.0)
    run.feed([OperatorCommand(t_ns=run.world.t_ns, command="hold")])
    run.run(lambda r: False, 1.0)
    assert run.state.helm.mode == "hold" and set(run.of(OverrideLease)[-1].pwm_us) == {NEUTRAL_US}
    assert DRIFTS in [a.text for a in run.of(Alert)]
    run.feed([OperatorCommand(t_ns=run.world.t_ns, command="start")])
    run.run(lambda r: False, 2.0)
    assert run.of(OverrideLease)[-1].source == "plan", "and it goes on where it was left"


def told_at_the_start(start):
    """Warnings of a rudder boat that begins a mission there, with plans that fail."""
    told = setup(CORNER, "rudder").pilot
    run = SteppedRun(World(WorldSetup(told.vessel, told.site, start=start), 4), pilot(CORNER, "rudder"), no_plan)
    assert run.run(driving, 40.0)
    run.run(lambda r: False, 0.5)
    return [a.text for a in run.of(Alert) if a.level == "warning" and "on the way from here" in a.text]


def test_a_start_from_where_it_cannot_turn_into_the_mission_is_warned_of():
    assert told_at_the_start(START) == []
    (text,) = told_at_the_start((9.8, 9.4, 0.0))
    assert "waypoint 1 cannot be rounded: the turn of" in text and "start from farther away" in text


def test_a_mission_that_it_cannot_turn_for_is_not_loaded_under_way():
    run = voyage(2, vessel="rudder", begin=None)
    points = tuple(MissionPoint(north_m=n, east_m=e) for n, e in ((9.0, 9.0), (15.0, 9.0), (9.0, 9.2)))
    run.feed([NewMission(t_ns=run.world.t_ns, name="there and back", waypoints=points)])
    (told,) = (a.text for a in run.of(Alert))
    assert "there and back with 3 waypoints not loaded: waypoint 2" in told and run.state.mission is None


def test_by_hand_the_yaw_stick_is_the_rudder_and_surge_the_propeller():
    run = voyage(3, vessel="rudder", begin=None)
    run.feed([OperatorCommand(t_ns=run.world.t_ns, command="manual")])

    def stick(surge, yaw, seconds):
        for _ in range(round(seconds / 0.1)):
            at = run.world.t_ns
            run.feed([ManualInput(t_ns=at, surge=surge, sway=0.0, yaw=yaw, source="test")])
            run.run(lambda r: False, 0.1)
        return run.of(OverrideLease)[-1]

    stick(0.0, 0.0, 3.0)
    assert run.state.helm.mode == "manual", run.state.helm
    half, full = stick(0.2, 0.5, 1.5), stick(0.2, 1.0, 1.5)
    assert 0.35 < half.f_command_n[1] / full.f_command_n[1] < 0.6 and full.f_command_n[0] > 3.0
    assert run.world.plant.motion.x[5] > 0.1, "it turns to starboard"
    assert set(stick(0.0, 0.0, 1.0).pwm_us) == {NEUTRAL_US}


def test_by_hand_no_azimuth_thruster_pushes_before_its_servo_points_there():
    told = setup(CORNER, "azimuth").pilot
    world = World(WorldSetup(told.vessel, told.site, start=START), 3)
    run = SteppedRun(world, pilot(CORNER, "azimuth"), no_plan, None)
    run.feed([OperatorCommand(t_ns=run.world.t_ns, command="manual")])
    for sway in (0.0,) * 30 + (0.5,) * 10:
        run.feed([ManualInput(t_ns=run.world.t_ns, surge=0.0, sway=sway, yaw=0.0, source="test")])
        run.run(lambda r: False, 0.1)
    f = np.array([lease.f_command_n for lease in run.of(OverrideLease)])
    thrusts, angles = np.abs(f[:, :2]), np.abs(f[:, 2:])
    np.testing.assert_allclose(angles[-1], np.pi / 2, atol=0.02)
    assert thrusts[-1].min() > 10 and (thrusts <= thrusts[-1] * np.sin(angles) + 0.5).all(), "its share to starboard"


@pytest.mark.parametrize("name", BOATS)
@pytest.mark.long
def test_without_plans_the_fallback_keeps_to_the_path(name):
    failing = list[bool]()

    def solve(request, warm):
        plan, warm = nmpc(vessel=name).solve(request, warm)
        return (replace(plan, status="failed"), None) if failing else (plan, warm)

    told = setup(CORNER, name).pilot
    run = SteppedRun(World(WorldSetup(told.vessel, told.site, start=START), 4), pilot(CORNER, name), solve)
    assert run.run(lambda r: driving(r) and r.state.guidance.s_m > 2.0, 40.0)
    failing.append(True)
    run.run(lambda r: False, 4.5)
    assert run.of(OverrideLease)[-1].source == "pd" and run.state.guidance.s_m > 3.5
    last = run.state.estimate
    assert last is not None and abs(last.east_m - 9.0) < 0.6 and last.u_m_s > 0.25


@pytest.mark.long
@pytest.mark.parametrize("world", [{}, pytest.param(ROUGH, marks=pytest.mark.matrix)], ids=["calm", "disturbed"])
@pytest.mark.parametrize("name", BOATS)
def test_the_demo_mission_within_the_limits(name, world):
    run = voyage(2, None, vessel=name, **world)
    assert run.run(settled(3.0), 220.0), f"not done: {run.state.guidance.phase}, {run.state.helm}"
    assert len(run.state.passed) == 5 and figures(run, None)["cross_track_rms_m"] <= 0.35
