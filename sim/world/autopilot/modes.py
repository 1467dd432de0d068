"""Modes of the simulated Rover, with the refusals a client must live with.

A mode is entered while disarmed unless its own start fails; armed, it also needs a position where it steers by one.
This autopilot is one in a basin without GPS and never has a position. A refusal is a text. Arming is refused
(`arming`) in every mode but MANUAL and HOLD.
Source: ArduPilot Rover, mode.cpp and `_enter` of each mode; 4.6 and 4.7 asked (scripts/evidence firmware).
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

from sim.world.autopilot.parameters import ParameterStore

_CRITICAL, _WARNING, _NOTICE, _INFO = 2, 4, 5, 6
_CUSTOM, _GUIDED, _MANUAL_INPUT, _ARMED = 1, 8, 64, 128


class Mode(IntEnum):
    """custom_mode numbers of Rover."""

    MANUAL = 0
    ACRO = 1
    STEERING = 3
    HOLD = 4
    LOITER = 5
    FOLLOW = 6
    SIMPLE = 7
    DOCK = 8
    CIRCLE = 9
    AUTO = 10
    RTL = 11
    SMART_RTL = 12
    GUIDED = 15
    INITIALISING = 16


_NUMBERS = frozenset(int(mode) for mode in Mode)
NEEDS_POSITION = frozenset({Mode.LOITER, Mode.FOLLOW, Mode.SIMPLE, Mode.DOCK, Mode.CIRCLE, Mode.AUTO, Mode.RTL,
                            Mode.SMART_RTL, Mode.GUIDED})  # fmt: skip
ARMS_WITHOUT_HOME = frozenset({Mode.MANUAL, Mode.HOLD})
UNARMABLE = frozenset({Mode.RTL, Mode.SMART_RTL, Mode.INITIALISING})
_NEVER_ENTERED = frozenset({Mode.LOITER, Mode.FOLLOW, Mode.DOCK, Mode.CIRCLE, Mode.RTL, Mode.SMART_RTL,
                            Mode.INITIALISING})  # fmt: skip
"""Their start fails without a position, or without what our parameters leave off (FOLL_ENABLE, PLND_ENABLED)."""
DRIVES_ITSELF = NEEDS_POSITION - {Mode.SIMPLE}
_STICKS = frozenset({Mode.MANUAL, Mode.ACRO, Mode.STEERING})


class ModeControl:
    """`mode`, `started` (start-up is over), `armed`, `safety_on` (no pulses at all), `mission_items`: how many.

    `faults(by_stick)`: why arming would be refused, as it is said.
    """

    def __init__(
        self, parameters: ParameterStore, say: Callable[[int, str], None], faults: Callable[[bool], list[str]]
    ):
        self._parameters, self._say, self._faults = parameters, say, faults
        self.mode = Mode.INITIALISING
        self.started = False
        self.armed = False
        self.safety_on = bool(parameters["BRD_SAFETY_DEFLT"])
        self.mission_items = 0

    @property
    def base_mode(self) -> int:
        """HEARTBEAT.base_mode: 65 in MANUAL disarmed, 193 armed."""
        flags = _CUSTOM
        flags |= _MANUAL_INPUT if self.mode in _STICKS else 0
        flags |= _GUIDED if self.mode in DRIVES_ITSELF else 0
        return flags | (_ARMED if self.armed and self.mode is not Mode.INITIALISING else 0)

    def initialised(self) -> None:
        """Start-up is over: enter INITIAL_MODE, or MANUAL where there is no such mode."""
        self.started = True
        number = int(self._parameters["INITIAL_MODE"])
        self.mode = Mode(number) if number in _NUMBERS else Mode.MANUAL

    def set_mode(self, number: int) -> bool:
        """Enter a mode by its number; False, with a text, where it is unknown or refused."""
        if not self.started:
            return False
        if number not in _NUMBERS:
            self._say(_WARNING, f"No such mode {number}")
            return False
        mode = Mode(number)
        if mode is not self.mode and not self._may_enter(mode):
            self._say(_WARNING, "Flight mode change failed")
            return False
        self.mode = mode
        return True

    def _may_enter(self, mode: Mode) -> bool:
        if self.armed and mode in NEEDS_POSITION:
            return False
        if mode is Mode.AUTO and self.mission_items < 2:
            self._say(_NOTICE, "No Mission. Can't set AUTO.")
            return False
        if mode is Mode.DOCK:
            self._say(_NOTICE, "Dock: target not acquired")
        return mode not in _NEVER_ENTERED

    def arm(self, force: bool, by_stick: bool = False) -> bool:
        """Arm; without `force`, the refusals apply and are said. `by_stick`: the steering stick has asked for it."""
        if self.armed:
            return True
        faults = [] if force else self._faults(by_stick)
        for fault in faults:
            self._say(_CRITICAL, fault)
        if faults:
            return False
        self.armed = True
        self._say(_INFO, "Throttle armed")
        if not force and not self._parameters["ARMING_CHECK"]:
            self._say(_WARNING, "Warning: Arming Checks Disabled")
        return True

    def disarm(self) -> None:
        """Disarm; without effect when disarmed."""
        if self.armed:
            self.armed = False
            self._say(_INFO, "Throttle disarmed")
