"""Rules of the RC channels that the companion overrides: what else they must not do."""

from __future__ import annotations

from collections.abc import Iterator

from companion.core.preflight.rows import Level, ParameterSet, Row, number
from companion.core.preflight.rules.making import row, row_of_several
from companion.core.preflight.wiring import Companion, Wiring


def channels(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Arming by the rudder, the mode channel, the pilot's axes, auxiliary functions."""
    thrusters = {channel for _, channel in companion.thrusters}
    rudder, roll = p.get("ARMING_RUDDER"), p.whole("RCMAP_ROLL", 1)
    level: Level = "ok" if rudder == 0 else "refuse" if roll in thrusters else "warning"
    why = f"else channel {roll} near its end with the throttle in neutral ARMS OR DISARMS after 2 s"
    yield row("ARMING_RUDDER", level, number(rudder), "0", why, "" if rudder == 0 else "set it to 0")
    channel = p.get("MODE_CH")
    taken = channel in companion.channels
    why = f"the mode follows this channel{', which the companion overrides' if taken else ''}"
    level = "refuse" if taken else "ok" if channel is not None else "warning"
    free = "a channel that nobody overrides"
    yield row("MODE_CH", level, number(channel), free, why, "set it to 8" if level != "ok" else "")
    for key in ("ROLL", "PITCH", "THROTTLE", "YAW"):
        name, mapped = f"RCMAP_{key}", p.get(f"RCMAP_{key}")
        if mapped in thrusters:
            why = f"channel {number(mapped)} is a thruster's and the pilot's {key.lower()} at once"
            yield row(
                name, "warning", number(mapped), "1 to 4", why, "set RCMAP_* to 1, 2, 3, 4; thrusters are on 9 to 16"
            )
    throttle = p.whole("RCMAP_THROTTLE", 3)
    if throttle not in companion.channels:
        why = f"channel {throttle} is the throttle and nobody holds it at 1500 us: without a receiver a radio failure"
        fix = f"add {throttle} to control.neutral_channels of the run file, or set RCMAP_THROTTLE to 3"
        yield row("RCMAP_THROTTLE", "warning", str(throttle), "a channel held in neutral", why, fix)
    options = {n: p.whole(f"RC{n}_OPTION") for n in sorted(companion.channels)}
    if bad := [n for n, option in options.items() if option]:
        why = "auxiliary functions on channels that the companion overrides: commands would throw switches (reference)"
        level = "refuse" if thrusters & set(bad) else "warning"
        yield row_of_several("RC", "OPTION", options, bad, level, "0", why, "set it to 0")
