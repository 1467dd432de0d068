"""How a cost grows: exponents of value ~ size^exponent, and where the exponent changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.bench.result import Growth, GrowthPoint

BEND = 0.3
"""Change of the exponent that counts as a bend."""
BETTER = 0.25
"""A bend is told where two straight lines leave at most this share of the squared residual of one."""


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Slope of the straight line through log value over log size, by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def bend(sizes: Sequence[float], values: Sequence[float]) -> float | None:
    """The size at which two power laws meet that describe the points better than one; None where one does.

    Each has at least three points, the one in the middle belongs to both.
    """
    x, y = np.log(sizes), np.log(values)
    best, at = BETTER * _rest(x, y), None
    for k in range(2, len(x) - 2):
        before, after = slice(None, k + 1), slice(k, None)
        rest = _rest(x[before], y[before]) + _rest(x[after], y[after])
        turn = np.polyfit(x[after], y[after], 1)[0] - np.polyfit(x[before], y[before], 1)[0]
        if rest < best and abs(turn) > BEND:
            best, at = rest, float(sizes[k])
    return at


def _rest(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.sum((y - np.polyval(np.polyfit(x, y, 1), x)) ** 2))


def grown(what: str, by: str, unit: str, sizes: Sequence[float], values: Sequence[float], note: str = "") -> Growth:
    """The record of one curve; exponents of the first and the last pair of points tell how it bends."""
    return Growth(
        what=what, by=by, unit=unit,
        points=tuple(GrowthPoint(size=float(s), value=float(v)) for s, v in zip(sizes, values, strict=True)),
        exponent=exponent(sizes, values),
        first_exponent=exponent(sizes[:2], values[:2]),
        last_exponent=exponent(sizes[-2:], values[-2:]),
        bends_at=bend(sizes, values),
        note=note,
    )  # fmt: skip
