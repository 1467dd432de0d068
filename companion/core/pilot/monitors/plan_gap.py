"""The solver: how long the controller has driven without a usable plan."""

from __future__ import annotations

import msgspec

from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView

PLANLESS_NS = 5_000_000_000
"""So long without a usable plan the mission is broken off; assumed: the PD law below it is no pilot for corners."""


class ControllerTime(msgspec.Struct, frozen=True):
    """`since_ns`: the controller drives since [ns]; None: it does not. Kept by `transitions`."""

    since_ns: int | None = None


class PlanGapMonitor(Monitor[ControllerTime]):
    """Condition `solver_failing`."""

    initial = ControllerTime()

    def on_tick(self, state: ControllerTime, view: TickView) -> tuple[ControllerTime, MonitorReport]:
        """Time since the latest usable plan, or since the controller began to drive."""
        if state.since_ns is None or (gap_ns := view.t_ns - max(state.since_ns, view.plan_ns)) <= PLANLESS_NS:
            return state, NOTHING
        return state, MonitorReport({"solver_failing": f"no usable plan for {gap_ns * 1e-9:.1f} s"})
