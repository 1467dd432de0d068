"""What a demo's summary says of a drive that was stopped, and of a station that was never reached."""

import pytest

from companion.cli.simulator import summary
from companion.core.messages import Alert, OverrideLease, Tick

STOP_NS = 5_000_000_000


def lease(t_ns, source):
    return OverrideLease(
        t_ns=t_ns, index=0, channels=(9,), pwm_us=(1500,), source=source, valid_for_s=0.3, reason="", f_command_n=(0.0,)
    )


def said(*alerts, last_drive_ns):
    messages = {kind: [] for kind in summary.KINDS}
    messages[Tick] = [Tick(t_ns=0, index=0)]
    messages[Alert] = list(alerts)
    messages[OverrideLease] = [
        lease(STOP_NS // 2, "plan"),
        lease(last_drive_ns, "plan"),
        lease(20 * STOP_NS, "neutral"),
    ]
    return summary.why_stopped(messages)


STOP = Alert(
    t_ns=STOP_NS, level="error", text="stopped: UWB is silent; thrusters are neutral until the operator starts again"
)


@pytest.mark.parametrize(
    "alert", [Alert(t_ns=1, level="error", text="thruster 1 is dead"), Alert(t_ns=1, level="info", text=STOP.text)]
)
def test_other_alerts_stop_nothing(alert):
    assert said(alert, last_drive_ns=STOP_NS) == ""


def test_a_stop_for_good_is_told_with_its_time_and_reason():
    assert said(STOP, last_drive_ns=STOP_NS + 100_000_000) == "driving was stopped after 5.0 s: UWB is silent"


def test_a_boat_that_was_started_again_was_not_stopped():
    assert said(STOP, last_drive_ns=2 * STOP_NS) == ""
