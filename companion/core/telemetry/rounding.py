"""Numbers and texts as telemetry sends them: as fine as a person or a plot can use, and no longer."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from statistics import median

from companion.core.messages import Message
from companion.core.telemetry.status import Spread

TEXT_CHARS = 400
"""Longer texts are cut: a text is for a person (assumed)."""
STEP_DIGITS, ANGLE_DIGITS, COVARIANCE_DIGITS = 3, 4, 4
"""Decimals of metres, speeds and forces; of angles and rates; significant digits of covariances."""


def triangle(covariance: Sequence[float]) -> tuple[float, ...]:
    """Row-major 6 x 6 -> its upper triangle, row by row."""
    return tuple(float(f"{covariance[6 * i + j]:.{COVARIANCE_DIGITS}g}") for i in range(6) for j in range(i, 6))


def metres(value: float) -> float:
    """Metres, metres per second, newtons."""
    return round(value, STEP_DIGITS)


def angle(value: float) -> float:
    """Radians, radians per second."""
    return round(value, ANGLE_DIGITS)


def centimetres(value: float) -> float:
    """Poses of the horizon, which is a picture: metres and radians to two decimals."""
    return round(value, 2)


def cut(text: str) -> str:
    """A text no longer than TEXT_CHARS."""
    return text if len(text) <= TEXT_CHARS else text[: TEXT_CHARS - 3] + "..."


def spread(values_ms: Iterable[float]) -> Spread:
    """Median and largest of what is finite."""
    values = [value for value in values_ms if math.isfinite(value)]
    if not values:
        return Spread(median_ms=None, max_ms=None)
    return Spread(median_ms=round(median(values), 2), max_ms=round(max(values), 2))


def age_s(t_ns: int, messages: Iterable[Message | None]) -> float | None:
    """Seconds since the newest of them; None: there is none."""
    newest = max((m.t_ns for m in messages if m), default=None)
    return None if newest is None else round(max(t_ns - newest, 0) * 1e-9, 2)
