"""From a raw stick to a share of the thrusters' force, and the rule that a stick must rest before it counts. Pure.

    s = sign(v) max(0, (|v| - z) / (1 - z))          share = (1 - e) s + e s^3        v, share in [-1, 1]

with dead zone z (a stick let go of does not return to exactly 0) and expo e (fine near the middle, full at the end).
Share and raw value have the same sign, 0 maps to 0 and +-1 to +-1, and more stick is never less force.
"""

from __future__ import annotations

import math
from typing import NamedTuple

AT_REST = 0.05
"""Shares below this are a stick that nobody holds (as companion.core.pilot.manual_control has it); assumed."""


class Shares(NamedTuple):
    """Shares of what the thrusters can give ahead, to starboard and clockwise, -1 to 1 each."""

    surge: float = 0.0
    sway: float = 0.0
    yaw: float = 0.0

    @property
    def at_rest(self) -> bool:
        """Whether this is what a stick gives that nobody holds."""
        return max(map(abs, self)) < AT_REST


NEUTRAL = Shares()


def shaped(value: float, *, dead_zone: float, expo: float) -> float:
    """Share for a raw value; 0 for what is not finite. `dead_zone` in [0, 1), `expo` in [0, 1]; else ValueError."""
    if not 0.0 <= dead_zone < 1.0 or not 0.0 <= expo <= 1.0:
        raise ValueError(f"dead zone {dead_zone!r} is not in [0, 1) or expo {expo!r} not in [0, 1]")
    if not math.isfinite(value):
        return 0.0
    size = min(max(0.0, (abs(value) - dead_zone) / (1.0 - dead_zone)), 1.0)
    return math.copysign((1.0 - expo) * size + expo * size**3, value)


class RestFirst:
    """Lets nothing through until the stick has been at rest; again after each `lock` (reconnected, frozen)."""

    def __init__(self) -> None:
        self.locked = True

    def lock(self) -> None:
        """Ask for rest before anything else."""
        self.locked = True

    def pass_on(self, shares: Shares) -> Shares:
        """The shares, or neutral while locked."""
        if shares.at_rest:
            self.locked = False
        return NEUTRAL if self.locked else shares
