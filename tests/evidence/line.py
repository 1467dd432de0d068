"""One line of evidence: what, the figure, the goal, and whether it holds."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    what: str
    figure: float
    low: float
    high: float
    unit: str = ""
    note: str = ""

    @property
    def judged(self) -> bool:
        return math.isfinite(self.low) or math.isfinite(self.high)

    @property
    def holds(self) -> bool:
        return not self.judged or (math.isfinite(self.figure) and self.low <= self.figure <= self.high)

    def __str__(self) -> str:
        if not self.judged:
            goal = "none"
        elif self.low == self.high:
            goal = f"= {self.low:g}"
        elif math.isinf(self.low):
            goal = f"<= {self.high:g}"
        elif math.isinf(self.high):
            goal = f">= {self.low:g}"
        else:
            goal = f"{self.low:.3g} to {self.high:.3g}"
        verdict = "information" if not self.judged else "holds" if self.holds else "FALLS SHORT"
        note = f"   ({self.note})" if self.note else ""
        return f"  {self.what:<58} {self.figure:>9.4g} {self.unit:<5} goal {goal:<14} {verdict}{note}"


def at_most(what: str, figure: float, goal: float, unit: str = "", note: str = "") -> Line:
    return Line(what, float(figure), -math.inf, goal, unit, note)


def at_least(what: str, figure: float, goal: float, unit: str = "", note: str = "") -> Line:
    return Line(what, float(figure), goal, math.inf, unit, note)


def exactly(what: str, figure: float, goal: float, unit: str = "", note: str = "") -> Line:
    return Line(what, float(figure), goal, goal, unit, note)


def between(what: str, figure: float, low: float, high: float, unit: str = "", note: str = "") -> Line:
    return Line(what, float(figure), low, high, unit, note)


def information(what: str, figure: float, unit: str = "", note: str = "") -> Line:
    """A figure that has no goal: always holds."""
    return Line(what, float(figure), -math.inf, math.inf, unit, note)
