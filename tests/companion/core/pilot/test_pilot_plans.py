"""The pilot with plans: the fallback ladder, when not to drive, battery and links."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.core import messages as m
from companion.core.geometry.frames import rotate
from companion.core.pilot.monitors.battery import BatteryState
from companion.core.pilot.pilot import Pilot
from tests.companion.core.pilot.pilot_shell import (
    INF,
    NAN,
    N,
    at_the_start,
    attitude,
    heartbeat,
    on_the_leg,
    operator,
    plan,
)
from tests.support.drive_fixture import setup

# --- plans and the ladder --------------------------------------------------------------------------


def after_a_plan():
    """On the leg; a tick had its plan, and the next one has begun."""
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    shell.feed(plan(shell.index))
    shell.tick()
    return shell


def test_a_plan_in_time_is_sent_as_it_is():
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    (request,) = [o for o in shell.tick() if isinstance(o, m.SolveRequest)]
    assert request.index == shell.index and not shell.leases
    shell.wait(10)
    shell.feed(plan(shell.index))
    assert (shell.lease.source, shell.lease.reason, shell.lease.f_command_n) == ("plan", "", (1.0,) * N)
    assert shell.feed(plan(shell.index)) == [], "a duplicate is not sent again"


def test_as_plans_stay_away_the_ladder_goes_down_to_neutral():
    """Heartbeats stop as well: after 3 s the boat is stopped."""
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    shell.feed(plan(shell.index))
    sources = []
    for _ in range(40):
        shell.tick()
        if shell.state.open_tick is not None:
            shell.wait(50)
            shell.deadline()
            shell.wait(-50)
        sources.append(shell.lease.source)
    order = [s for i, s in enumerate(sources) if i == 0 or s != sources[i - 1]]
    assert order == ["shifted_plan", "pd", "neutral"]
    assert 8 <= sources.count("shifted_plan") <= 10 and sources.count("pd") >= 15
    assert any(isinstance(o, m.Alert) and o.level == "error" for o in shell.outputs)


def test_a_late_plan_serves_from_its_own_age_on():
    """The plan of a tick that is over was made for that tick's instant, not for the one it arrives in."""
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    first = shell.index
    shell.wait(50)
    shell.deadline()
    assert shell.lease.source in ("pd", "shifted_plan")
    shell.wait(-50)
    for _ in range(3):
        shell.tick()
        shell.wait(50)
        shell.deadline()
        shell.wait(-50)
    shell.feed(plan(first))
    shell.tick()
    shell.wait(50)
    shell.deadline()
    assert shell.lease.source == "shifted_plan" and shell.lease.f_command_n == (3.0,) * N, "0.45 s: its third row"


def test_a_plan_that_is_only_late_is_told_as_late():
    """It answers the open tick, after its deadline and before the shell has told of that."""
    shell = after_a_plan()
    shell.wait(70)
    outputs = shell.feed(plan(shell.index))
    assert (shell.lease.source, shell.lease.reason) == ("shifted_plan", "plan late; plan is 0.07 s old")
    told = [o.text for o in outputs if isinstance(o, m.Alert)]
    assert told == ["driving by shifted plan: plan late; plan is 0.07 s old"]


@pytest.mark.parametrize("ahead", [-30, -1, 1, 7])
def test_a_plan_with_a_wrong_index_does_not_close_the_tick(ahead):
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    assert shell.feed(plan(shell.index + ahead)) == []
    shell.wait(50)
    shell.deadline()
    assert shell.lease.f_command_n != (1.0,) * N


@pytest.mark.parametrize("ahead", [-1, 1])
def test_a_deadline_of_another_tick_does_not_close_this_one(ahead):
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    assert shell.feed(m.PlanDeadline(t_ns=shell.t_ns, index=shell.index + ahead)) == []
    shell.feed(plan(shell.index))
    assert shell.lease.source == "plan"


BAD_ROWS = [
    (),
    ((NAN,) * N,) * 20,
    ((1.0,) * N,) * 19 + ((NAN, 0.0, 0.0, 0.0),),
    ((0.0, 0.0, INF, 0.0),) * 20,
    ((1.0,) * (N - 1),) * 20,
]


@pytest.mark.parametrize("f_n", BAD_ROWS, ids=["empty", "nan", "nan late", "inf", "short"])
def test_an_unsound_plan_leaves_the_lease_to_the_one_before(f_n):
    shell = after_a_plan()
    shell.wait(10)
    shell.feed(plan(shell.index, f_n=f_n))
    assert shell.lease.source == "shifted_plan" and "not sound" in shell.lease.reason
    assert shell.lease.f_command_n == (1.0,) * N


def test_a_failed_plan_leaves_the_lease_to_the_one_before():
    shell = after_a_plan()
    shell.feed(plan(shell.index, status="failed", f_n=()))
    assert shell.lease.source == "shifted_plan" and "because" in shell.lease.reason


# --- when not to drive -----------------------------------------------------------------------------


def going(shell):
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    shell.feed(plan(shell.index))
    assert shell.lease.source == "plan"


@pytest.mark.parametrize(
    "end", [{"armed": False}, {"mode": 4}, {"mode": 15}, "stop"], ids=["disarmed", "hold", "guided", "operator"]
)
def test_taken_away_means_neutral_until_the_operator_starts(end):
    shell = on_the_leg()
    going(shell)
    shell.tick()
    shell.wait(5)
    shell.feed(operator("stop") if end == "stop" else heartbeat(shell.t_ns, **end))
    shell.wait(5)
    shell.feed(plan(shell.index))
    assert shell.lease.source == "neutral", "not even the plan that was under way is sent"
    for _ in range(30):
        shell.feed(heartbeat(shell.t_ns), attitude(shell))
        shell.tick()
        assert shell.lease.source == "neutral" and shell.lease.index == shell.index
    assert not [o for o in shell.outputs if isinstance(o, m.VehicleRequest)], "nothing is asked of the autopilot"
    shell.feed(operator("start"))
    shell.tick()
    shell.feed(plan(shell.index))
    assert shell.lease.source == "plan"


def test_hold_keeps_station_where_the_boat_is():
    """Where braking from U ends, U^2 / 2a ahead of it."""
    shell = on_the_leg()
    going(shell)
    shell.feed(operator("hold"))
    (reference,) = [o for o in shell.tick() if isinstance(o, m.GuidanceReference)]
    estimate = shell.state.estimate
    away = math.hypot(reference.north_ref_m - estimate.north_m, reference.east_ref_m - estimate.east_m)
    braking_m = (estimate.u_m_s**2 + estimate.v_m_s**2) / (2 * setup().pilot.guidance.limits.deceleration_m_s2)
    assert reference.phase == "station" and away == pytest.approx(braking_m)


def test_a_boat_that_brakes_towards_a_fence_holds_where_it_is():
    """Gentle braking would end nearer to the fence than the controller's margin."""
    shell, here = on_the_leg(), setup().pilot
    going(shell)
    at, margin_m = shell.state.estimate, here.nmpc.fence_margin_m
    U, course = math.hypot(at.u_m_s, at.v_m_s), at.psi_rad + math.atan2(at.v_m_s, at.u_m_s)
    braking_m = U**2 / (2 * here.guidance.limits.deceleration_m_s2)
    sides = ((margin_m + braking_m / 2, 5.0), (margin_m + braking_m / 2, -5.0), (-40.0, -5.0), (-40.0, 5.0))
    fence = [np.add((at.north_m, at.east_m), rotate(course, *side)) for side in sides]
    site = msgspec.structs.replace(here.site, fence=tuple((float(n), float(e)) for n, e in fence))
    near = Pilot(replace(here, site=site))
    state, _ = near.step(shell.state, [operator("hold")], shell.t_ns)
    t_ns = shell.t_ns + 100_000_000
    _, outputs = near.step(state, [m.Tick(t_ns=t_ns, index=shell.index + 1)], t_ns)
    (reference,) = [o for o in outputs if isinstance(o, m.GuidanceReference)]
    assert reference.phase == "station" and braking_m > 0.1
    assert math.dist((reference.north_ref_m, reference.east_ref_m), (at.north_m, at.east_m)) < 0.1


def test_without_an_estimate_nothing_is_asked_for():
    shell = at_the_start()
    shell.feed(operator("start"), heartbeat(0, armed=False))
    for _ in range(20):
        shell.feed(heartbeat(shell.t_ns))
        outputs = shell.tick()
        assert not [o for o in outputs if isinstance(o, (m.VehicleRequest, m.SolveRequest))]
        assert "initialising" in shell.lease.reason


# --- battery, links --------------------------------------------------------------------------------


@pytest.mark.parametrize("voltage_v", [0.0, -1.0, 1.5, 7.4, 22.6, 65.535, NAN, INF])
def test_a_voltage_that_no_pack_has_changes_nothing(voltage_v):
    shell = on_the_leg()
    before = shell.state.monitor(BatteryState).voltage_v
    for _ in range(50):
        shell.feed(m.Battery(t_ns=shell.t_ns, voltage_v=voltage_v))
    assert shell.state.monitor(BatteryState).voltage_v == before


def test_a_sagging_pack_is_followed_and_gets_longer_pulses():
    shell, low = on_the_leg(), on_the_leg()
    for _ in range(50):
        low.feed(m.Battery(t_ns=low.t_ns, voltage_v=13.0))
    assert low.state.monitor(BatteryState).voltage_v == pytest.approx(13.0, abs=0.01)
    for each in (shell, low):
        going(each)
    assert low.lease.pwm_us[0] > shell.lease.pwm_us[0]


@pytest.mark.parametrize(
    ("state", "level"), [("searching", "info"), ("online", "info"), ("stale", "warning"), ("lost", "warning")]
)
def test_links_are_told_as_they_deserve(state, level):
    shell = on_the_leg()
    (alert,) = shell.feed(m.LinkStatus(t_ns=0, link="uwb", state=state, reason="words"))
    assert (alert.level, alert.text) == (level, f"uwb: {state}: words")


def test_a_port_that_another_program_holds_is_a_warning_and_a_device_that_is_not_there_yet_is_none():
    shell = on_the_leg()
    held = f"udpin:127.0.0.1:14551 {m.HELD_PORT} (another aritra run?): end it, or give --mavlink"
    absent = "cannot open serial:/dev/ttyACM0:115200: No such file or directory"
    alerts = [
        shell.feed(m.LinkStatus(t_ns=0, link="mavlink", state="searching", reason=reason))[0]
        for reason in (held, absent)
    ]
    assert [(a.level, a.text) for a in alerts] == [
        ("warning", f"mavlink: searching: {held}"), ("info", f"mavlink: searching: {absent}")
    ]  # fmt: skip
