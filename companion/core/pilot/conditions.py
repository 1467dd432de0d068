"""The conditions of the mode table (`modes`), each tick anew: what stands against driving, each in words.

A value and a pure function. What people are told of the estimate's health is the lookout's; here it is judged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from companion.core.configuration.run_file import Control
from companion.core.geometry.fence import Fence
from companion.core.messages import StateEstimate, Tick
from companion.core.pilot import annunciator
from companion.core.pilot.annunciator import AnnunciatorState
from companion.core.pilot.modes import Event
from companion.core.pilot.monitors.battery import BatteryState

BACK_M = 0.3
"""A boat is back once it is so far inside the fence; assumed: a position of UWB jitters by 0.1 m."""
LATE_TICKS = 10
"""So many ticks in a row, each a period late or more, are a loop that cannot keep up; assumed."""
PLANLESS_NS = 5_000_000_000
"""So long without a usable plan the mission is broken off; assumed: the PD law below it is no pilot for corners."""


@dataclass(frozen=True)
class ConditionMonitor:
    """`outside`: of the fence, as last known; `late_ticks` in a row; `since_ns`: the controller drives since."""

    outside: bool = False
    late_ticks: int = 0
    since_ns: int | None = None


def unfit(estimate: StateEstimate, seen: AnnunciatorState, blind_s: float) -> str | None:
    """Why the estimate cannot be driven by, or None."""
    if estimate.health not in ("healthy", "degraded"):
        return f"state estimate {estimate.health}: {estimate.reason}"
    return annunciator.degraded_too_long(seen, estimate.t_ns, blind_s)


def at_tick(
    watch: ConditionMonitor,
    tick: Tick,
    estimate: StateEstimate,
    seen: AnnunciatorState,
    fence: Fence,
    pack: BatteryState,
    control: Control,
    plan_ns: int,
) -> tuple[ConditionMonitor, dict[Event, str]]:
    """Conditions at a tick. `plan_ns`: of when the latest usable plan speaks."""
    t_ns, found = estimate.t_ns, dict[Event, str]()
    if why := unfit(estimate, seen, control.blind_s):
        found["unfit"] = why
    if estimate.health != "healthy":
        found["degraded"] = f"state estimate {estimate.health}: {estimate.reason}"
    watch, room_m = _at_fence(watch, estimate, fence)
    if watch.outside:
        found["fence_breached"] = "outside the fence" + ("" if room_m is None else f" by {max(-room_m, 0.0):.1f} m")
    if pack.low:
        found["battery_low"] = f"battery low ({pack})"
    if pack.critical:
        found["battery_critical"] = f"battery critical ({pack})"
    if watch.since_ns is not None and (planless_ns := t_ns - max(watch.since_ns, plan_ns)) > PLANLESS_NS:
        found["solver_failing"] = f"no usable plan for {planless_ns * 1e-9:.1f} s"
    late = tick.lateness_ns >= control.period_s * 1e9
    watch = replace(watch, late_ticks=watch.late_ticks + 1 if late else 0)
    if watch.late_ticks >= LATE_TICKS:
        found["loop_lag"] = f"the control loop is late: {tick.lateness_ns * 1e-6:.0f} ms, {watch.late_ticks} in a row"
    return watch, found


def _at_fence(watch: ConditionMonitor, estimate: StateEstimate, fence: Fence) -> tuple[ConditionMonitor, float | None]:
    """Outside or not, and the room [m]; without an estimate as last known."""
    if estimate.health not in ("healthy", "degraded"):
        return watch, None
    room_m = fence.clearance(estimate.north_m, estimate.east_m)
    return replace(watch, outside=room_m < (BACK_M if watch.outside else 0.0)), room_m
