"""The control loop: ticks that come a period late or more, several in a row."""

from __future__ import annotations

import msgspec

from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView

LATE_TICKS = 10
"""So many ticks in a row, each a period late or more, are a loop that cannot keep up; assumed."""


class LoopLag(msgspec.Struct, frozen=True):
    """`late_ticks`: in a row, until now."""

    late_ticks: int = 0


class LoopLagMonitor(Monitor[LoopLag]):
    """Condition `loop_lag`."""

    initial = LoopLag()

    def __init__(self, period_s: float):
        self._period_ns = period_s * 1e9

    def on_tick(self, state: LoopLag, view: TickView) -> tuple[LoopLag, MonitorReport]:
        """Count late ticks."""
        state = LoopLag(state.late_ticks + 1 if view.lateness_ns >= self._period_ns else 0)
        if state.late_ticks < LATE_TICKS:
            return state, NOTHING
        reason = f"the control loop is late: {view.lateness_ns * 1e-6:.0f} ms, {state.late_ticks} in a row"
        return state, MonitorReport({"loop_lag": reason})
