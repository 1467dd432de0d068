"""What a watch said of one boat, beside what really came over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.commission.watch.course import BoatCourse, ToldChange
from tests.evidence.commission.fouled_boats import UNCHANGED, Fouling

NEAR = 0.20


@dataclass(frozen=True)
class Story:
    """One boat's missions, and what came over it from the tenth on; None: nothing."""

    seed: int
    number: int
    cause: Fouling | None
    course: BoatCourse

    @property
    def told(self) -> tuple[ToldChange, ...]:
        """Changes told since the fouling."""
        return tuple(c for c in self.course.changes if c.told >= UNCHANGED)

    @property
    def false_alarms(self) -> int:
        """Changes told while nothing had changed."""
        return sum(c.told < UNCHANGED for c in self.course.changes)

    @property
    def wrong(self) -> int:
        """Changes told since the fouling by another name than its own."""
        return sum(_what(c) != self.cause.what for c in self.told) if self.cause else 0

    @property
    def rightly(self) -> bool:
        """Whether the fouling was told by its name."""
        return self.cause is not None and any(_what(c) == self.cause.what for c in self.told)

    @property
    def size_error(self) -> float:
        """Of all that was told by the fouling's name over its true size in the end, less 1; NaN: it was not told."""
        if self.cause is None or not self.rightly:
            return float("nan")
        mine = [c.size for c in self.told if _what(c) == self.cause.what]
        return abs(float(np.prod(1 + np.array(mine))) - 1) / self.cause.size - 1

    @property
    def near(self) -> bool:
        """Whether the size told is within 20 %."""
        return abs(self.size_error) <= NEAR

    def __str__(self) -> str:
        words = "; ".join(_words(c) for c in self.told) or "not told"
        return f"boat {self.seed}.{self.number}: {self.cause}: {words}"


def _what(change: ToldChange) -> str:
    return "drag" if change.cause.kind in ("drag", "surge drag") else change.cause.name.partition(":")[2]


def _words(change: ToldChange) -> str:
    low, high = change.ci95
    name = f"{change.cause.name} {100 * change.size:+.0f} % ({100 * low:+.0f} to {100 * high:+.0f})"
    return f"told in mission {change.told + 1}: {name}, since mission {change.onset + 1}, {change.nats:.0f} nats"
