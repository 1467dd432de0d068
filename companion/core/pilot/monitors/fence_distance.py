"""The fence: outside or not, with a hysteresis against the jitter of the estimate."""

from __future__ import annotations

import msgspec

from companion.core.geometry.fence import Fence
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView

BACK_M = 0.3
"""A boat is back once it is so far inside the fence; assumed: a position of UWB jitters by 0.1 m."""


class FenceState(msgspec.Struct, frozen=True):
    """`outside`: of the fence, as last known."""

    outside: bool = False


class FenceMonitor(Monitor[FenceState]):
    """Condition `fence_breached`; without an estimate as last known."""

    initial = FenceState()

    def __init__(self, fence: Fence):
        self._fence = fence

    def on_tick(self, state: FenceState, view: TickView) -> tuple[FenceState, MonitorReport]:
        """Clearance [m] of the estimate from the fence, negative outside."""
        distance = ""
        if view.estimate.health in ("healthy", "degraded"):
            clearance_m = self._fence.clearance(view.estimate.north_m, view.estimate.east_m)
            state = FenceState(outside=not clearance_m >= (BACK_M if state.outside else 0.0))
            distance = f" by {max(-clearance_m, 0.0):.1f} m"
        return state, MonitorReport({"fence_breached": f"outside the fence{distance}"}) if state.outside else NOTHING
