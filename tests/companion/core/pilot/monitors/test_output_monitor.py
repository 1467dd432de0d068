"""Outputs that are cut (safety switch, no pulse) or stay still though the thrusters are to turn."""

import pytest
from msgspec.structs import replace

from companion.core.messages import MotorOutputs, ParamValue, StatusText
from companion.core.pilot.monitors.output_monitor import LOADS_NS, OutputMonitor
from tests.companion.core.pilot.monitors.monitor_fixture import view
from tests.companion.core.pilot.monitors.override_fixture import MS, NEUTRAL, lease, servo

MONITOR = OutputMonitor((9, 10), 2)
RUDDER = OutputMonitor((9, 10), 1)
"""A thruster and the servo of its rudder."""
TURNING = (1620, 1380, 1500)


def told(state, *messages, monitor=MONITOR):
    """The state after these messages, and the events of each."""
    events = []
    for message in messages:
        state, report = monitor.on_message(state, message, message.t_ns)
        events.append(dict(report.events))
    return state, events


def sending(until_ms, pwm=TURNING, since_ms=0, state=MONITOR.initial):
    return told(state, *(lease(t, pwm) for t in range(since_ms, until_ms + 1, 100)))[0]


def echoes(state, pulses, times):
    """Echoes as the autopilot sends them, each after the lease of its tick; the times [ms] of `outputs_still`."""
    still = []
    for t in times:
        state, (_, events) = told(state, lease(t - 10, TURNING), servo(t, *pulses))
        still += [t] if "outputs_still" in events else []
    return state, still


def condition(state, t_ms, **view_fields):
    return MONITOR.on_tick(state, view(t_ms * MS, **view_fields))[1].events


def function(number, value):
    return ParamValue(t_ns=0, name=f"SERVO{number}_FUNCTION", value=float(value), index=None, count=1)


# --- still ---------------------------------------------------------------------------------------------


def test_outputs_at_rest_while_the_thrusters_are_to_turn_are_seen_at_the_second_echo():
    state, still = echoes(sending(3000), (1620, 1380), range(3100, 4000, 100))
    assert still == []
    _, still = echoes(state, (1500, 1500), range(4000, 4400, 100))
    assert still == [4100, 4200, 4300]


@pytest.mark.parametrize("pulses", [(1500, 1500), (0, 1500), (1476, 1524)])
def test_no_pulse_and_the_band_of_rest_are_still(pulses):
    assert echoes(sending(3000), pulses, range(3100, 3300, 100))[1] == [3200]


@pytest.mark.parametrize("pulses", [(1500, 1526), (1474, 1500), (0, 1400)])
def test_one_that_turns_is_enough(pulses):
    assert echoes(sending(3000), pulses, range(3100, 4000, 100))[1] == []


def test_a_neutral_of_the_last_half_second_explains_outputs_at_rest():
    state = sending(3400, since_ms=3100, state=sending(3000, NEUTRAL))
    assert echoes(state, (1500, 1500), range(3410, 3600, 95))[1] == []
    gentle = sending(4000, (1520, 1480, 1500))
    assert told(gentle, *(servo(t, 1500, 1500) for t in range(3000, 4000, 100)))[1] == [{}] * 10


def test_a_single_echo_between_two_right_ones_is_nothing():
    state, still = echoes(sending(3000), (1500, 1500), [3100])
    state, more = echoes(state, (1620, 1380), [3200])
    _, again = echoes(state, (1500, 1500), [3300])
    assert still + more + again == []


def test_thrusters_elsewhere_are_looked_at_where_they_are():
    state, _ = told(sending(3000), function(3, 95), function(4, 94), function(1, 26), function(2, 0))
    state, still = echoes(state, (1500, 1500, 1380, 1620), range(3100, 4000, 100))
    assert still == []
    state, still = echoes(state, (1900, 1100, 1500, 1500), range(4000, 4200, 100))
    assert still == [4100]


def beside_a_servo(sent, shown):
    """A boat with a rudder over three seconds: events of all echoes, and the condition after them."""
    echoes = (servo(t + 5, *(shown if t else sent)) for t in range(0, 3000, 100))
    messages = (m for echo in echoes for m in (lease(echo.t_ns // MS - 5, (*sent, 1500)), echo))
    state, events = told(RUDDER.initial, *messages, monitor=RUDDER)
    return set().union(*events), set(condition(state, 3010))


def test_a_trimmed_servo_asks_no_thruster_to_turn():
    assert beside_a_servo((1500, 1540), (1500, 1500)) == (set(), set())


@pytest.mark.parametrize(
    ("shown", "found"),
    [
        ((1500, 1620), ({"outputs_still"}, set())),
        ((0, 1620), (set(), {"outputs_cut"})),
        ((1700, 1500), (set(), set())),
    ],
)
def test_a_rudder_that_is_over_does_not_hide_its_thruster(shown, found):
    assert beside_a_servo((1700, 1620), shown) == found


def test_a_script_that_stops_matters_where_it_writes_a_servo():
    state, _ = told(RUDDER.initial, function(1, 148), function(2, 95), monitor=RUDDER)
    assert "outputs_still" in told(state, STOPPED, monitor=RUDDER)[1][0]


STOPPED = StatusText(t_ns=5, severity=2, text="Scripting: stopped")


@pytest.mark.parametrize(
    ("functions", "heard"),
    [((), True), ((94, 95), True), ((148, 149), False), ((148, 95), True), ((148, 149, 94), False)],
)
def test_scripts_that_stop_matter_where_one_writes_a_thruster(functions, heard):
    state, _ = told(MONITOR.initial, *(function(n, f) for n, f in enumerate(functions, 1)))
    _, (events,) = told(state, STOPPED)
    assert ("outputs_still" in events) == heard


def test_other_texts_are_nothing():
    for text in ("Scripting: restarted", "gate: thrusters on channels 9 10 11 12", "Lua: Scripting: stopped"):
        assert told(MONITOR.initial, StatusText(t_ns=5, severity=2, text=text))[1] == [{}]


# --- cut -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pwm", [NEUTRAL, TURNING])
def test_the_safety_switch_is_a_condition_whatever_is_sent_and_whatever_the_pulses_show(pwm):
    state, _ = told(sending(3000, pwm), servo(3000, *pwm[:2]), MotorOutputs(t_ns=3000 * MS, enabled=False))
    assert "safety switch" in condition(state, 3010)["outputs_cut"]
    state, _ = told(state, MotorOutputs(t_ns=3500 * MS, enabled=True))
    assert condition(state, 3510) == {}


@pytest.mark.parametrize("pwm", [NEUTRAL, TURNING])
def test_no_pulse_at_all_is_seen_at_once_and_is_no_still(pwm):
    state, _ = told(sending(3000, pwm), servo(2900, *pwm[:2]))
    state, events = told(state, servo(3000, 0, 0), servo(3100, 0, 0))
    assert events == [{}, {}]
    why = condition(state, 3110)["outputs_cut"]
    assert "BRD_SAFETY_DEFLT" in why and "output 1, 2" in why
    assert condition(told(state, servo(3200, 0, 1500))[0], 3210) == {}


def test_an_autopilot_that_has_just_started_is_given_time_to_load_its_script():
    state, _ = told(MONITOR.initial, *(servo(t, 0, 0) for t in range(1000, 3000, 100)))
    assert condition(state, 2999) == {}
    assert "outputs_cut" in condition(state, 1000 + LOADS_NS // MS)
    state, _ = told(state, servo(3000, 1500, 1500), servo(3100, 0, 0))
    assert "outputs_cut" in condition(state, 3110)


def test_a_silent_autopilot_is_a_new_one_when_it_is_back():
    state, _ = told(sending(3000), servo(2900, 1620, 1380), servo(3000, 0, 0), MotorOutputs(t_ns=1, enabled=False))
    state, report = MONITOR.on_tick(state, view(9000 * MS, autopilot_alive=False))
    assert report.events == {} and condition(state, 9100) == {}
    assert (state.sent, state.carries) and state == replace(MONITOR.initial, sent=state.sent)
