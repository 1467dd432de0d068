"""Heading and yaw rate as they are read one after the other: which repeats itself, and how much the rate scatters."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

FROZEN = 10
"""So many readings in a row that are the same to the last digit are suspicious, if the other sensor turns; assumed."""
HANGS, LIVELY, TWICE = 25, 250, 2
"""So many, half a second, are not measured any more, whether it turns or not, of a sensor that changed with each of the
last `LIVELY` readings, but for `TWICE` the same at most: one that says whole degrees or mrad/s repeats itself as a
matter of course. Assumed."""
TURNS_RAD_S2, SCATTER_RAD_S, SCATTER_S, SPIKE_RAD_S = 2.0, 0.03, 1.0, 0.3
"""No boat of this size accelerates its turn by more than the first. What yaw rates change beyond that from one to the
next, averaged over `SCATTER_S`, is noise: of a good gyro nothing is left, 0.03 are left of 0.06 rad/s. A single spike
counts for `SPIKE_RAD_S` at most. Assumed."""


@dataclass(frozen=True)
class Repetition:
    """The last reading, how often it has been repeated, and how many before it were lively."""

    value: float = math.nan
    repeats: int = 0
    lively: int = 0

    def take(self, value: float) -> Repetition:
        """With one reading more."""
        if value == self.value:
            return replace(self, repeats=self.repeats + 1)
        return Repetition(value, 0, self.lively + 1 if self.repeats < TWICE else 0)

    @property
    def is_frozen(self) -> bool:
        """Whether it does not seem to be measured any more."""
        return self.repeats >= FROZEN

    @property
    def hangs(self) -> bool:
        """Whether it surely is not."""
        return self.repeats >= HANGS and self.lively >= LIVELY


@dataclass(frozen=True)
class TurnReadings:
    """Heading and yaw rate as they are read, and how much the rate scatters [rad/s]."""

    psi_rad: Repetition = Repetition()
    r_rad_s: Repetition = Repetition()
    scatter_rad_s: float = 0.0

    def take(self, psi_rad: float, r_rad_s: float, dt_s: float) -> TurnReadings:
        """With one more of each, `dt_s` after the last."""
        change = abs(r_rad_s - self.r_rad_s.value)
        beyond = min(max(0.0, change - TURNS_RAD_S2 * dt_s), SPIKE_RAD_S) if math.isfinite(change) else 0.0
        scatter = self.scatter_rad_s + min(1.0, dt_s / SCATTER_S) * (beyond - self.scatter_rad_s)
        return TurnReadings(self.psi_rad.take(psi_rad), self.r_rad_s.take(r_rad_s), scatter)

    @property
    def frozen(self) -> str:
        """Which of the two, alone, repeats itself; empty: none."""
        if self.psi_rad.is_frozen == self.r_rad_s.is_frozen:
            return ""
        return "heading" if self.psi_rad.is_frozen else "gyro"

    @property
    def hangs(self) -> bool:
        """Whether the one that is frozen hangs."""
        return bool(self.frozen) and (self.psi_rad.hangs or self.r_rad_s.hangs)


UNREAD = TurnReadings()
