"""Readings that had queued up while the program stood still."""

from types import SimpleNamespace

import pytest

from companion.core.pilot.monitors.stall import DRAIN_NS, STALL_NS, StallMonitor

MS = 1_000_000
MONITOR = StallMonitor()


def tick(state, t_ns):
    return MONITOR.on_tick(state, SimpleNamespace(t_ns=t_ns))


def reading(state, t_ns):
    return MONITOR.on_message(state, object(), t_ns)


def ticking(until_ns):
    state = MONITOR.initial
    for t_ns in range(0, until_ns + 1, 100 * MS):
        state, report = tick(state, t_ns)
        assert not report.alerts
    return state


def test_before_the_first_tick_and_between_ticks_all_readings_pass():
    state, report = reading(MONITOR.initial, 7_000 * MS)
    assert not report.withhold
    state = ticking(1_000 * MS)
    state, report = reading(state, 1_000 * MS + STALL_NS - 1)
    assert not report.withhold and not report.alerts


@pytest.mark.parametrize("first", ["reading", "tick"])
def test_whichever_comes_first_after_a_stall_what_had_queued_up_is_left_out(first):
    back_ns = 7_000 * MS
    state = ticking(1_000 * MS)
    if first == "tick":
        state, report = tick(state, back_ns)
    else:
        state, report = reading(state, back_ns)
        assert report.withhold
    assert [alert.text for alert in report.alerts] == [
        "this program stood still for 6.0 s: readings that had queued up are left out"
    ]
    for t_ns in range(back_ns, back_ns + DRAIN_NS, 50 * MS):
        state, report = reading(state, t_ns)
        assert report.withhold and not report.alerts
        if t_ns % (100 * MS) == 0:
            state, report = tick(state, t_ns)
            assert not report.alerts
    state, report = reading(state, back_ns + DRAIN_NS)
    assert not report.withhold


def test_two_stalls_are_two_alerts():
    state = ticking(1_000 * MS)
    state, first = tick(state, 3_000 * MS)
    for t_ns in range(3_100 * MS, 4_000 * MS, 100 * MS):
        state, report = tick(state, t_ns)
        assert not report.alerts
    _, second = tick(state, 9_000 * MS)
    assert len(first.alerts) == len(second.alerts) == 1
