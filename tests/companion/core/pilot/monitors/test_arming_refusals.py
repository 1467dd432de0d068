"""Why the autopilot refuses to arm reaches the operator in its own words, once each, for as long as it stands."""

import pytest

from companion.core.messages import Alert, CommandAck, Heartbeat, StatusText
from companion.core.pilot.monitors.arming_refusals import STANDS_NS, ArmingMonitor, ArmingRefusals, explain
from tests.companion.core.pilot.pilot_shell import Shell, operator
from tests.companion.core.pilot.pilot_shell import heartbeat as shell_heartbeat
from tests.support.drive_fixture import under_way

S = 1_000_000_000
ARM = 400


def text(words, t_ns=0):
    return StatusText(t_ns=t_ns, severity=2, text=words)


def heartbeat(armed):
    return Heartbeat(t_ns=0, system=1, component=1, vehicle_type=11, autopilot=3, base_mode=0, custom_mode=0,
                     system_status=4, armed=armed)  # fmt: skip


def after(*messages, start=None, t_ns=0):
    state = start or ArmingRefusals()
    for message in messages:
        state, report = ArmingMonitor().on_message(state, message, t_ns)
        assert not report.events and not report.alerts
    return state


def test_each_reason_is_said_once_and_stands_while_it_is_repeated():
    accels, outputs = text("Arm: Accels inconsistent"), text("PreArm: check skid steering config")
    state = after(accels, outputs, accels)
    state, why, alerts = explain(state, S)
    assert why == "check skid steering config; Accels inconsistent"
    assert [a.text for a in alerts] == [f"the autopilot refuses to arm: {r}" for r in why.split("; ")]
    state = after(accels, start=state, t_ns=2 * S)
    assert explain(state, 2 * S)[1:] == (why, [])
    assert explain(state, STANDS_NS + S)[1] == "Accels inconsistent"
    assert explain(state, 2 * S + STANDS_NS + 1)[1] == ""


def test_once_armed_all_is_forgotten_and_said_anew():
    state, _, _ = explain(after(text("Arm: Radio failsafe on")), 0)
    state = after(heartbeat(False), start=state)
    assert explain(state, 0)[1:] == ("Radio failsafe on", [])
    state = after(heartbeat(True), start=state)
    assert explain(state, 0)[1:] == ("", [])
    assert len(explain(after(text("Arm: Radio failsafe on"), start=state), 0)[2]) == 1


@pytest.mark.parametrize(("result", "words"), [(4, "failed"), (2, "denied"), (99, "result 99")])
def test_a_refusal_without_words_is_a_refusal(result, words):
    state = after(CommandAck(t_ns=0, command=ARM, result=result))
    assert explain(state, S)[1] == f"without a reason ({words})"
    assert explain(after(text("Arm: Compass not healthy"), start=state), S)[1] == "Compass not healthy"


@pytest.mark.parametrize(
    "message",
    [
        CommandAck(t_ns=0, command=ARM, result=0),
        CommandAck(t_ns=0, command=ARM, result=5),
        CommandAck(t_ns=0, command=176, result=4),
        text("gate: thrusters on channels 9 10 11 12"),
        text("Throttle armed"),
        text("Arm"),
    ],
)
def test_what_is_no_refusal_says_nothing(message):
    assert explain(after(message), 0)[1:] == ("", [])


def test_the_operator_reads_it_while_the_boat_waits_to_be_armed():
    boat = Shell(*under_way(), index=1000)
    boat.feed(operator("stop"), shell_heartbeat(boat.t_ns, armed=False), operator("start"))
    boat.tick()
    boat.feed(text("Arm: Accels inconsistent", boat.t_ns))
    said = [o.text for o in boat.tick() if isinstance(o, Alert)]
    assert said == ["the autopilot refuses to arm: Accels inconsistent"]
    assert boat.state.helm.mode == "starting"
    assert boat.state.helm.why == "waiting for the autopilot to be armed, which it refuses: Accels inconsistent"
    boat.feed(shell_heartbeat(boat.t_ns, armed=False, mode=4))
    boat.tick()
    assert boat.state.helm.why == "waiting for the autopilot to be MANUAL"
