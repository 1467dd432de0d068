"""The Omni-X mixer (FRAME_TYPE 2): three pilot inputs to four motors, SERVOn_FUNCTION 33 to 36.

    output_i = throttle * t_i + steering * s_i + lateral * l_i, all scaled back alike where one passes 1

The factors are those observed; the scaling back (also of steering plus throttle beforehand), the slew limit on
the throttle alone and the whole per cent of the inputs in 4.6 follow the firmware's source (`AP_MotorsUGV`,
`Mode::get_pilot_desired_steering_and_throttle`). Only armed, in MANUAL and with valid RC input are the inputs
anything but zero, and disarmed the outputs are at SERVOn_TRIM.
"""

from __future__ import annotations

import math

from sim.world.autopilot.failsafe import Failsafe
from sim.world.autopilot.modes import Mode, ModeControl
from sim.world.autopilot.parameters import ParameterStore
from sim.world.autopilot.rc import RcInput
from sim.world.autopilot.stick import share

OMNI_X = 2
FIRST_FUNCTION = 33
FACTORS = ((1, -1, -1), (1, -1, 1), (1, 1, -1), (1, 1, 1))
"""Shares of throttle, steering and lateral, motor 1 first."""
_S = 1_000_000_000


class OmniMixer:
    """`motors`: what each motor should do, -1 to 1, as of the last `advance`."""

    def __init__(self, parameters: ParameterStore, rc: RcInput, modes: ModeControl, failsafe: Failsafe):
        self._parameters, self._rc, self._modes, self._failsafe = parameters, rc, modes, failsafe
        self._throttle = 0.0
        self._t_ns: int | None = None
        self.motors = (0.0,) * len(FACTORS)

    def advance(self, t_ns: int) -> None:
        """Mix the pilot's inputs of t."""
        p = self._parameters
        if p["FRAME_TYPE"] != OMNI_X:
            return
        steering, throttle, lateral = self._inputs()
        if (turn := abs(steering) + abs(throttle)) > 1.0:
            steering, throttle = steering / turn, throttle / turn
        elapsed_s = 0.0 if self._t_ns is None else (t_ns - self._t_ns) / _S
        self._t_ns = t_ns
        limit = p["MOT_SLEWRATE"] / 100.0 * elapsed_s if p["MOT_SLEWRATE"] > 0 else math.inf
        self._throttle += max(-limit, min(limit, throttle - self._throttle))
        if not self._modes.armed:
            self._throttle, self.motors = 0.0, (0.0,) * len(FACTORS)
            return
        mixed = [self._throttle * t + steering * s + lateral * side for t, s, side in FACTORS]
        largest = max(1.0, *map(abs, mixed))
        self.motors = tuple(value / largest for value in mixed)

    def _inputs(self) -> tuple[float, float, float]:
        """Steering, throttle, lateral, -1 to 1."""
        if not (self._modes.armed and self._modes.mode is Mode.MANUAL and self._failsafe.rc_valid):
            return 0.0, 0.0, 0.0
        steering, throttle, lateral = (self._stick(key) for key in ("ROLL", "THROTTLE", "YAW"))
        if self._parameters.firmware.whole_per_cent:
            throttle, lateral = math.trunc(100.0 * throttle) / 100.0, math.trunc(100.0 * lateral) / 100.0
        return steering, throttle, lateral

    def _stick(self, key: str) -> float:
        number = int(self._parameters[f"RCMAP_{key}"])
        return share(self._parameters, number, self._rc.radio_in_us[number - 1])
