"""Heading and yaw rate as they are read one after the other: which repeats itself, and how much the rate scatters."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from msgspec.structs import replace

FROZEN = 10
"""So many readings in a row that are the same to the last digit are suspicious, if the other sensor turns; assumed."""
HANGS_S, LIVELY, TWICE = 0.5, 100, 2
"""So many for so long are not measured any more, whether it turns or not, of a sensor that was lively before: of
`LIVELY` readings none came more than `TWICE` again, and the last ones are not rounded. Assumed."""
RECENT, FINEST, PART, ROUNDED = 20, 1e-5, 0.1, 0.3
"""So many readings tell whether a sensor rounds, to no finer step [rad, rad/s] than this: of their changes less than a
share `ROUNDED` are no multiples of the step, within a `PART` of it. Assumed."""
TURNS_RAD_S2, SCATTER_RAD_S, SCATTER_S, SPIKE_RAD_S = 2.0, 0.03, 1.0, 0.3
"""No boat of this size accelerates its turn by more than the first. What yaw rates change beyond that from one to the
next, averaged over `SCATTER_S`, is noise: of a good gyro nothing is left, 0.03 are left of 0.06 rad/s. A single spike
counts for `SPIKE_RAD_S` at most. Assumed."""


class Repetition(msgspec.Struct, frozen=True):
    """The last reading, how often and for how long it has been repeated; how many before it were lively, and the last
    of them.
    """

    value: float = math.nan
    repeats: int = 0
    same_s: float = 0.0
    lively: int = 0
    recent: tuple[float, ...] = ()

    def take(self, value: float, dt_s: float) -> Repetition:
        """With one reading more, `dt_s` after the last."""
        if value == self.value:
            return replace(self, repeats=self.repeats + 1, same_s=self.same_s + dt_s)
        lively = self.lively + 1 if self.repeats <= TWICE else 0
        return Repetition(value, lively=lively, recent=(*self.recent, value)[-RECENT:])

    @property
    def is_frozen(self) -> bool:
        """Whether it does not seem to be measured any more."""
        return self.repeats >= FROZEN

    @property
    def hangs(self) -> bool:
        """Whether it surely is not."""
        return self.is_frozen and self.same_s >= HANGS_S and self.lively >= LIVELY and not _are_rounded(self.recent)


def _are_rounded(readings: tuple[float, ...]) -> bool:
    """Whether readings change by multiples of one step: the least change, or difference between two changes."""
    changes = np.abs(np.diff(readings))
    steps = np.append(changes, np.diff(np.sort(changes)))
    step = max(FINEST, float(steps[steps > FINEST].min(initial=math.inf)))
    off = np.abs(changes / step - np.round(changes / step))
    return bool((off > PART).mean() < ROUNDED)


class TurnReadings(msgspec.Struct, frozen=True):
    """Heading and yaw rate as they are read, and how much the rate scatters [rad/s]."""

    psi_rad: Repetition = Repetition()
    r_rad_s: Repetition = Repetition()
    scatter_rad_s: float = 0.0

    def take(self, psi_rad: float, r_rad_s: float, dt_s: float) -> TurnReadings:
        """With one more of each, `dt_s` after the last."""
        change = abs(r_rad_s - self.r_rad_s.value)
        beyond = min(max(0.0, change - TURNS_RAD_S2 * dt_s), SPIKE_RAD_S) if math.isfinite(change) else 0.0
        scatter = self.scatter_rad_s + min(1.0, dt_s / SCATTER_S) * (beyond - self.scatter_rad_s)
        return TurnReadings(self.psi_rad.take(psi_rad, dt_s), self.r_rad_s.take(r_rad_s, dt_s), scatter)

    @property
    def frozen(self) -> str:
        """Which of the two, alone, repeats itself; empty: none."""
        if self.psi_rad.is_frozen == self.r_rad_s.is_frozen:
            return ""
        return "heading" if self.psi_rad.is_frozen else "gyro"

    @property
    def hung_s(self) -> float:
        """How long the one that is frozen hangs; 0: it does not."""
        hanging = [one.same_s for one in (self.psi_rad, self.r_rad_s) if one.hangs]
        return hanging[0] if self.frozen and hanging else 0.0


UNREAD = TurnReadings()
