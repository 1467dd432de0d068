"""The water that a boat may use: fences less a margin, its middle, and where a moving boat can be stopped.

Stopping along a body axis of mass m, linear damping d and braking force F, after a reaction time t_r at speed w:

    s = w t_r + (m / d) (w - (F / d) ln(1 + w d / F))         F > 0
    s = w t_r + m w / d                                       F = 0
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from companion.core.configuration.site_file import Site
from companion.core.configuration.tables import ConfigError
from companion.core.geometry.fence import ANYWHERE, Fence, clearance

_CELLS = 60  # of the grid on which the middle is looked for
_TIE = 1e-3  # a metre nearer to the centroid counts as much as a millimetre of clearance
_STATIONS = 9  # places looked at on the way to where the boat can be stopped


@dataclass(frozen=True)
class Pen:
    """The fence of a site, and `others`: those of a mission."""

    site: Site
    others: Fence = ANYWHERE

    @cached_property
    def corners(self) -> np.ndarray:
        """Corners of the site's fence, shape (k, 2) [m]."""
        return np.array(self.site.fence, dtype=float)

    @cached_property
    def middle(self) -> np.ndarray:
        """The place farthest from all fences, shape (2,) [m]."""
        within = [self.corners, *map(np.array, self.others.within)]
        low, high = np.max([c.min(axis=0) for c in within], axis=0), np.min([c.max(axis=0) for c in within], axis=0)
        north, east = np.meshgrid(*np.linspace(low, high, _CELLS + 1).T)
        places = np.column_stack([north.ravel(), east.ravel()])
        off = np.linalg.norm(places - self.corners.mean(axis=0), axis=1)
        return places[np.argmax(self.clearance(places) - _TIE * off)]

    @cached_property
    def most_clearance_m(self) -> float:
        """Distance of the middle to the nearest fence [m]."""
        return float(self.clearance(self.middle[None])[0])

    def clearance(self, places: np.ndarray) -> np.ndarray:
        """Distance of places (m, 2) to the nearest fence, shape (m,) [m], negative beyond it (even-odd rule)."""
        return np.minimum(clearance(self.corners, places), self.others.clearances(places))

    def least_clearance(self, start: np.ndarray, end: np.ndarray) -> float:
        """Smallest clearance on the straight line between two places [m]."""
        return float(self.clearance(start + np.linspace(0.0, 1.0, _STATIONS)[:, None] * (end - start)).min())

    def way_back(self, place: np.ndarray) -> float:
        """Smallest clearance of `others` on the straight line from a place to the middle [m]; <= 0: one is between.

        The site's fence is nowhere between (`check`).
        """
        return self.others.least_clearance(tuple(place), tuple(self.middle))

    def check(self, margin_m: float, return_m: float, *, name: str) -> None:
        """Raise ConfigError where an excitation cannot be flown in here. `name`: of the excitation file."""
        room = self.most_clearance_m
        if room <= margin_m + return_m:
            where, it = f"in the fence of {self.site.name}", "it"
            if self.others != ANYWHERE:
                where, it = f"{where} and those of the mission", "all of them"
            raise ConfigError(
                f"{name}: margin_m + return_m: {margin_m + return_m:g} m, but {where} no place is more than "
                f"{max(room, 0.0):.1f} m from {it}"
            )
        away = self.corners - self.middle
        turn = away[:, 0] * np.roll(away, -1, axis=0)[:, 1] - away[:, 1] * np.roll(away, -1, axis=0)[:, 0]
        if turn.min() < 0 < turn.max():
            raise ConfigError(
                f"{name}: the fence of {self.site.name} hides some of its corners from its middle "
                f"({self.middle[0]:.1f}, {self.middle[1]:.1f}): the way back would cross it"
            )


def stopping_distance_m(speed: float, mass: float, damping: float, force: float, reaction_s: float) -> float:
    """Distance [m] until a body of `mass` [kg] at `speed` [m/s] rests; >= 0. `damping` > 0 [N s/m]."""
    w = abs(speed)
    if force <= 0:
        return w * reaction_s + mass * w / damping
    return w * reaction_s + mass / damping * (w - force / damping * math.log1p(w * damping / force))
