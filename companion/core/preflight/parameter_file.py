"""ArduPilot parameter files: `NAME,VALUE` a line, as Mission Planner, MAVProxy and the firmware read them.

    # a comment
    SERVO1_FUNCTION,94

The number may also follow a space, a tab or `=`. A parameter that was renamed may stand under both names, with one
value, so that every version takes its own: it is read as one, by the name of 4.6. An error names file and line.
"""

from __future__ import annotations

import math
import re

from companion.core.configuration.tables import ConfigError
from companion.core.preflight.rows import OLD_NAME

_LINE = re.compile(r"([A-Z][A-Z0-9_]{0,15})[ \t]*[,= \t][ \t]*(\S+)")


def parse_parameters(text: str, *, name: str) -> dict[str, float]:
    """Values by parameter name, in the file's order. Raises ConfigError for the first line that is wrong."""
    values: dict[str, float] = {}
    seen: set[str] = set()
    for number, line in enumerate(text.splitlines(), start=1):
        stripped = line.partition("#")[0].strip()
        if not stripped:
            continue
        place = f"{name}: line {number}"
        match = _LINE.fullmatch(stripped)
        if not match:
            raise ConfigError(f"{place}: expected NAME,VALUE (a name has at most 16 capitals, digits and _)")
        key, value = match[1], _number(match[2])
        if value is None:
            raise ConfigError(f"{place}: {key}: {match[2]!r} is not a finite number")
        if key in seen:
            raise ConfigError(f"{place}: {key} is there twice")
        seen.add(key)
        old = OLD_NAME.get(key, key)
        if values.get(old, value) != value:
            raise ConfigError(f"{place}: {key} is another name of {old}, which has another value")
        values[old] = value
    if not values:
        raise ConfigError(f"{name}: no parameters in it")
    return values


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
