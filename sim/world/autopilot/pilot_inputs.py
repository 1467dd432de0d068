"""What channels do beside driving: the steering stick arms and disarms, the mode channel changes the mode.

Rudder arming (ARMING_RUDDER 1: arm, 2: arm and disarm, the default): with the throttle channel in its trim, the
steering channel beyond 8/9 of its travel for 2 s. To the right arms, to the left disarms; an override does it as
well as a stick. Not in modes that drive themselves. Direction and threshold: the firmware's source
(`Rover::rudder_arm_disarm_check`).

Mode switch: a new position of MODE_CH, held for 0.2 s, enters that position's MODEn; below 900 and from 2200 us it
says nothing (source, `RC_Channels::read_mode_switch`). It is looked at whenever there is RC input.
"""

from __future__ import annotations

from sim.world.autopilot.modes import DRIVES_ITSELF, ModeControl
from sim.world.autopilot.parameters import ParameterStore
from sim.world.autopilot.rc import RcInput
from sim.world.autopilot.stick import in_trim, share

_RUDDER_NS = 2_000_000_000
_NEAR_FULL = 4000 / 4500
_DISARM_TOO = 2
_POSITIONS_US = (1231, 1361, 1491, 1621, 1750)
_SWITCH_NS = 200_000_000


class PilotInputs:
    """Looks at the channels once for each time that RC input came."""

    def __init__(self, parameters: ParameterStore, rc: RcInput, modes: ModeControl):
        self._parameters, self._rc, self._modes = parameters, rc, modes
        self._read_ns: int | None = None
        self._rudder_ns: int | None = None
        self._position: int | None = None
        self._seen: tuple[int, int] | None = None

    def advance(self, t_ns: int) -> None:
        """At t: act upon channels that said something since the last call."""
        if self._rc.last_input_ns == self._read_ns or not self._modes.started:
            return
        self._read_ns = self._rc.last_input_ns
        self._rudder(t_ns)
        self._mode_switch(t_ns)

    def _rudder(self, t_ns: int) -> None:
        p, modes = self._parameters, self._modes
        throttle, steering = int(p["RCMAP_THROTTLE"]), int(p["RCMAP_ROLL"])
        allowed = p["ARMING_RUDDER"] == _DISARM_TOO if modes.armed else p["ARMING_RUDDER"] > 0
        quiet = in_trim(p, throttle, self._rc.radio_in_us[throttle - 1]) and modes.mode not in DRIVES_ITSELF
        stick = share(p, steering, self._rc.radio_in_us[steering - 1])
        if not (allowed and quiet and (-stick if modes.armed else stick) > _NEAR_FULL):
            self._rudder_ns = None
        elif self._rudder_ns is None:
            self._rudder_ns = t_ns
        elif t_ns - self._rudder_ns >= _RUDDER_NS:
            self._rudder_ns = None
            if modes.armed:
                modes.disarm()
            else:
                modes.arm(force=False, by_stick=True)

    def _mode_switch(self, t_ns: int) -> None:
        channel = int(self._parameters["MODE_CH"])
        value_us = self._rc.radio_in_us[channel - 1] if channel > 0 else 0
        if not 900 < value_us < 2200:
            return
        position = sum(value_us >= edge for edge in _POSITIONS_US)
        if self._seen is None or self._seen[0] != position:
            self._seen = position, t_ns
        elif position != self._position and t_ns - self._seen[1] >= _SWITCH_NS:
            self._position = position
            self._modes.set_mode(int(self._parameters[f"MODE{position + 1}"]))
