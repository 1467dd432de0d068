"""A program that stood still (stopped, swapped out, starved): what queued up meanwhile does not reach the estimator.

Readings wait in the system's buffers and then arrive at once. Ranges carry no stamp, so that each would count as one of
now; stamps of the autopilot that are old are not believed. The estimate goes on from its last reading without them.
"""

from __future__ import annotations

import msgspec

from companion.core.messages import MEASUREMENTS, Alert
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView

STALL_NS = 500_000_000
"""So long without a tick is a stall; five periods at 10 Hz, and the error of a range at 0.5 m/s is 0.25 m. Assumed."""
DRAIN_NS = 500_000_000
"""So long after it readings may come out of a buffer; assumed."""


class StallState(msgspec.Struct, frozen=True):
    """Instant of the latest tick, and until when readings are left out [ns]."""

    tick_ns: int | None = None
    drained_ns: int = 0


class StallMonitor(Monitor[StallState]):
    """Withholds readings that had queued up."""

    hears = MEASUREMENTS
    screens = True
    initial = StallState()

    def on_message(self, state: StallState, message: object, t_ns: int) -> tuple[StallState, MonitorReport]:
        """A reading: from a buffer if it comes after a stall, before the next tick or soon after."""
        state, alerts = _look(state, t_ns)
        return state, MonitorReport(alerts=alerts, withhold=t_ns < state.drained_ns)

    def on_tick(self, state: StallState, view: TickView) -> tuple[StallState, MonitorReport]:
        """A tick is a sign of life."""
        state, alerts = _look(state, view.t_ns)
        report = MonitorReport(alerts=alerts) if alerts else NOTHING
        return StallState(view.t_ns, state.drained_ns), report


def _look(state: StallState, t_ns: int) -> tuple[StallState, tuple[Alert, ...]]:
    """The state at `t_ns`, and an alert where it is the first to see a stall."""
    if state.tick_ns is None or t_ns - state.tick_ns < STALL_NS:
        return state, ()
    known = state.tick_ns + STALL_NS < state.drained_ns
    drained = StallState(state.tick_ns, state.drained_ns if known else t_ns + DRAIN_NS)
    if known:
        return drained, ()
    text = (
        f"this program stood still for {(t_ns - state.tick_ns) * 1e-9:.1f} s: readings that had queued up are left out"
    )
    return drained, (Alert(t_ns=t_ns, level="warning", text=text),)
