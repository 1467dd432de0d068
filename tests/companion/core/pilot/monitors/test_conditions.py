"""Conditions as they come and go: battery, fence, loop, solver, estimate; each with its limit from both sides."""

import math

import pytest
from msgspec.structs import replace

from companion.core.configuration.run_file import BatteryLimits, Control, load_run
from companion.core.configuration.tables import ConfigError
from companion.core.geometry.fence import Fence
from companion.core.messages import Battery, StateEstimate
from companion.core.pilot.annunciator import Annunciator, AnnunciatorState
from companion.core.pilot.monitors.battery import LIMIT_NS, BatteryMonitor, BatteryState
from companion.core.pilot.monitors.fence_distance import FenceMonitor, FenceState
from companion.core.pilot.monitors.loop_lag import LATE_TICKS, LoopLag, LoopLagMonitor
from companion.core.pilot.monitors.plan_gap import PLANLESS_NS, ControllerTime, PlanGapMonitor
from tests.companion.core.pilot.monitors.monitor_fixture import view

S, MS = 1_000_000_000, 1_000_000
LIMITS = BatteryLimits(low_V=14.0, critical_V=13.2, low_percent=30, critical_percent=15)
SQUARE = Fence((((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)),))
FULL = BatteryState(15.6)
ESTIMATE = StateEstimate(
    t_ns=100 * S, north_m=5.0, east_m=5.0, psi_rad=0.0, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0, covariance=(0.0,) * 36,
    accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={}, disturbance_n=(0.0, 0.0, 0.0),
    health="healthy", reason="",
)  # fmt: skip


MONITORS = {
    AnnunciatorState: Annunciator((), Control().blind_s),
    FenceState: FenceMonitor(SQUARE),
    BatteryState: BatteryMonitor(15.0, LIMITS),
    ControllerTime: PlanGapMonitor(),
    LoopLag: LoopLagMonitor(Control().period_s),
}


def at(*states, estimate=ESTIMATE, lateness_ms=0, plan_ns=0):
    """A tick for all of them; those not among `states` are as at switch-on, with a full pack."""
    given = {type(state): state for state in (FULL, *states)}
    seen, conditions = view(estimate.t_ns, lateness_ns=lateness_ms * MS, estimate=estimate, plan_ns=plan_ns), {}
    after = {}
    for kind, monitor in MONITORS.items():
        after[kind], report = monitor.on_tick(given.get(kind, monitor.initial), seen)
        conditions |= report.events
        assert not report.alerts
    return after, conditions


def drained(volts, seconds, percent=None, start=FULL, limits=LIMITS, t0_ns=1000 * S):
    """A pack that shows `volts` twice a second."""
    pack = start
    for k in range(round(2 * seconds) + 1):
        reading = Battery(t_ns=t0_ns + k * S // 2, voltage_v=volts, remaining_percent=percent)
        pack, report = BatteryMonitor(15.0, limits).on_message(pack, reading, reading.t_ns)
        assert not report.events and not report.alerts
    return pack


def test_a_quiet_boat_has_no_conditions():
    after, conditions = at()
    assert conditions == {} and after == {kind: monitor.initial for kind, monitor in MONITORS.items()} | {
        BatteryState: FULL
    }


@pytest.mark.parametrize(
    ("volts", "low", "critical"), [(14.1, False, False), (13.9, True, False), (13.3, True, False), (13.0, True, True)]
)
def test_a_sagging_pack_becomes_low_and_critical(volts, low, critical):
    pack = drained(volts, 40)
    assert (pack.low, pack.critical) == (low, critical)
    _, found = at(pack)
    assert set(found) == ({"battery_low"} if low else set()) | ({"battery_critical"} if critical else set())


def test_a_limit_counts_after_five_seconds_and_a_spike_does_not():
    start = BatteryState(13.0)
    assert LIMIT_NS == 5 * S
    assert not drained(13.0, LIMIT_NS / S - 0.5, start=start).critical
    assert drained(13.0, LIMIT_NS / S, start=start).critical
    spike = drained(16.0, 20, start=drained(13.0, 4, start=start), t0_ns=1004 * S)
    assert not spike.critical and spike.critical_ns is None


def test_a_low_pack_that_rests_stays_low_and_a_new_one_does_not():
    low = drained(13.9, 40)
    assert drained(14.6, 60, start=low).low and not drained(15.0, 60, start=low).low


@pytest.mark.parametrize(("percent", "low", "critical"), [(30, False, False), (29, True, False), (14, True, True)])
def test_per_cent_count_too(percent, low, critical):
    pack = drained(15.6, 6, percent)
    assert (pack.low, pack.critical) == (low, critical) and f", {percent} %" in str(pack)
    assert not drained(15.6, 6, percent, limits=BatteryLimits()).low, "without limits nothing is low"


@pytest.mark.parametrize("volts", [0.0, 7.0, 65.5, math.nan])
def test_per_cent_count_too_where_the_voltage_is_no_packs(volts):
    """Nobody had said that they do not: with such a voltage only "thrust is reckoned without it" is told."""
    pack = drained(volts, 6, 14)
    assert pack.low and pack.critical and pack.voltage_v == FULL.voltage_v
    assert not drained(volts, 6, 30).low and drained(volts, 6, 101) == FULL


def test_no_monitor_is_no_empty_pack():
    assert drained(0.0, 60) == FULL


def test_limits_the_wrong_way_round_are_refused_with_their_key():
    text = 'vessel="v"\nsite="s"\nmission="m"\n[mavlink]\nurl="u"\n[uwb]\nurl="u"\n[battery]\n'
    for lines, said in (
        ("low_V = 13.0\ncritical_V = 13.0", r"battery: critical_V: expected less than low_V = 13"),
        ("low_percent = 10\ncritical_percent = 20", r"battery: critical_percent: expected less than"),
        ("low_percent = 100", r"battery.low_percent"),
    ):
        with pytest.raises(ConfigError, match=said):
            load_run(text + lines, name="run.toml")


def test_beyond_the_fence_and_back_with_room_to_spare():
    fence = FenceState()
    for east, outside in ((9.9, False), (10.1, True), (9.9, True), (9.71, True), (9.69, False), (10.1, True)):
        after, found = at(fence, estimate=replace(ESTIMATE, east_m=east))
        fence = after[FenceState]
        assert (fence.outside, "fence_breached" in found) == (outside, outside), east
    assert found["fence_breached"] == "outside the fence by 0.1 m"


def test_without_an_estimate_the_boat_is_where_it_was():
    lost = replace(ESTIMATE, east_m=50.0, health="lost", reason="why")
    assert not at(FenceState(outside=False), estimate=lost)[0][FenceState].outside
    after, found = at(FenceState(outside=True), estimate=lost)
    assert after[FenceState].outside and found["fence_breached"] == "outside the fence"
    assert found["unfit"] == found["degraded"] == "state estimate lost: why"


@pytest.mark.parametrize("outside", [False, True])
def test_a_place_that_is_no_number_is_not_inside(outside):
    nowhere = replace(ESTIMATE, north_m=math.nan, east_m=math.nan)
    assert at(FenceState(outside=outside), estimate=nowhere)[0][FenceState].outside


def test_degraded_is_no_obstacle_until_it_has_lasted():
    sick = replace(ESTIMATE, health="degraded", reason="no UWB")
    assert set(at(estimate=sick)[1]) == {"degraded"}
    since = AnnunciatorState(health="degraded", degraded_ns=sick.t_ns - 16 * S)
    assert set(at(since, estimate=sick)[1]) == {"degraded", "unfit"}
    assert set(at(estimate=replace(sick, health="initialising"))[1]) == {"degraded", "unfit"}


def test_a_loop_is_late_after_ten_late_ticks_in_a_row():
    lag = LoopLag()
    assert LATE_TICKS == 10
    for _ in range(LATE_TICKS - 1):
        after, found = at(lag, lateness_ms=100)
        lag = after[LoopLag]
        assert not found
    assert set(at(lag, lateness_ms=100)[1]) == {"loop_lag"}
    after, found = at(lag, lateness_ms=99)
    assert not found and after[LoopLag].late_ticks == 0


def test_a_solver_fails_after_five_seconds_without_a_plan():
    now = ESTIMATE.t_ns
    assert PLANLESS_NS == 5 * S
    driving = ControllerTime(since_ns=now - PLANLESS_NS - 1)
    assert set(at(driving)[1]) == {"solver_failing"}
    assert not at(driving, plan_ns=now - PLANLESS_NS)[1], "the last plan is no older"
    assert not at(replace(driving, since_ns=now - PLANLESS_NS))[1], "it has not driven for longer"
    assert not at(replace(driving, since_ns=None))[1], "nobody asked it"
