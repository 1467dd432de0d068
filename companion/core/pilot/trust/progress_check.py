"""Does the boat come nearer to its waypoint? A fence between, a current, a rope or weed hold it without any fault."""

from __future__ import annotations

from typing import Literal

import msgspec
from msgspec.structs import replace

from companion.core.messages import Alert
from companion.core.pilot.monitors.monitor import NOTHING, LegAhead, Monitor, MonitorReport, TickView

PATIENCE_NS = 40_000_000_000
"""Longer than a turn on the spot, or than the circle of a boat with a rudder, takes; assumed."""
WAY_M = 0.5
"""So much nearer, or farther along the course, is way; assumed: more than noise and waves move an estimate."""


class ProgressState(msgspec.Struct, frozen=True):
    """`leg`: the leg ahead when way was made last, and `since_ns` then; `is_alerted`: that none has been made since."""

    leg: LegAhead | None = None
    since_ns: int = 0
    is_alerted: bool = False


class ProgressMonitor(Monitor[ProgressState]):
    """A warning where a mission's boat makes no way; it goes on trying, for what holds it may end."""

    initial = ProgressState()

    def on_tick(self, state: ProgressState, view: TickView) -> tuple[ProgressState, MonitorReport]:
        """Compare with where way was made last."""
        now, last = view.leg, state.leg
        if now is None or last is None or _has_way(last, now):
            after = ProgressState(now, view.t_ns)
            if now is None or not state.is_alerted:
                return after, NOTHING
            return after, _report(view, "info", "the boat makes way again")
        if state.is_alerted or view.t_ns - state.since_ns < PATIENCE_NS:
            return state, NOTHING
        text = (
            f"no way made for {PATIENCE_NS * 1e-9:.0f} s: waypoint {now.waypoint} is {now.ahead_m:.1f} m away (does the"
            " fence lie between, is the boat held, is the current stronger?)"
        )
        return replace(state, is_alerted=True), _report(view, "warning", text)


def _report(view: TickView, level: Literal["info", "warning"], text: str) -> MonitorReport:
    return MonitorReport(alerts=(Alert(t_ns=view.t_ns, level=level, text=text),))


def _has_way(last: LegAhead, now: LegAhead) -> bool:
    """Whether the boat has come on since."""
    if now.waypoint != last.waypoint:
        return True
    return now.along_m - last.along_m >= WAY_M or last.ahead_m - now.ahead_m >= WAY_M
