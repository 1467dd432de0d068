"""Whether pulses leave the autopilot: whatever takes the outputs away ends the driving until an operator starts again.

    cut     the safety switch is on (SYS_STATUS, bit MOTOR_OUTPUTS), or no thruster's output has a pulse
            (SERVO_OUTPUT_RAW); seen at rest as well; condition `outputs_cut`
    still   no thruster turns though every lease that may explain the echo asks for it: the gate is shut or its script
            has stopped, at whatever cause; or the autopilot says so of its scripts; event `outputs_still`

Servos are not looked at: a trimmed one is not at 1500 us when nothing turns, and a rudder that moves drives nothing.
Both messages are looked at: a board with an IO processor need not show in SERVO_OUTPUT_RAW what its safety switch does,
for it reads those pulses back from the processor, while the bit is the switch itself (source: AP_IOMCU, GCS.cpp).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec.structs import replace

from companion.core.messages import MotorOutputs, OverrideLease, ParamValue, ServoOutput, StatusText
from companion.core.pilot.modes import Event
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView
from companion.core.pilot.monitors.override_hints import dead_hint, still_hint
from companion.core.pilot.monitors.sent_pulses import (
    SentPulses,
    at_lease,
    at_parameter,
    expected_pulses,
    nothing_turns,
    outputs_of,
    scripted_output,
)

STILL_ECHOES = 2
"""So many in a row: a stamp may lie; assumed. At 10 Hz they take 0.1 to 0.2 s."""
LOADS_NS = 5_000_000_000
"""An autopilot that has just started has no pulses until its script has been loaded; assumed."""
SCRIPTS_STOPPED = "Scripting: stopped"
"""Text of the firmware when its Lua machine has ended (source: AP_Scripting.cpp)."""


class OutputState(SentPulses, frozen=True):
    """`pulses_us`: output -> pulse width of the latest echo; `still`: echoes in a row in which nothing turned.

    `dead_ns`: since when no output has had a pulse; `lived`: one had, since the autopilot was first heard;
    `enabled`: what the latest SYS_STATUS said; `scripted`: output -> whether a script writes it.
    """

    pulses_us: Mapping[int, int] = msgspec.field(default_factory=dict)
    still: int = 0
    dead_ns: int | None = None
    lived: bool = False
    enabled: bool = True
    scripted: Mapping[int, bool] = msgspec.field(default_factory=dict)


class OutputMonitor(Monitor[OutputState]):
    """Condition `outputs_cut`, event `outputs_still`.

    `channels`: RC channels of the `thrusters`, in order, then those of servos.
    """

    hears = (OverrideLease, ServoOutput, MotorOutputs, ParamValue, StatusText)
    initial = OutputState()

    def __init__(self, channels: tuple[int, ...], thrusters: int):
        self._channels, self._thrusters = channels, thrusters

    def on_message(self, state: OutputState, message: Any, t_ns: int) -> tuple[OutputState, MonitorReport]:
        """What was sent, an echo, the safety switch, a parameter, or a text."""
        if isinstance(message, OverrideLease):
            return at_lease(state, message), NOTHING
        if isinstance(message, MotorOutputs):
            return replace(state, enabled=message.enabled), NOTHING
        if isinstance(message, ParamValue):
            scripted = {**state.scripted, **scripted_output(message)}
            return replace(at_parameter(state, message, self._channels), scripted=scripted), NOTHING
        if isinstance(message, StatusText):
            return state, MonitorReport(self._at_text(state, message))
        state, events = self._at_echo(state, message)
        return state, MonitorReport(events)

    def on_tick(self, state: OutputState, view: TickView) -> tuple[OutputState, MonitorReport]:
        """Whether the outputs are cut. A silent autopilot may have started again when it is back."""
        if not view.autopilot_alive:
            return OutputState(sent=state.sent, carries=state.carries, scripted=state.scripted), NOTHING
        if not state.enabled:
            return state, MonitorReport(
                {"outputs_cut": "the autopilot's safety switch (BRD_SAFETY_DEFLT) is on, no pulse leaves it"}
            )
        if state.dead_ns is not None and (state.lived or view.t_ns - state.dead_ns >= LOADS_NS):
            return state, MonitorReport({"outputs_cut": dead_hint(state.pulses_us)})
        return state, NOTHING

    def _at_echo(self, state: OutputState, echo: ServoOutput) -> tuple[OutputState, dict[Event, str]]:
        numbers = outputs_of(state, self._thrusters)
        pulses_us = {n: echo.pwm_us[n - 1] if n <= len(echo.pwm_us) else 0 for n in numbers}
        dead = not any(pulses_us.values())
        dead_ns = (echo.t_ns if state.dead_ns is None else state.dead_ns) if dead else None
        sent = [pwm_us[: len(numbers)] for pwm_us in expected_pulses(state, echo.t_ns)]
        to_turn = bool(sent) and not any(nothing_turns(pwm_us) for pwm_us in sent)
        still = state.still + 1 if to_turn and nothing_turns(pulses_us.values()) else 0
        lived = state.lived or not dead
        state = replace(state, pulses_us=pulses_us, dead_ns=dead_ns, lived=lived, still=still)
        if still < STILL_ECHOES or dead:
            return state, {}
        return state, {"outputs_still": still_hint(pulses_us)}

    def _at_text(self, state: OutputState, message: StatusText) -> dict[Event, str]:
        """Scripts that stopped, where one writes one of our outputs, or where it is not known which writes what."""
        numbers = outputs_of(state, len(self._channels))
        if not message.text.startswith(SCRIPTS_STOPPED) or not any(state.scripted.get(n, True) for n in numbers):
            return {}
        return {"outputs_still": "the autopilot's scripts stopped, and the gate with them; look at gate.lua"}
