"""When ticks fall due, and how late a loop says that it is."""

import pytest

from companion.boat.tick_timing import TickTiming
from companion.core.pilot.monitors.loop_lag import LATE_TICKS, LoopLag, LoopLagMonitor
from tests.companion.core.pilot.monitors.monitor_fixture import view

MS = 1_000_000
PERIOD_MS = 100


@pytest.mark.parametrize(
    ("takes_ms", "late_ms", "told"),
    [(20, 0, False), (99, 0, False), (150, 50, False), (250, 150, True), (400, 300, True)],
)
def test_a_loop_that_is_too_slow_is_late_at_every_tick_but_the_first(takes_ms, late_ms, told):
    """It reads no lateness of its sleep: it does not sleep."""
    timing, monitor, state = TickTiming(PERIOD_MS * MS), LoopLagMonitor(PERIOD_MS * 1e-3), LoopLag()
    late_ns, events, due_ns, now_ns = [], {}, PERIOD_MS * MS, 0
    for index in range(LATE_TICKS + 1):
        now_ns = max(now_ns, due_ns)
        tick = timing.begin(index, due_ns, now_ns)
        state, report = monitor.on_tick(state, view(now_ns, lateness_ns=tick.lateness_ns))
        late_ns, events = [*late_ns, tick.lateness_ns], events | report.events
        now_ns += takes_ms * MS
        due_ns = timing.next_due_ns(due_ns, now_ns)
    assert late_ns == [0, *[late_ms * MS] * LATE_TICKS]
    assert ("loop_lag" in events) == told
