"""Outputs against what was sent (SERVO_OUTPUT_RAW), functions of outputs, echoes that do not come."""

import pytest

from companion.core.messages import ParamValue
from companion.core.pilot.monitors.override_monitor import (
    NOTHING_SENT,
    PERSISTS_NS,
    SILENT_NS,
    OverrideState,
    at_rc,
    at_servo,
)
from companion.core.pilot.monitors.sent_pulses import at_lease, at_parameter, outputs_of
from tests.companion.core.pilot.monitors.override_fixture import (
    CHANNELS,
    MS,
    NEUTRAL,
    at_tick,
    driving,
    heard,
    lease,
    rc,
    sent,
    servo,
)

# --- SERVO_OUTPUT_RAW ------------------------------------------------------------------------------------


def outputs(echo, *pulses, times=range(3000, 5001, 100)):
    texts = []
    for t in times:
        shown = pulses or (1620 + (t - 30) // 100, 1380)
        echo, alerts = at_servo(echo, servo(t, *shown), 2)
        texts += [(t, a.level, a.text) for a in alerts]
    return echo, texts


def test_outputs_that_follow_are_quiet():
    assert outputs(driving(5400))[1] == []
    assert outputs(NOTHING_SENT, 1500, 1700)[1] == [], "nothing was sent that it could follow"
    assert outputs(sent(*((t, NEUTRAL) for t in range(0, 5500, 100))), 1500, 1500)[1] == []
    assert outputs(sent(*((t, NEUTRAL) for t in range(0, 5500, 100))), 0, 0)[1] == [], "no pulse is neutral"


@pytest.mark.parametrize(
    ("pulses", "words"),
    [((1380, 1620), "SERVOn_REVERSED"), ((1645, 1500), "SERVOn_REVERSED"), ((0, 1380), "SERVOn_REVERSED")],
)
def test_outputs_that_do_not_follow_are_told_once_with_what_to_look_at(pulses, words):
    echo, texts = outputs(driving(5400), *pulses)
    ((t, level, text),) = texts
    assert t == 3000 + PERSISTS_NS // MS and level == "error" and words in text
    _, texts = outputs(echo, times=range(5100, 5300, 100))
    assert texts == [(5100, "info", "the autopilot's outputs follow again")]


@pytest.mark.parametrize("pulses", [(0, 0), (1500, 1500), (1500, 0), (1480, 1524)])
def test_outputs_at_which_nothing_turns_are_left_to_the_output_monitor(pulses):
    assert outputs(driving(5400), *pulses)[1] == []


def test_a_thruster_that_turns_while_neutral_is_sent_is_told():
    resting = sent(*((t, NEUTRAL) for t in range(0, 5500, 100)))
    _, ((_, level, text),) = outputs(resting, 0, 1700)
    assert level == "error" and "output 2 at 1700 us though neutral is sent" in text and "output 1" not in text
    assert "SERVO_RC_FS_MSK" in text


def functions(echo, told):
    for number, function in told.items():
        value = ParamValue(t_ns=0, name=f"SERVO{number}_FUNCTION", value=float(function), index=None, count=1200)
        echo = at_parameter(echo, value, CHANNELS[:2])
    return echo


@pytest.mark.parametrize(
    ("told", "numbers"),
    [
        ({}, [1, 2]),
        ({1: 94, 2: 95}, [1, 2]),
        ({1: 95, 2: 94}, [2, 1]),
        ({5: 94, 6: 95, 1: 0, 2: 0}, [5, 6]),
        ({5: 149, 6: 148}, [6, 5]),
        ({7: 60}, [1, 7]),
        ({9: 1, 10: 1}, [9, 10]),
        ({9: 94, 3: 94}, [3, 2]),
        ({9: 94, 3: 95, 32: 96}, [9, 3]),
        ({5: 94, 6: 33, 7: 53, 8: 0, 99: 95}, [5, 99]),
    ],
    ids=str,
)
def test_functions_say_on_which_output_a_thruster_is(told, numbers):
    assert outputs_of(functions(NOTHING_SENT, told), 2) == numbers


def test_a_function_that_is_told_anew_replaces_the_one_before():
    echo = functions(functions(NOTHING_SENT, {5: 94, 6: 95}), {5: 0, 7: 94})
    assert outputs_of(echo, 2) == [7, 6]
    others = ("SERVO1_TRIM", "SERVO_32_ENABLE", "SERVO01_FUNCTION", "SERVO1_FUNCTIONS", "XSERVO1_FUNCTION")
    for name in others:
        assert at_parameter(echo, ParamValue(t_ns=0, name=name, value=94.0, index=1, count=2), CHANNELS[:2]) == echo
    for value in (float("nan"), float("inf")):
        wrong = ParamValue(t_ns=0, name="SERVO1_FUNCTION", value=value, index=1, count=2)
        assert at_parameter(echo, wrong, CHANNELS[:2]) == echo


def test_outputs_elsewhere_are_judged_where_they_are():
    """Thruster 1 on output 4, thruster 2 on output 3; outputs 1 and 2 carry something else."""
    echo = functions(driving(5400), {4: 94, 3: 95, 1: 26, 2: 0})
    told = []
    for t in range(3000, 5001, 100):
        echo, alerts = at_servo(echo, servo(t, 1900, 0, 1380, 1620 + (t - 30) // 100), 2)
        told += alerts
    assert told == []
    for t in range(5100, 6800, 100):
        echo, alerts = at_servo(at_lease(echo, lease(t, (1640, 1380, 1500))), servo(t, 1640, 1380, 1380, 1560), 2)
        told += alerts
    (alert,) = told
    assert alert.text.startswith("output 4 at 1560 us, which was not sent"), "where the first thruster is"
    assert "output 20 at 0 us" in texts_of(functions(driving(5400), {20: 94})), "one that SERVO_OUTPUT_RAW lacks"


def texts_of(echo):
    texts = ""
    for t in range(3000, 5001, 100):
        echo, alerts = at_servo(echo, servo(t, 0, 1380), 2)
        texts += "".join(a.text for a in alerts)
    return texts


def test_as_long_as_overrides_are_ignored_outputs_are_not_told_beside_it():
    echo, _ = heard(driving(5400), [rc(3000, NEUTRAL)])
    assert outputs(echo, 1500, 1500)[1] == []


# --- silence ---------------------------------------------------------------------------------------------


def test_echoes_that_do_not_come_are_told_once_each_and_only_of_a_living_autopilot():
    echo, told = sent((0, NEUTRAL)), []
    for t_ms in range(0, 12_000, 100):
        if t_ms < 3000:
            echo, _ = at_rc(echo, rc(t_ms, NEUTRAL), CHANNELS, 1)
        echo, _, alerts = at_tick(at_lease(echo, lease(t_ms, NEUTRAL)), t_ms * MS, heard=True)
        told += [(t_ms, a.text.split(" for")[0]) for a in alerts]
    assert told == [(SILENT_NS // MS + 100, "no SERVO_OUTPUT_RAW"), (SILENT_NS // MS + 3000, "no RC_CHANNELS")]
    echo, _, alerts = at_tick(OverrideState(sent=echo.sent, rc_ns=0, servo_ns=0), 90_000 * MS, heard=False)
    assert alerts == [] and at_tick(echo, 90_100 * MS, heard=True)[2] == [], "silence counts from the first heartbeat"
