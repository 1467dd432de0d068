"""The fence: where the boat may be. One polygon of the site, and those of the mission to stay in or out of.

`clearance` is the distance to the nearest edge, negative where the boat may not be: what the mode table judges.
`levels` says the same by half-planes for the NMPC, whatever the polygon's shape:

    l(p) = min( b_i - a_i . p   of the convex hull's edges,   -l_pocket(p)   of each part cut out of the hull )

with |a_i| = 1: zero exactly on the fence, positive inside, slope 1 everywhere, never more than `clearance` there. A
convex fence gives its half-planes, each a level of its own. Polygons must not cross themselves (`crossing`).

Beyond a tip of angle t that points into the water (of a polygon to stay out of, of a part cut out) edges say D sin(t/2)
where the clearance is D: 4 m off a jetty of 14 degrees 0.5 m. A sharp tip is an edge of no length too, across its axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

Corners = tuple[tuple[float, float], ...]
Level = Callable[[Any, Any], Any]
"""(north, east) -> metres inside, for numbers and CasADi expressions alike."""
Minimum = Callable[[Any, Any], Any]
SHARP = 0.51
"""Cosine of the angle (59 degrees) below which a tip is sharp; assumed: wider ones leave half of the clearance."""
FARTHEST_CORNER_M = 10_000
"""North or east of the site's origin; farther off a plane is no map any more."""
MOST_CORNERS = 300
"""Of a site's fence, and of all fences of a mission. With 500 in all the controller is built in 7 s and a plan takes
0.3 ms, with four in 4 s and 0.2 ms; with 1000 in 47 s (measured on 2 cores)."""
ONCE = "give each corner once, in order along the fence"
"""Where edges touch: KML and GeoJSON repeat the first corner at the end."""


@dataclass(frozen=True)
class Fence:
    """Polygons of (north, east) [m]: inside all of `within`, outside all of `without`."""

    within: tuple[Corners, ...]
    without: tuple[Corners, ...] = ()

    @cached_property
    def _signed(self) -> tuple[tuple[float, np.ndarray], ...]:
        both = ((1.0, self.within), (-1.0, self.without))
        return tuple((sign, np.array(corners)) for sign, polygons in both for corners in polygons)

    def clearance(self, north_m: float, east_m: float) -> float:
        """Distance [m] to the nearest fence, negative beyond it."""
        return float(self.clearances(np.array([[north_m, east_m]]))[0])

    def clearances(self, places: np.ndarray) -> np.ndarray:
        """Clearance of places (m, 2), shape (m,) [m]; without any polygon inf."""
        far = np.full(len(places), np.inf)
        return np.min([far, *(sign * clearance(corners, places) for sign, corners in self._signed)], axis=0)

    def least_clearance(self, start: tuple[float, float], end: tuple[float, float]) -> float:
        """Smallest clearance on the straight line between two different places [m]; <= 0 where it touches a fence."""
        line = np.array([start, end])
        ends = float(self.clearances(line).min())
        if self.is_crossed(start, end):
            return min(ends, 0.0)
        return min([ends, *(float(abs(clearance(line, corners)).min()) for _sign, corners in self._signed)])

    def is_crossed(self, start: tuple[float, float], end: tuple[float, float]) -> bool:
        """Whether the straight line between two places (north, east) [m] touches a fence."""
        a, b = np.array(start), np.array(end)
        return any(_touch(a, b, corners, np.roll(corners, -1, axis=0)).any() for _sign, corners in self._signed)

    def levels(self, minimum: Minimum) -> tuple[Level, ...]:
        """Levels of all polygons. `minimum(a, b)`: of two values, `min` or `casadi.fmin`."""
        found: list[Level] = []
        for corners in self.within:
            found += _levels(np.array(corners), range(0), minimum)
        for corners in self.without:
            found.append(_negative(_least(_levels(np.array(corners), range(len(corners)), minimum), minimum)))
        return tuple(found)


ANYWHERE = Fence(())
"""No polygon."""


def clearance(corners: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Distance of places (m, 2) to a polygon (k, 2), shape (m,) [m], negative outside (even-odd rule)."""
    start, end = corners, np.roll(corners, -1, axis=0)
    edge, away = end - start, places[:, None] - start
    along = np.clip((away * edge).sum(axis=2) / (edge**2).sum(axis=1), 0.0, 1.0)
    nearest = np.sqrt(((along[..., None] * edge - away) ** 2).sum(axis=2)).min(axis=1)
    north, east = places[:, 0, None], places[:, 1, None]
    spans = (start[:, 0] > north) != (end[:, 0] > north)
    rise = np.where(edge[:, 0] == 0, 1.0, edge[:, 0])
    crossed = start[:, 1] + away[..., 0] / rise * edge[:, 1]
    inside = (spans & (east < crossed)).sum(axis=1) % 2 == 1
    return np.where(inside, nearest, -nearest)


def crossing(corners: Corners) -> tuple[int, int] | None:
    """Two edges (numbers of their first corners) of a polygon that touch without being neighbours, or None.

    An edge without length counts as touching its neighbour. Every edge is compared with all after it at once.
    """
    start = np.array(corners, dtype=float)
    end = np.roll(start, -1, axis=0)
    k = len(start)
    for i in range(k):
        if np.array_equal(start[i], end[i]):
            return i, (i + 1) % k
        others = slice(i + 2, k - (i == 0))
        touching = np.flatnonzero(_touch(start[i], end[i], start[others], end[others]))
        if len(touching):
            return i, i + 2 + int(touching[0])
    return None


def enclosed_m2(corners: Corners) -> float:
    """Area of a polygon that does not cross itself [m^2]."""
    return abs(_area(np.array(corners, dtype=float))) / 2


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Any:
    """Twice the area of triangles of points (..., 2), positive where a, b, c turn from north to east."""
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])


def _area(corners: np.ndarray) -> float:
    """Twice the area of a polygon, positive where it turns from north to east."""
    return float(_turn(corners[0], corners[1:-1], corners[2:]).sum())


def _touch(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Whether the segment ab and the segments cd (m, 2) have a point in common, shape (m,)."""
    low, high = np.maximum(np.minimum(a, b), np.minimum(c, d)), np.minimum(np.maximum(a, b), np.maximum(c, d))
    boxes = np.all(low <= high, axis=-1)
    return boxes & (_turn(a, b, c) * _turn(a, b, d) <= 0) & (_turn(c, d, a) * _turn(c, d, b) <= 0)


def _levels(corners: np.ndarray, tips: range, minimum: Minimum) -> list[Level]:
    """Half-planes of the hull and, negative, the pockets in it. `tips`: corners that point into the water, if sharp."""
    if _area(corners) < 0:
        corners = corners[::-1]
    hull = _hull(corners)
    found: list[Level] = []
    for i, j in zip(hull, [*hull[1:], hull[0] + len(corners)], strict=True):
        start, end = corners[i], corners[j % len(corners)]
        found.append(_half_plane(start, end))
        if i in tips:
            found += _across_tip(corners[hull[hull.index(i) - 1]], start, end)
        if j - i > 1:
            pocket = corners[np.arange(i, j + 1) % len(corners)]
            if _area(pocket) != 0:
                own = range(0) if tips else range(1, len(pocket) - 1)  # the first and the last are on the hull
                found.append(_negative(_least(_levels(pocket, own, minimum), minimum)))
    return found


def _hull(corners: np.ndarray) -> list[int]:
    """Numbers of the corners on the convex hull of a polygon, in its order (turning from north to east)."""
    order = sorted(range(len(corners)), key=lambda i: (corners[i][0], corners[i][1]))
    found: set[int] = set()
    for way in (order, order[::-1]):
        chain: list[int] = []
        for i in way:
            while len(chain) > 1 and _turn(corners[chain[-2]], corners[chain[-1]], corners[i]) <= 0:
                chain.pop()
            chain.append(i)
        found.update(chain)
    return sorted(found)


def _half_plane(start: np.ndarray, end: np.ndarray) -> Level:
    """Metres to the inner side of the line from `start` to `end`."""
    along = (end - start) / np.linalg.norm(end - start)
    a, b = float(-along[1]), float(along[0])
    offset = a * float(start[0]) + b * float(start[1])
    return lambda north, east: a * north + b * east - offset


def _across_tip(before: np.ndarray, tip: np.ndarray, after: np.ndarray) -> list[Level]:
    """Metres to the inner side of the line through a corner across its bisector; none where it is not sharp."""
    a, b = ((to - tip) / np.linalg.norm(to - tip) for to in (before, after))
    return [_half_plane(tip, tip + (a + b)[::-1] * (1.0, -1.0))] if a @ b > SHARP else []


def _least(levels: Sequence[Level], minimum: Minimum) -> Level:
    def least(north: Any, east: Any) -> Any:
        value = levels[0](north, east)
        for level in levels[1:]:
            value = minimum(value, level(north, east))
        return value

    return least


def _negative(level: Level) -> Level:
    return lambda north, east: -level(north, east)
