"""Hands at the sticks: six ways to drive for a while, mixed within a log, turning back before the walls.

Wanted body forces [N, N, N m] ten times a second; the commander turns them into pulse widths by the base's numbers.
"""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin

import numpy as np

from tests.hidden.plant.thrusters import Commander
from tests.hidden.plant.world import MIDDLE_M, World

STYLES = ("held", "circles", "spins", "strafes", "zigzag", "multisine")
PILOTS = {
    "mixed": (3, 1, 1, 1, 1, 1),
    "keyboard": (8, 0, 1, 1, 0, 0),
    "trials": (2, 3, 1, 1, 3, 0),
    "survey": (2, 1, 1, 3, 1, 0),
    "engineer": (2, 1, 1, 1, 1, 4),
}
"""Weights of the styles by pilot."""
MARGIN_M = 4.5
HOME_N = 22.0
MOST = (24.0, 34.0, 9.0)  # N, N, N m


class Hand:
    """One pilot for one log."""

    def __init__(self, base: World, kind: str, rng: np.random.Generator):
        self.commander, self.rng = Commander(base), rng
        weights = np.array(PILOTS[kind], dtype=float)
        self.weights = weights / weights.sum()
        self.segment_end = self.hold_end = 0.0
        self.style, self.tau, self.side = "held", (0.0, 0.0, 0.0), 1.0
        self.homing = False
        self.sines = self._sines()
        self.last: list[float] | None = None

    def pwm(self, t: float, s: tuple) -> list[float] | None:
        """A new command, or None where it stays."""
        if t >= self.segment_end:
            self.style = str(self.rng.choice(STYLES, p=self.weights))
            self.segment_end, self.hold_end = t + self.rng.uniform(15, 35), t
            self.sines, self.side = self._sines(), float(self.rng.choice([-1.0, 1.0]))
        tau = getattr(self, f"_{self.style}")(t, s)
        pwm = self.commander(self._kept_in(tau, s))
        if pwm == self.last:
            return None
        self.last = pwm
        return pwm

    def _kept_in(self, tau: tuple, s: tuple) -> tuple[float, float, float]:
        north, east = s[0] - MIDDLE_M, s[1] - MIDDLE_M
        reach, inner = max(abs(north), abs(east)), MIDDLE_M - MARGIN_M
        self.homing = reach > inner or (self.homing and reach > 0.6 * inner)
        if not self.homing:
            return tau
        away, c, sn = hypot(north, east), cos(s[2]), sin(s[2])
        fn, fe = -north / away * HOME_N, -east / away * HOME_N
        return c * fn + sn * fe, c * fe - sn * fn, tau[2]

    def _size(self, i: int) -> float:
        return float(self.rng.uniform(0.33, 1.0) * MOST[i])

    def _held(self, t: float, s: tuple) -> tuple:
        """Random forces held for 1 to 6 s, now and then none."""
        if t >= self.hold_end:
            use = self.rng.uniform(size=3) < (0.7, 0.45, 0.6)
            sign = self.rng.choice([-1.0, 1.0], 3)
            self.tau = tuple(float(use[i] * sign[i]) * self._size(i) for i in range(3))
            self.hold_end = t + self.rng.uniform(1, 6)
        return self.tau

    def _circles(self, t: float, s: tuple) -> tuple:
        """Ahead or astern with constant yaw, the other way round after 8 to 14 s."""
        if t >= self.hold_end:
            self.side = -self.side
            ahead = self._size(0) * (1.0 if self.rng.uniform() < 0.75 else -1.0)
            self.tau, self.hold_end = (ahead, 0.0, self.side * self._size(2) * 0.7), t + self.rng.uniform(8, 14)
        return self.tau

    def _spins(self, t: float, s: tuple) -> tuple:
        """Yaw on the spot for 3 to 7 s, then nothing for 2 s, then the other way."""
        if t >= self.hold_end:
            self.side = -self.side
            self.tau, self.hold_end = (0.0, 0.0, self.side * self._size(2)), t + self.rng.uniform(5, 9)
        return self.tau if self.hold_end - t > 2.0 else (0.0, 0.0, 0.0)

    def _strafes(self, t: float, s: tuple) -> tuple:
        """Sideways and back."""
        if t >= self.hold_end:
            self.side = -self.side
            self.tau, self.hold_end = (0.0, self.side * self._size(1), 0.0), t + self.rng.uniform(3, 7)
        return self.tau

    def _zigzag(self, t: float, s: tuple) -> tuple:
        """Ahead; yaw flips when the heading has gone 25 degrees beyond where the segment began."""
        if t >= self.hold_end:
            self.tau, self.hold_end = (self._size(0), 0.0, s[2]), self.segment_end
        off = atan2(sin(s[2] - self.tau[2]), cos(s[2] - self.tau[2]))
        if off * self.side > 25 * pi / 180:
            self.side = -self.side
        return self.tau[0], 0.0, self.side * 0.5 * MOST[2]

    def _multisine(self, t: float, s: tuple) -> tuple:
        """Three sines of 0.05 to 0.4 Hz on each axis."""
        return tuple(float(a * np.sin(w * t + p).sum()) for a, w, p in self.sines)

    def _sines(self) -> list[tuple]:
        return [(0.35 * m, 2 * np.pi * self.rng.uniform(0.05, 0.4, 3), self.rng.uniform(0, 2 * np.pi, 3)) for m in MOST]
