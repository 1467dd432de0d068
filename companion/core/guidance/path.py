"""A path of waypoints, the errors to it, and the LOS and ILOS steering laws.

    [x_e y_e]' = R(pi_p)' (p - p_k)                                along-track and cross-track error
    psi_d = pi_p - atan((y_e + kappa y_int) / Delta) - beta        LOS (kappa = 0), ILOS
    y_int' = Delta y_e / (Delta^2 + (y_e + kappa y_int)^2)

pi_p: angle of the leg from waypoint k to k + 1 [rad]; Delta: look-ahead [m]; beta: crab angle, 0 unless it
is compensated. Site axes (north, east) in m. Source: Fossen 2021, sec. 12.3-12.4; ILOS: Borhaug, Pavlov and
Pettersen 2008.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

from companion.core.geometry.frames import unrotate

SHORTEST_LEG_M = 0.05
"""Two waypoints closer than this are one: a leg needs a direction (assumed)."""
FASTEST_M_S, WIDEST_M = 20.0, 100.0
"""Beyond these a leg's speed and an acceptance radius are a slip of the decimal point, for boats to 25 m (assumed)."""


@dataclass(frozen=True)
class Waypoint:
    """A point to pass. Speed of the leg that leads to it and its acceptance radius; None: the default."""

    north_m: float
    east_m: float
    speed_m_s: float | None = None
    acceptance_m: float | None = None


@dataclass(frozen=True)
class Path:
    """Straight legs through `waypoints` in order; leg k goes from waypoint k to k + 1.

    Raises ValueError, naming the waypoint, where there is none, one is not finite, has a speed or radius that
    is not positive, or lies on the one before it.
    """

    waypoints: tuple[Waypoint, ...]

    def __post_init__(self) -> None:
        problems = path_problems(self.waypoints)
        if problems:
            raise ValueError("; ".join(f"waypoint {i + 1}: {what}" for i, what in problems))

    @cached_property
    def points(self) -> tuple[tuple[float, float], ...]:
        """(north, east) of every waypoint [m]."""
        return tuple((w.north_m, w.east_m) for w in self.waypoints)

    @cached_property
    def lengths_m(self) -> tuple[float, ...]:
        """Length of every leg [m]."""
        return tuple(math.dist(a, b) for a, b in pairwise(self.points))

    @cached_property
    def angles_rad(self) -> tuple[float, ...]:
        """Angle pi_p of every leg from north, clockwise [rad]."""
        return tuple(math.atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(self.points))

    @cached_property
    def starts_m(self) -> tuple[float, ...]:
        """Arc length at every waypoint [m]; the last is the length of the path."""
        s = [0.0]
        for length in self.lengths_m:
            s.append(s[-1] + length)
        return tuple(s)

    @property
    def length_m(self) -> float:
        """Sum of all legs [m]."""
        return self.starts_m[-1]

    def errors(self, leg: int, north_m: float, east_m: float) -> tuple[float, float]:
        """(x_e, y_e) of a point to a leg [m]: x_e from the leg's start, y_e > 0 to starboard of it."""
        n0, e0 = self.points[leg]
        return unrotate(self.angles_rad[leg], north_m - n0, east_m - e0)


def path_problems(waypoints: tuple[Waypoint, ...]) -> list[tuple[int, str]]:
    """What keeps `waypoints` from being a Path: (index, words) of each problem, in order."""
    if not waypoints:
        return [(0, "a path needs at least one waypoint")]
    problems: list[tuple[int, str]] = []
    for i, w in enumerate(waypoints):
        if not (math.isfinite(w.north_m) and math.isfinite(w.east_m)):
            problems.append((i, "position is not finite"))
            continue
        for name, value, most in (("speed", w.speed_m_s, FASTEST_M_S), ("acceptance radius", w.acceptance_m, WIDEST_M)):
            if value is not None and not 0 < value <= most:
                problems.append((i, f"{name}: expected above 0, at most {most:g}, found {value:g}"))
        before = waypoints[i - 1] if i else None
        if before and math.dist((w.north_m, w.east_m), (before.north_m, before.east_m)) < SHORTEST_LEG_M:
            problems.append((i, f"lies within {SHORTEST_LEG_M} m of the waypoint before it"))
    return problems


def los_heading(
    path_angle_rad: float,
    y_e_m: float,
    lookahead_m: float,
    *,
    kappa: float = 0.0,
    y_int_m: float = 0.0,
    beta_rad: float = 0.0,
) -> float:
    """Desired heading psi_d [rad] of LOS (kappa = 0) or ILOS; `beta_rad` is subtracted to aim the course."""
    return path_angle_rad - math.atan((y_e_m + kappa * y_int_m) / lookahead_m) - beta_rad


def ilos_rate(y_e_m: float, y_int_m: float, lookahead_m: float, kappa: float) -> float:
    """Rate of the ILOS integral state y_int [m/s]; the denominator keeps it from winding up far away."""
    return lookahead_m * y_e_m / (lookahead_m**2 + (y_e_m + kappa * y_int_m) ** 2)


def crab_angle(u_m_s: float, v_m_s: float, least_m_s: float = 0.1) -> float:
    """Crab angle beta_c = atan2(v, u) over ground [rad]; 0 below `least_m_s` (assumed): noise rules it."""
    return math.atan2(v_m_s, u_m_s) if u_m_s > least_m_s else 0.0
