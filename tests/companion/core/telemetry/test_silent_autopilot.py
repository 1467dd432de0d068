"""What is published of an autopilot or a sensor that fell silent, of outputs, and of pulses that went nowhere."""

from types import SimpleNamespace

from companion.core import messages as m
from companion.core.telemetry import structs as shore
from companion.core.telemetry import topics
from companion.core.telemetry.view import TelemetryView, Who
from tests.support.drive_fixture import setup

S = 1_000_000_000
OUTPUTS = (1510, 1520, 1530, 1540)


def voyage(silent_ns, outputs=OUTPUTS, functions=()):
    """Everything published in 10 s with an autopilot that is heard until `silent_ns`, its port open as long."""
    view = TelemetryView(setup().pilot, Who("run", "digest", "aritra 0", 0, commands=True), 10.0)
    published = []
    for number, function in functions:
        name = f"SERVO{number}_FUNCTION"
        view.see(m.ParamValue(t_ns=0, name=name, value=float(function), index=0, count=1))
    for t_ns in range(0, 10 * S, S // 10):
        there = t_ns < silent_ns
        if there:
            view.see(m.ServoOutput(t_ns=t_ns, pwm_us=outputs))
            view.see(m.Heartbeat(t_ns=t_ns, system=1, component=1, vehicle_type=11, autopilot=3, base_mode=193,
                                 custom_mode=0, system_status=4, armed=True))  # fmt: skip
        lease = m.OverrideLease(t_ns=t_ns, index=0, channels=(9, 10, 11, 12), pwm_us=OUTPUTS, valid_for_s=0.3,
                                source="plan", reason="", f_command_n=(1.0, 2.0, 3.0, 4.0))  # fmt: skip
        timing = m.LoopTiming(t_ns=t_ns, index=0, lateness_ms=1.0, imu_to_override_ms=9.0, sent=there)
        status = m.ModeStatus(t_ns=t_ns, mode="auto", why="", driving=True)
        for message in (lease, timing, status):
            published += view.see(message)
    return published


def test_outputs_are_not_those_of_a_report_that_is_old_and_pulses_that_went_nowhere_are_said_to():
    thrusters = [x for x in voyage(3 * S) if isinstance(x, shore.ThrustersNow)]
    assert len(thrusters) > 90 and all(x.sent == (x.t_ns < 3 * S) for x in thrusters)
    assert {x.output_us for x in thrusters if x.t_ns < 3 * S} == {OUTPUTS}
    assert {x.output_us for x in thrusters if x.t_ns > 4 * S} == {None}


def test_outputs_are_those_that_carry_the_thrusters_by_the_autopilots_parameters():
    """Outputs 1 to 4 rest; a STOP was said to have reached the thrusters."""
    functions = [(n, 0) for n in range(1, 5)] + [(n, 89 + n) for n in range(5, 9)]  # 94 to 97: Script1 to Script4
    at_5_to_8 = {
        x.output_us for x in voyage(10 * S, (1500,) * 4 + OUTPUTS, functions) if isinstance(x, shore.ThrustersNow)
    }
    assert at_5_to_8 == {OUTPUTS}
    not_told = {x.output_us for x in voyage(10 * S, (1500,) * 4, functions) if isinstance(x, shore.ThrustersNow)}
    assert not_told == {None}


def test_what_a_sensor_said_of_its_quality_is_told_while_it_speaks():
    """`RTK fixed` of a receiver that was unplugged a minute ago stood there as of now."""
    sensor = SimpleNamespace(key="gnss", label="GNSS", messages=(m.Heartbeat,), figure=lambda message: "RTK fixed")
    said = SimpleNamespace(t_ns=10 * S)
    figures = [topics.links("run", (), [sensor], {m.Heartbeat: said}, t_ns).figures for t_ns in (12 * S, 70 * S)]
    assert figures == [{"GNSS": "RTK fixed"}, {}]


def test_nobody_knows_whether_a_silent_autopilot_is_armed():
    modes = [x for x in voyage(3 * S) if isinstance(x, shore.ModeNow)]
    assert {(x.armed, x.autopilot_mode) for x in modes if x.t_ns < 3 * S} == {(True, 0)}
    assert {(x.armed, x.autopilot_mode) for x in modes if x.t_ns > 8 * S} == {(None, None)}
