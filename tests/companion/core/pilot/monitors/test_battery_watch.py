"""A battery that is not told, or as no pack is: said once, and once more when it is over."""

import pytest

from companion.core.configuration.run_file import BatteryLimits
from companion.core.messages import Alert, Battery, Tick
from companion.core.pilot.monitors.battery import BLIND_NS, BatteryWatch
from tests.companion.core.pilot.monitors.monitor_fixture import view
from tests.companion.core.pilot.pilot_shell import heartbeat, on_the_leg

S = 1_000_000_000
LIMITS = BatteryLimits(low_V=14.0, critical_V=13.2)


def told(reading, seconds, limits=LIMITS, watch=None, state=None, t0_ns=1000 * S, **tick):
    """Alerts of a watch that hears `reading(t_ns)` twice a second and ticks ten times; its state."""
    watch = watch or BatteryWatch(15.0, limits)
    state, alerts = state or watch.initial, []
    for k in range(round(seconds * 10)):
        t_ns = t0_ns + k * S // 10
        if k % 5 == 0 and (message := reading(t_ns)):
            state, report = watch.on_message(state, message, t_ns)
            alerts += report.alerts
        state, report = watch.on_tick(state, view(t_ns, **tick))
        assert not report.events
        alerts += report.alerts
    return alerts, state


def volts(v, percent=None):
    return lambda t_ns: Battery(t_ns=t_ns, voltage_v=v, remaining_percent=percent)


def silence(t_ns):
    return None


@pytest.mark.parametrize("reading", [silence, volts(0.0), volts(7.4), volts(22.6), volts(65.5)])
@pytest.mark.parametrize(("limits", "level"), [(LIMITS, "error"), (BatteryLimits(), "warning")])
def test_a_voltage_that_no_pack_has_is_said_once(reading, limits, level):
    (alert,), _ = told(reading, 60, limits)
    assert alert.level == level and "BATT_MONITOR" in alert.text and "7.5 to 22.5 V" in alert.text
    assert ("critical_V count for nothing" in alert.text) is (limits == LIMITS)
    seen = reading(0)
    assert (f"told {seen.voltage_v:.1f} V" if seen else "told nothing") in alert.text


def test_it_is_said_after_ten_seconds_and_not_of_a_single_reading():
    assert BLIND_NS == 10 * S
    assert told(silence, 10.0)[0] == []
    assert len(told(silence, 10.2)[0]) == 1
    assert told(lambda t_ns: volts(15.0 if t_ns // S % 8 == 0 else 0.0)(t_ns), 60)[0] == []


def test_a_sound_pack_is_not_spoken_of_and_one_that_is_back_is():
    assert told(volts(15.2), 60)[0] == []
    _, state = told(volts(0.0), 20)
    (back,), state = told(volts(15.2), 20, state=state, t0_ns=1020 * S)
    assert back.level == "info" and "15.2 V" in back.text
    (again,), _ = told(volts(0.0), 20, state=state, t0_ns=1040 * S)
    assert again.level == "error"


def test_of_an_autopilot_that_is_silent_nothing_is_expected():
    assert told(silence, 60, autopilot_alive=False)[0] == []


@pytest.mark.parametrize(
    ("limits", "reading", "count"),
    [
        (BatteryLimits(critical_percent=20), volts(15.2), 1),
        (BatteryLimits(critical_percent=20), volts(15.2, 127), 1),
        (BatteryLimits(critical_percent=20), volts(15.2, 80), 0),
        (LIMITS, volts(15.2), 0),
    ],
)
def test_limits_in_per_cent_need_somebody_who_counts(limits, reading, count):
    alerts, _ = told(reading, 60, limits)
    assert [alert.level for alert in alerts] == ["error"] * count
    assert all("BATT_CAPACITY" in alert.text and "critical_percent" in alert.text for alert in alerts)


@pytest.mark.long
def test_the_pilot_says_it_under_way():
    shell = on_the_leg()
    for k in range(150):
        shell.t_ns += 100_000_000
        shell.feed(heartbeat(shell.t_ns), Battery(t_ns=shell.t_ns, voltage_v=0.0))
        shell.feed(Tick(t_ns=shell.t_ns, index=2000 + k))
    texts = [o.text for o in shell.outputs if isinstance(o, Alert) and o.level == "error"]
    assert sum(text.startswith("battery: the autopilot has told 0.0 V") for text in texts) == 1
