"""Rules of arming: whether the autopilot would arm with the outputs that it has.

It refuses (source of ArduPilot Rover 4.6 and 4.7; 1 and 4 also observed) unless ALL of this holds:

1. an output has function 26, 70, 73, 74, 94 or a sail's, or FRAME_TYPE is not 0. Script2-16 (95 to 109), motors (33 to
   36) of no frame type and pass-through do not count
2. both of 73 and 74 (throttle left and right) are there, or none
3. both of 26 (steering) and 70 (throttle, or a sail) are there, or none
4. each motor of the mixer that FRAME_TYPE chooses has an output
5. once there is RC input, roll, yaw and throttle (RCMAP_*) read 0: within RCn_DZ of RCn_TRIM, or so little beyond that
   a whole number of hundredths of the travel (roll: of 4500) is 0
"""

from __future__ import annotations

from collections.abc import Iterator

from companion.core.constants import NEUTRAL_US
from companion.core.preflight.rows import ParameterSet, Row, number
from companion.core.preflight.rules.making import row
from companion.core.preflight.wiring import MOTORS, Companion, Wiring, output_names

STEERING, THROTTLE, THROTTLE_LEFT, THROTTLE_RIGHT, SCRIPT1 = 26, 70, 73, 74, 94
SAILS = frozenset({89, 128, 137})
COUNTED = frozenset({STEERING, THROTTLE, THROTTLE_LEFT, THROTTLE_RIGHT, SCRIPT1}) | SAILS
MIXER_MOTORS = {1: 3, 2: 4, 3: 4, 4: 3}
"""FRAME_TYPE -> number of motors, from function 33 on."""
REFUSES = "the autopilot refuses to arm"
ALL, RC = 1 << 0, 1 << 6
"""Bits of ARMING_CHECK; ARMING_SKIPCHK (4.7) has the second."""
THROTTLE_CHECKED, OTHERS_SKIPPED = 1 << 5, 1 << 6
"""Bits of RC_OPTIONS (reference); the first is set by default."""


def arming_outputs(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Outputs for which arming would be refused."""
    if not arming_is_checked(p):
        return
    functions = {p.whole(f"SERVO{n}_FUNCTION") for n in output_names(p)}
    frame = p.whole("FRAME_TYPE")
    if not functions & COUNTED and not frame:
        found, why = (
            "nothing that counts",
            f"{REFUSES} while no output has function 94 or a motor's (95 to 109 do not count)",
        )
        fix = "set SERVO8_FUNCTION to 94 (an unused pin as Script1)"
        yield row("SERVOn_FUNCTION", "refuse", found, "94 on some output", why, fix)
    motors = set(MOTORS[: MIXER_MOTORS.get(frame, 0)])
    if motors - functions:
        why = f"a mixer is chosen, and {REFUSES} while one of its motors has no output"
        yield row("FRAME_TYPE", "refuse", number(p.get("FRAME_TYPE")), "0", why, "set it to 0 and reboot")
    throttle = bool(functions & (SAILS | {THROTTLE}))
    if (THROTTLE_LEFT in functions) != (THROTTLE_RIGHT in functions) or throttle != (STEERING in functions):
        why = f"{REFUSES} with half a rover: steering (26) without throttle (70), left (73) without right (74)"
        alone = functions & (SAILS | {STEERING, THROTTLE, THROTTLE_LEFT, THROTTLE_RIGHT})
        fix = "set outputs with these functions to 0"
        yield row("SERVOn_FUNCTION", "refuse", " ".join(map(str, sorted(alone))), "none of them", why, fix)


def held_sticks(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Sticks that the companion holds at 1500 us and the autopilot takes for moved, as after a calibration."""
    if not p.whole("ARMING_CHECK", ALL) & (ALL | RC) or p.whole("ARMING_SKIPCHK") & RC:
        return
    options = p.whole("RC_OPTIONS", THROTTLE_CHECKED)
    wanted = [] if options & OTHERS_SKIPPED else [("ROLL", 1, 4500), ("YAW", 4, 100)]
    wanted += [("THROTTLE", 3, 100)] if options & THROTTLE_CHECKED else []
    for axis, default, steps in wanted:
        n = p.whole(f"RCMAP_{axis}", default)
        if n in companion.channels and _reads(p, n, steps):
            zone = p.whole(f"RC{n}_DZ")
            why = f"{REFUSES}: {axis.lower()} is held at {NEUTRAL_US} us, farther from it than RC{n}_DZ = {zone}"
            yield row(f"RC{n}_TRIM", "refuse", number(p.get(f"RC{n}_TRIM")), str(NEUTRAL_US), why, "set it to 1500")


def _reads(p: ParameterSet, n: int, steps: int) -> int:
    """What the autopilot makes of 1500 us on channel n, in whole steps of its travel; 0 where it is not told."""
    trim, zone = p.get(f"RC{n}_TRIM"), p.get(f"RC{n}_DZ")
    if trim is None or zone is None:
        return 0
    beyond = abs(NEUTRAL_US - trim) - zone
    travel = (
        p.whole(f"RC{n}_MAX", 1900) - trim - zone if trim < NEUTRAL_US else trim - zone - p.whole(f"RC{n}_MIN", 1100)
    )
    return int(steps * beyond / travel) if beyond > 0 and travel > 0 else 0


def arming_is_checked(p: ParameterSet) -> bool:
    """Whether the autopilot checks anything before it arms."""
    return p.get("ARMING_CHECK") != 0 and p.get("ARMING_SKIPCHK") != -1
