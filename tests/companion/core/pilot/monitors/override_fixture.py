"""Leases, RC_CHANNELS and SERVO_OUTPUT_RAW for the tests of the override monitor."""

from companion.core.messages import OverrideLease, RcChannels, ServoOutput
from companion.core.pilot.monitors.override_monitor import (
    NOTHING_SENT,
    OverrideMonitor,
    at_rc,
)
from companion.core.pilot.monitors.sent_pulses import at_lease
from tests.companion.core.pilot.monitors.monitor_fixture import view

MS = 1_000_000
CHANNELS = (9, 10, 1)
NEUTRAL = (1500, 1500, 1500)


def lease(t_ms, pwm):
    return OverrideLease(t_ns=t_ms * MS, index=t_ms, channels=CHANNELS, pwm_us=pwm, valid_for_s=0.3, source="plan",
                         reason="", f_command_n=(0.0, 0.0))  # fmt: skip


def sent(*leases, start=NOTHING_SENT):
    echo = start
    for t_ms, pwm in leases:
        echo = at_lease(echo, lease(t_ms, pwm))
    return echo


def driving(until_ms, pwm=(1620, 1380, 1500)):
    """A lease every 100 ms from 0, each 1 us more, so that every one can be told apart."""
    return sent(*((t, (pwm[0] + t // 100, pwm[1], pwm[2])) for t in range(0, until_ms + 1, 100)))


def rc(t_ms, shown, **others):
    channels = [0] * 18
    for channel, pwm in zip(CHANNELS, shown, strict=True):
        channels[channel - 1] = pwm
    for channel, pwm in others.items():
        channels[int(channel[1:]) - 1] = pwm
    return RcChannels(t_ns=t_ms * MS, pwm_us=tuple(channels))


def servo(t_ms, *outputs):
    return ServoOutput(t_ns=t_ms * MS, pwm_us=(*outputs, *[0] * (16 - len(outputs))))


def at_tick(echo, t_ns, *, heard):
    monitor = OverrideMonitor(CHANNELS, 2, 1)
    echo, report = monitor.on_tick(echo, view(t_ns, autopilot_alive=heard))
    return echo, report.events, list(report.alerts)


def heard(echo, messages):
    """RC echoes one after the other; whether each left the overrides ignored."""
    found = []
    for message in messages:
        echo, _ = at_rc(echo, message, CHANNELS, 1)
        found.append(echo.rc_ignored)
    return echo, found
