"""What keeps the autopilot from arming, in the firmware's words.

ARMING_CHECK 0 skips all of it; its bits (1: all) are obeyed for the safety switch and RC input. Outputs have no bit:

    no output counts           26, 70, 73, 74, 94 (Script1 alone), a sail 89, 128, 137, or FRAME_TYPE other than 0
    both or none               73 and 74;    26 with one of 70 and the sails
    FRAME_TYPE 1, 2, 3         outputs for all of its 3, 4, 4 motors (33 ...)

Source: ArduPilot, AP_Arming.cpp, AP_MotorsUGV::pre_arm_check; 4.6 and 4.7 asked (scripts/evidence firmware).
"""

from __future__ import annotations

from collections.abc import Callable

from sim.world.autopilot.failsafe import RADIO, Failsafe
from sim.world.autopilot.modes import ARMS_WITHOUT_HOME, UNARMABLE, ModeControl
from sim.world.autopilot.parameter_table import CHANNELS
from sim.world.autopilot.parameters import ParameterStore
from sim.world.autopilot.rc import RcInput
from sim.world.autopilot.stick import in_trim

_ALL, _RC, _SWITCH = 1 << 0, 1 << 6, 1 << 11
_STEERING, _THROTTLE, _LEFT, _RIGHT, _SCRIPT_1, _MOTOR_1 = 26, 70, 73, 74, 94, 33
_SAILS = frozenset({89, 128, 137})
_MOTORS = {1: 3, 2: 4, 3: 4}
"""Motors by FRAME_TYPE."""
_LOOK_NS, _SOON_NS, _PERIOD_NS = 1_000_000_000, 4_000_000_000, 30_000_000_000
MOTORS_CHECK = "PreArm: "
"""What texts about outputs begin with, also when arming was asked for."""


def pre_arm_faults(p: ParameterStore, modes: ModeControl, failsafe: Failsafe) -> list[str]:
    """Why arming would be refused now, in the order in which it is said; empty when it would not."""
    checks = int(p["ARMING_CHECK"])
    if not checks:
        return []
    faults = []
    if modes.safety_on and checks & (_ALL | _SWITCH):
        faults.append("Hardware safety switch")
    if modes.mode not in ARMS_WITHOUT_HOME | UNARMABLE:
        faults.append("AHRS: waiting for home")
    if failsafe.bits & RADIO and checks & (_ALL | _RC):
        faults.append("Radio failsafe on")
    if fault := _output_fault(p):
        faults.append(MOTORS_CHECK + fault)
    if modes.mode in UNARMABLE:
        faults.append("Mode not armable")
    return faults


def stick_faults(p: ParameterStore, rc: RcInput, failsafe: Failsafe, by_stick: bool) -> list[str]:
    """What is said of sticks away from neutral, once nothing else is wrong; the one that arms (RCMAP_ROLL) may be."""
    checks = int(p["ARMING_CHECK"])
    if not (checks & (_ALL | _RC) and failsafe.rc_valid):
        return []
    names = ("Yaw", "Throttle") if by_stick else ("Roll", "Yaw", "Throttle")
    numbers = {name: int(p[f"RCMAP_{name.upper()}"]) for name in names}
    away = {name: n for name, n in numbers.items() if not in_trim(p, n, rc.radio_in_us[n - 1])}
    return [f"{name} (RC{n}) is not neutral" for name, n in away.items()]


def in_full(fault: str, asked: bool) -> str:
    """The text of a fault; `asked`: somebody has asked to arm."""
    return fault if fault.startswith(MOTORS_CHECK) else f"{'Arm' if asked else 'PreArm'}: {fault}"


class PreArmReport:
    """When the faults are said unasked: every 30 s, and once they begin (source: `AP_Arming::update`)."""

    def __init__(self, boot_ns: int):
        self._said_ns = self._looked_ns = boot_ns
        self._passed = False
        self._at_once = False

    def due(self, faults: Callable[[], list[str]], t_ns: int) -> list[str]:
        """What is to be said at t, where the autopilot is disarmed."""
        if t_ns - self._looked_ns < _LOOK_NS:
            return []
        self._looked_ns = t_ns
        found = faults()
        since_ns = t_ns - self._said_ns
        says = since_ns > _PERIOD_NS or (self._at_once and since_ns > _SOON_NS)
        if says:
            self._said_ns, self._at_once = t_ns, False
        self._at_once |= bool(found) and self._passed
        self._passed = not found
        return found if says else []


def _output_fault(p: ParameterStore) -> str | None:
    functions = {int(p[f"SERVO{n}_FUNCTION"]) for n in range(1, CHANNELS + 1)}
    frame, sail = int(p["FRAME_TYPE"]), bool(functions & _SAILS)
    if not (functions & {_STEERING, _THROTTLE, _LEFT, _RIGHT, _SCRIPT_1} or sail or frame in _MOTORS):
        return "no motor, sail or scripting outputs defined"
    if (_LEFT in functions) != (_RIGHT in functions):
        return "check skid steering config"
    if (sail or _THROTTLE in functions) != (_STEERING in functions):
        return "check steering and throttle config"
    missing = [n for n in range(_MOTOR_1, _MOTOR_1 + _MOTORS.get(frame, 0)) if n not in functions]
    return f"servo function {missing[0]} unassigned" if missing else None
