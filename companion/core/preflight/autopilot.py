"""Rows of the autopilot's parameters: every one that decides whether the boat stops. Pure.

    names = parameter_names(companion)              # to ask the autopilot for
    rows = parameter_rows(ParameterSet(values), companion)

`refuse` where a thruster would keep its pulse, or start by itself, or not follow commands at all. Sources:
docs/autopilot.md (observed on ArduPilot Rover 4.6 and 4.7); what was only read in ArduPilot's parameter
reference says "(reference)".
"""

from __future__ import annotations

from companion.core.preflight.rows import RENAMED, ParameterSet, Row
from companion.core.preflight.rules import arming, channels, failsafes, outputs, readiness
from companion.core.preflight.rules.making import Rule, row
from companion.core.preflight.rules.readiness import VISION
from companion.core.preflight.wiring import MORE_OUTPUTS, OUTPUTS, Companion, wiring

RULES: tuple[Rule, ...] = (
    outputs.untold_outputs,
    outputs.thruster_outputs,
    outputs.trims,
    outputs.scaled_outputs,
    outputs.script_outputs,
    outputs.omni_mixer,
    arming.arming_outputs,
    arming.held_sticks,
    failsafes.failsafes,
    failsafes.overrides,
    channels.channels,
    readiness.arming_and_rates,
    readiness.vision_source,
)
"""In the order of their rows."""

_SINGLE = (
    "SYSID_MYGCS", "RC_OVERRIDE_TIME", "RC_OPTIONS", "FS_THR_ENABLE", "FS_THR_VALUE", "FS_ACTION", "FS_TIMEOUT",
    "FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "SERVO_RC_FS_MSK", "SCR_ENABLE", "ARMING_RUDDER", "ARMING_REQUIRE",
    "ARMING_CHECK", "ARMING_SKIPCHK",
    "BRD_SAFETY_DEFLT", "MODE_CH", "RCMAP_ROLL", "RCMAP_PITCH", "RCMAP_THROTTLE",
    "RCMAP_YAW",
    "FRAME_CLASS", "FRAME_TYPE", "MOT_SLEWRATE", "SCHED_LOOP_RATE", "SERVO_32_ENABLE", "SERVO_AUTO_TRIM",
    "MAV_OPTIONS", "SYSID_ENFORCE", "MAV_GCS_SYSID_HI",
)  # fmt: skip
_SERVO, _RC = ("FUNCTION", "MIN", "TRIM", "MAX", "REVERSED"), ("MIN", "TRIM", "MAX", "DZ", "REVERSED", "OPTION")


def parameter_names(companion: Companion) -> tuple[str, ...]:
    """Names to ask an autopilot for, in either spelling; it is silent on those that it does not have."""
    servos = [f"SERVO{n}_{key}" for n in range(1, OUTPUTS + 1) for key in _SERVO]
    rc = [f"RC{n}_{key}" for n in sorted(companion.channels) for key in _RC]
    return (*_SINGLE, *RENAMED.values(), *servos, *rc, *(VISION if companion.vision else ()))


def further_parameter_names(p: ParameterSet) -> tuple[str, ...]:
    """Names to ask for once those of `parameter_names` are known: outputs 17 to 32, where they are in use."""
    if not p.whole("SERVO_32_ENABLE"):
        return ()
    return tuple(f"SERVO{n}_{key}" for n in range(OUTPUTS + 1, MORE_OUTPUTS + 1) for key in _SERVO)


def parameter_rows(p: ParameterSet, companion: Companion) -> list[Row]:
    """All rows; a single one, which refuses, where the autopilot has not answered."""
    if p.get("SERVO1_FUNCTION") is None:
        why = "without its parameters nobody can say whether the boat stops when the companion dies"
        fix = "check the link; signed MAVLink drops our questions: use the autopilot's USB port, or remove the key"
        return [row("parameters", "refuse", "none told", "the autopilot's answer", why, fix)]
    w = wiring(p, companion)
    return [judged for rule in RULES for judged in rule(p, w, companion)]
