"""The autopilot by its heartbeats: what is asked for and when, what somebody else took, and when it counts as lost."""

import pytest
from msgspec.structs import replace

from companion.core.messages import Heartbeat
from companion.core.pilot.autopilot_state import (
    HEARTBEAT_LOST_NS,
    MANUAL,
    RETRY_NS,
    UNKNOWN,
    AutopilotMonitor,
    AutopilotState,
    is_alive,
    prepare,
)
from tests.companion.core.pilot.monitors.monitor_fixture import view

S = 1_000_000_000
NOW = 100 * S
HOLD = 4


def heartbeat(armed=True, mode=MANUAL, t_ns=NOW):
    return Heartbeat(t_ns=t_ns, system=1, component=1, vehicle_type=11, autopilot=3, base_mode=0, custom_mode=mode,
                     system_status=4, armed=armed)  # fmt: skip


READY, HELD, DISARMED = heartbeat(), heartbeat(mode=HOLD), heartbeat(armed=False)
NEITHER = heartbeat(armed=False, mode=HOLD)


@pytest.mark.parametrize(
    ("before", "now", "events"),
    [
        (None, READY, []),
        (None, NEITHER, []),
        (READY, READY, []),
        (READY, DISARMED, ["disarmed"]),
        (READY, HELD, ["mode_changed"]),
        (READY, NEITHER, ["disarmed", "mode_changed"]),
        (DISARMED, READY, []),
        (DISARMED, DISARMED, []),
        (DISARMED, NEITHER, ["mode_changed"]),
        (HELD, READY, []),
        (HELD, heartbeat(mode=15), []),
        (HELD, NEITHER, ["disarmed"]),
        (NEITHER, READY, []),
    ],
)
def test_only_what_was_there_can_be_taken_away(before, now, events):
    state, report = AutopilotMonitor().on_message(AutopilotState(before, asked_ns=7), now, NOW)
    assert state == AutopilotState(now, asked_ns=7)
    assert list(report.events) == events and all(report.events.values())


def test_the_words_name_the_mode():
    _, report = AutopilotMonitor().on_message(AutopilotState(READY), HELD, NOW)
    assert report.events == {"mode_changed": "the autopilot's mode was changed to 4"}


def test_manual_is_asked_for_before_arming_and_both_again_each_second():
    vehicle, asked, waits = UNKNOWN, [], []
    for k in range(60):
        t_ns = NOW + k * S // 10
        beat = heartbeat(mode=HOLD if k < 25 else MANUAL, armed=k >= 50, t_ns=t_ns)
        vehicle, requests, why = prepare(replace(vehicle, heartbeat=beat), t_ns)
        asked += [(k, m.action, m.custom_mode) for m in requests]
        waits.append(why.rpartition(" ")[2])
    assert asked == [(0, "set_mode", 0), (10, "set_mode", 0), (20, "set_mode", 0), (30, "arm", None), (40, "arm", None)]
    assert waits == ["MANUAL"] * 25 + ["armed"] * 25 + [""] * 10
    assert vehicle.asked_ns is None and RETRY_NS == S


def test_without_a_heartbeat_nothing_is_asked_for():
    assert prepare(UNKNOWN, NOW) == (UNKNOWN, [], "waiting for the autopilot")


def test_at_the_very_beginning_of_time_it_asks_too():
    assert [m.action for m in prepare(AutopilotState(HELD), 0)[1]] == ["set_mode"]


def silence(state, t_ns):
    alive = is_alive(state.heartbeat_ns, t_ns)
    same, report = AutopilotMonitor().on_tick(state, view(t_ns, autopilot_alive=alive))
    assert same == state and set(report.events) == (set() if alive else {"link_lost"})
    return report.events.get("link_lost")


def test_lost_is_three_seconds_of_silence():
    assert "yet" in (silence(UNKNOWN, NOW) or "")
    assert silence(AutopilotState(READY), NOW + HEARTBEAT_LOST_NS) is None
    assert "for 3.1 s" in (silence(AutopilotState(READY), NOW + HEARTBEAT_LOST_NS + S // 10) or "")
