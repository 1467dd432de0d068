"""What the firmware makes of a channel's pulse width: RCn_MIN, TRIM, MAX, DZ and REVERSED.

A pulse width of 0 (nothing ever received there) is below every minimum and so the full negative travel.
"""

from __future__ import annotations

from sim.world.autopilot.parameters import ParameterStore


def share(p: ParameterStore, number: int, value_us: int) -> float:
    """Channel `number` as a share of its travel, -1 to 1, zero within the dead zone around trim."""
    low, trim, high, zone = (p[f"RC{number}_{key}"] for key in ("MIN", "TRIM", "MAX", "DZ"))
    part = 0.0
    if value_us < trim - zone and trim - zone > low:
        part = max(-1.0, (value_us - (trim - zone)) / (trim - zone - low))
    elif value_us > trim + zone and high > trim + zone:
        part = min(1.0, (value_us - (trim + zone)) / (high - trim - zone))
    return -part if p[f"RC{number}_REVERSED"] else part


def in_trim(p: ParameterStore, number: int, value_us: int) -> bool:
    """Whether channel `number` lies within its dead zone."""
    return abs(value_us - p[f"RC{number}_TRIM"]) <= p[f"RC{number}_DZ"]


def pulse_us(p: ParameterStore, output: int, part: float) -> int:
    """Pulse width of an output for a share of its travel, -1 to 1, through SERVOn_MIN, TRIM, MAX, REVERSED."""
    low, trim, high = (p[f"SERVO{output}_{key}"] for key in ("MIN", "TRIM", "MAX"))
    part = -part if p[f"SERVO{output}_REVERSED"] else part
    return round(trim + part * (high - trim if part > 0 else trim - low))
