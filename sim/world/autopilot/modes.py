"""Modes and arming of the simulated Rover, with the refusals a client must live with.

Any mode may be entered while disarmed; armed, GUIDED and LOITER are refused without a position. Arming in
them is refused always, because this autopilot has no position source. MANUAL and HOLD arm without one.
A refusal says why in STATUSTEXTs of severity 2 that begin with "Arm: ".
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

from sim.world.autopilot.parameter_table import CHANNELS
from sim.world.autopilot.parameters import ParameterStore

_CRITICAL, _WARNING, _INFO = 2, 4, 6
_CUSTOM, _GUIDED, _MANUAL_INPUT, _ARMED = 1, 8, 64, 128


class Mode(IntEnum):
    """custom_mode numbers of the modes that are simulated."""

    MANUAL = 0
    HOLD = 4
    LOITER = 5
    GUIDED = 15
    INITIALISING = 16


_NUMBERS = frozenset(int(mode) for mode in Mode)
NEEDS_POSITION = frozenset({Mode.LOITER, Mode.GUIDED})
_DRIVING_FUNCTIONS = frozenset({70, 73, 74, *range(33, 41), *range(94, 110)})
"""SERVOn_FUNCTION that count as a motor or scripting output; pass-through (51-66, 140-155) does not."""


class ModeControl:
    """`mode`, `armed`, `safety_on` (the safety switch: no pulses at all while on)."""

    def __init__(self, parameters: ParameterStore, say: Callable[[int, str], None]):
        self._parameters, self._say = parameters, say
        self.mode = Mode.INITIALISING
        self.armed = False
        self.safety_on = bool(parameters["BRD_SAFETY_DEFLT"])

    @property
    def base_mode(self) -> int:
        """HEARTBEAT.base_mode: 65 in MANUAL disarmed, 193 armed."""
        flags = _CUSTOM
        flags |= _MANUAL_INPUT if self.mode is Mode.MANUAL else 0
        flags |= _GUIDED if self.mode in NEEDS_POSITION else 0
        return flags | (_ARMED if self.armed and self.mode is not Mode.INITIALISING else 0)

    def initialised(self) -> None:
        """Start-up is over: enter INITIAL_MODE, or MANUAL where that is not simulated."""
        number = int(self._parameters["INITIAL_MODE"])
        self.mode = Mode(number) if number in _NUMBERS else Mode.MANUAL

    def set_mode(self, number: int) -> bool:
        """Enter a mode by its number; False where it is unknown or refused."""
        if number not in _NUMBERS or number == Mode.INITIALISING or self.mode is Mode.INITIALISING:
            return False
        if self.armed and Mode(number) in NEEDS_POSITION:
            self._say(_WARNING, "Flight mode change failed")
            return False
        self.mode = Mode(number)
        return True

    def arming_faults(self) -> list[str]:
        """Why arming would be refused now; empty when it would not."""
        faults = []
        if self.safety_on:
            faults.append("Hardware safety switch")
        if self.mode in NEEDS_POSITION:
            faults.append("Need Position Estimate")
        functions = {int(self._parameters[f"SERVO{n}_FUNCTION"]) for n in range(1, CHANNELS + 1)}
        if not functions & _DRIVING_FUNCTIONS:
            faults.append("no motor, sail or scripting outputs defined")
        if self.mode is Mode.INITIALISING:
            faults.append("Mode not armable")
        return faults

    def arm(self, force: bool) -> bool:
        """Arm; without `force`, ARMING_CHECK's refusals apply and are said."""
        if self.armed:
            return True
        faults = [] if force or not self._parameters["ARMING_CHECK"] else self.arming_faults()
        for fault in faults:
            self._say(_CRITICAL, f"Arm: {fault}")
        if faults:
            return False
        self.armed = True
        self._say(_INFO, "Throttle armed")
        return True

    def disarm(self) -> None:
        """Disarm; without effect when disarmed."""
        if self.armed:
            self.armed = False
            self._say(_INFO, "Throttle disarmed")
