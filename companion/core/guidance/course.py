"""The course: the path with rounded corners, and how fast it may be driven.

A corner of turn angle theta becomes an arc that leaves the leg a distance d before the waypoint:

    R = d / tan(|theta| / 2)       cut = d tan(|theta| / 4)     radius; distance of arc and corner
    d = min(reach, cut_max / tan(|theta| / 4), 0.45 of either leg)       at least R_min tan(|theta| / 2) if that fits
    v_corner = min(sqrt(a_lat R), r_max R)
    v(s)^2 <= v_j^2 + 2 a |s - s_j|  for every slower stretch j before (acceleration) and after (deceleration)

so that a sharper turn is a smaller, slower arc, and a reversal is a stop; a boat that cannot turn on the spot has a
least radius R_min (`turning_radius_m`). Lengths m, speeds m/s, angles rad.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple

from companion.core.configuration.tables import Table
from companion.core.geometry.frames import near, ssa
from companion.core.guidance.path import Path

SMALLEST_RADIUS_M = 0.02
"""A tighter arc is a corner to turn on the spot (assumed)."""
STRAIGHT_RAD = 1e-3
"""A smaller turn angle is no corner (assumed)."""
LEG_SHARE = 0.45
"""Share of a leg that the rounding of a corner may take (assumed): two fit on it."""


class PathLimits(Table, frozen=True, kw_only=True):
    """How the boat may be driven along a path. Speed: paper, section 5.1; all other defaults assumed.

    `turning_radius_m`: least radius of an arc, 0 for a boat that turns on the spot. Raises ValueError where another one
    is not a positive number.
    """

    cruise_m_s: float = 0.5
    acceleration_m_s2: float = 0.15
    deceleration_m_s2: float = 0.15
    lateral_m_s2: float = 0.15
    yaw_rate_rad_s: float = 0.6
    crawl_m_s: float = 0.05
    corner_reach_m: float = 0.5
    corner_cut_m: float = 0.2
    acceptance_m: float = 0.5
    turning_radius_m: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if not (math.isfinite(value) and (value > 0 or (name == "turning_radius_m" and value == 0))):
                raise ValueError(f"{name} must be a positive number, not {value}")


class Segment(NamedTuple):
    """A line (curvature 0) or arc (> 0: to starboard): start, length, first point and angle, speed limit."""

    start_m: float
    length_m: float
    north_m: float
    east_m: float
    angle_rad: float
    curvature_1_m: float
    speed_m_s: float

    def at(self, ds: float) -> tuple[float, float, float]:
        """(north, east, tangent angle) `ds` metres from the segment's start."""
        a, k = self.angle_rad, self.curvature_1_m
        if k == 0.0:
            return self.north_m + ds * math.cos(a), self.east_m + ds * math.sin(a), a
        b = a + k * ds
        return (
            self.north_m + (math.sin(b) - math.sin(a)) / k,
            self.east_m - (math.cos(b) - math.cos(a)) / k,
            b,
        )

    def nearest(self, north: float, east: float) -> float:
        """Distance from the start to the point nearest to (north, east), not clamped to the ends [m]."""
        a, k = self.angle_rad, self.curvature_1_m
        dn, de = north - self.north_m, east - self.east_m
        if k == 0.0:
            return dn * math.cos(a) + de * math.sin(a)
        to_n, to_e = dn + math.sin(a) / k, de - math.cos(a) / k  # from the arc's centre
        b = math.atan2(to_n * math.copysign(1.0, k), -to_e * math.copysign(1.0, k))
        return (near(b, a + k * self.length_m / 2) - a) / k


@dataclass(frozen=True)
class Course:
    """Segments end to end, speeds where they join, and the arc length at which each waypoint is rounded."""

    segments: tuple[Segment, ...]
    starts_m: tuple[float, ...]
    speeds_m_s: tuple[float, ...]
    waypoints_m: tuple[float, ...]
    limits: PathLimits

    @property
    def length_m(self) -> float:
        """Length of the rounded path [m]."""
        return self.starts_m[-1]

    def _segment(self, s_m: float) -> int:
        return min(max(bisect_right(self.starts_m, s_m) - 1, 0), len(self.segments) - 1)

    def at(self, s_m: float) -> tuple[float, float, float]:
        """(north [m], east [m], tangent angle [rad]) at arc length `s_m`, clamped to the ends."""
        segment = self.segments[self._segment(s_m)]
        return segment.at(min(max(s_m - segment.start_m, 0.0), segment.length_m))

    def speed_at(self, s_m: float) -> float:
        """Speed limit at arc length `s_m` [m/s]: 0 at the end, never below the crawl before it."""
        if s_m >= self.length_m:
            return 0.0
        i = self._segment(s_m)
        segment = self.segments[i]
        ds = min(max(s_m - segment.start_m, 0.0), segment.length_m)
        speeding = self.speeds_m_s[i] ** 2 + 2 * self.limits.acceleration_m_s2 * ds
        slowing = self.speeds_m_s[i + 1] ** 2 + 2 * self.limits.deceleration_m_s2 * (segment.length_m - ds)
        v = math.sqrt(min(speeding, slowing, segment.speed_m_s**2))
        return max(v, min(self.limits.crawl_m_s, segment.speed_m_s))

    def beyond_corner(self, s_m: float, within_m: float) -> float:
        """Arc length of a sharp corner that lies at most `within_m` ahead of `s_m`; without one `s_m`."""
        i = self._segment(s_m)
        if i + 1 == len(self.segments) or (corner := self.segments[i + 1]).start_m - s_m > within_m:
            return s_m
        before = self.segments[i].at(self.segments[i].length_m)[2]
        return corner.start_m if abs(ssa(corner.angle_rad - before)) >= STRAIGHT_RAD else s_m

    def follow(self, north_m: float, east_m: float, s_m: float, back_m: float, ahead_m: float) -> float:
        """Arc length of the point nearest to (north, east) from `back_m` before `s_m` to `ahead_m` beyond it.

        The window, which never falls back round a waypoint, keeps the projection on the stretch being driven
        where a path crosses or retraces itself. Of equally near points the first.
        """
        rounded = self.waypoints_m[max(bisect_right(self.waypoints_m, s_m) - 1, 0)]
        low_m, high_m = max(s_m - back_m, rounded), s_m + ahead_m
        best, least = low_m, math.inf
        for i in range(self._segment(low_m), self._segment(high_m) + 1):
            segment = self.segments[i]
            low = max(low_m - segment.start_m, 0.0)
            high = min(high_m - segment.start_m, segment.length_m)
            ds = max(min(segment.nearest(north_m, east_m), high), low)
            n, e, _ = segment.at(ds)
            distance = math.hypot(n - north_m, e - east_m)
            if distance < least - 1e-9:
                best, least = segment.start_m + ds, distance
        return best


def hold_point(north_m: float, east_m: float, psi_rad: float, limits: PathLimits) -> Course:
    """The course of no length: a pose to hold."""
    here = Segment(0.0, 0.0, north_m, east_m, psi_rad, 0.0, 0.0)
    return Course((here,), (0.0, 0.0), (0.0, 0.0), (0.0,), limits)


class _Corner(NamedTuple):
    reach_m: float
    radius_m: float
    turn_rad: float


def _corner(path: Path, i: int, limits: PathLimits) -> _Corner:
    """Rounding of waypoint `i`: an arc, a sharp corner (radius 0), or nothing (reach 0, radius inf)."""
    turn = ssa(path.angles_rad[i] - path.angles_rad[i - 1])
    if abs(turn) < STRAIGHT_RAD:
        return _Corner(0.0, math.inf, turn)
    cut = min(limits.corner_cut_m, 0.5 * (path.waypoints[i].acceptance_m or limits.acceptance_m))
    room = LEG_SHARE * min(path.lengths_m[i - 1], path.lengths_m[i])
    reach = min(limits.corner_reach_m, cut / math.tan(abs(turn) / 4), room)
    if limits.turning_radius_m:
        reach = min(max(reach, limits.turning_radius_m * math.tan(abs(turn) / 2)), room)
    radius = reach / math.tan(abs(turn) / 2)
    return _Corner(reach, radius, turn) if radius >= SMALLEST_RADIUS_M else _Corner(0.0, 0.0, turn)


def corner_speed(radius_m: float, limits: PathLimits) -> float:
    """Speed on an arc [m/s] by lateral acceleration and yaw rate, at least the crawl."""
    limit = min(math.sqrt(limits.lateral_m_s2 * radius_m), limits.yaw_rate_rad_s * radius_m)
    return max(limit, limits.crawl_m_s)


def plan_course(path: Path, limits: PathLimits) -> Course:
    """Path of at least one leg -> Course. Raises ValueError for a path of one waypoint."""
    if not path.lengths_m:
        raise ValueError("a path of one waypoint has no course")
    last = len(path.lengths_m) - 1
    nothing = _Corner(0.0, math.inf, 0.0)
    corners = [nothing, *(_corner(path, i, limits) for i in range(1, last + 1)), nothing]
    cruise = [w.speed_m_s or limits.cruise_m_s for w in path.waypoints[1:]]
    segments: list[Segment] = []
    waypoints = [0.0]
    joins = [math.inf]  # speed limit where segments join: the crawl on a sharp corner
    s = 0.0
    for leg, (angle, length) in enumerate(zip(path.angles_rad, path.lengths_m, strict=True)):
        before, after = corners[leg], corners[leg + 1]
        n, e = path.points[leg]
        n, e = n + before.reach_m * math.cos(angle), e + before.reach_m * math.sin(angle)
        line = Segment(s, length - before.reach_m - after.reach_m, n, e, angle, 0.0, cruise[leg])
        segments.append(line)
        s += line.length_m
        joins.append(limits.crawl_m_s if after.radius_m == 0.0 else math.inf)
        if after.reach_m > 0.0:
            n, e, _ = line.at(line.length_m)
            speed = min(cruise[leg], cruise[leg + 1], corner_speed(after.radius_m, limits))
            k = math.copysign(1.0 / after.radius_m, after.turn_rad)
            segments.append(Segment(s, after.radius_m * abs(after.turn_rad), n, e, angle, k, speed))
            waypoints.append(s + segments[-1].length_m / 2)
            s += segments[-1].length_m
            joins.append(math.inf)
        else:
            waypoints.append(s)
    joins[-1] = 0.0
    starts = (*(g.start_m for g in segments), s)
    return Course(tuple(segments), starts, _join_speeds(segments, joins, limits), tuple(waypoints), limits)


def _join_speeds(segments: list[Segment], joins: list[float], limits: PathLimits) -> tuple[float, ...]:
    """Speeds where segments join: the slower neighbour, then what deceleration and acceleration allow."""
    v = list(joins)
    for i, segment in enumerate(segments):
        v[i], v[i + 1] = min(v[i], segment.speed_m_s), min(v[i + 1], segment.speed_m_s)
    for i in reversed(range(len(segments))):
        v[i] = min(v[i], math.sqrt(v[i + 1] ** 2 + 2 * limits.deceleration_m_s2 * segments[i].length_m))
    for i, segment in enumerate(segments):
        v[i + 1] = min(v[i + 1], math.sqrt(v[i] ** 2 + 2 * limits.acceleration_m_s2 * segment.length_m))
    return tuple(v)
