"""What the controller is asked for: heading and speed along a course, now and over a horizon.

    psi_d   = pi(s) - (1 - w) atan((y_e + kappa y_int) / Delta) - beta     w: station weight, 1 at the end
    psi_ref -> psi_d, no faster than r_max
    u_ref   = min(v(s) max(0, cos(psi_d - psi_ref)), u_ref + a dt)         turn first, then go
                                                                         never below what steers the boat
    s'      = u_ref cos(pi(s) - psi_ref),   y_e' = -y_e u_ref / Delta      prediction over the horizon

pi(s), v(s): tangent and speed limit of the course; see `path` for the LOS law. At the end of the course psi_d
is the heading to hold there. Site axes, m, rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from companion.core.configuration.tables import Table
from companion.core.geometry.frames import rotate, ssa, unrotate
from companion.core.guidance.course import Course, PathLimits
from companion.core.guidance.path import los_heading
from companion.core.guidance.reference_row import REACH_M, Column, path_errors


class GuidanceSettings(Table, frozen=True, kw_only=True):
    """How to steer. Every number is assumed. Raises ValueError naming the key that is out of range.

    `steering`: `course` follows the rounded course; `los` is the paper's law: straight legs, full speed,
    heading constant over the horizon. `kappa` > 0 makes LOS ILOS; `crab` aims the course, not the heading.
    `station_ramp_m`: stretch before the end over which the station weight rises; `lag_rad`: how far the
    heading reference may lead the boat; within `settle_m` and `settle_deg` of the end for `settle_s` is done.
    `steerage_m_s`: speed below which the boat cannot be steered, and is not asked to turn; 0: it turns on the spot.
    `end`: what follows the last waypoint, `station` keeping, or thrust off and `drift`.
    """

    steering: Literal["course", "los"] = "course"
    lookahead_m: float = 2.0
    kappa: float = 0.0
    crab: bool = False
    station_ramp_m: float = 1.0
    lag_rad: float = 0.6
    settle_m: float = 0.3
    settle_deg: float = 5.0
    settle_s: float = 3.0
    steerage_m_s: float = 0.0
    end: Literal["station", "drift"] = "station"
    limits: PathLimits = PathLimits()

    def __post_init__(self) -> None:
        for name in ("lookahead_m", "station_ramp_m", "lag_rad", "settle_m", "settle_deg"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be a positive number, not {getattr(self, name)}")
        for name in ("kappa", "settle_s", "steerage_m_s"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, but is {getattr(self, name)}")


@dataclass(frozen=True)
class ReferenceTrack:
    """What does not change over a horizon: course, heading at its end, ILOS integral and crab angle."""

    course: Course
    end_psi_rad: float
    settings: GuidanceSettings
    y_int_m: float = 0.0
    beta_rad: float = 0.0

    def station_weight(self, s_m: float) -> float:
        """0 on the way, rising to 1 over the last `station_ramp_m` of the course; 0 for a boat that drifts there."""
        if self.settings.end == "drift":
            return 0.0
        return max(0.0, 1.0 - (self.course.length_m - s_m) / self.settings.station_ramp_m)

    def cross_track(self, s_m: float, north_m: float, east_m: float) -> float:
        """y_e to the tangent at `s_m` [m]."""
        n, e, angle = self.course.at(s_m)
        return unrotate(angle, north_m - n, east_m - e)[1]

    def heading(self, s_m: float, y_e_m: float) -> float:
        """Desired heading psi_d [rad]."""
        if s_m >= self.course.length_m:
            return self.end_psi_rad
        angle, c = self.course.at(s_m)[2], self.settings
        law = los_heading(angle, y_e_m, c.lookahead_m, kappa=c.kappa, y_int_m=self.y_int_m, beta_rad=self.beta_rad)
        return angle + (1.0 - self.station_weight(s_m)) * (law - angle)


class Walker(NamedTuple):
    """The reference on its way: arc length, heading, surge speed, and the cross-track error still left."""

    s_m: float
    psi_rad: float
    u_m_s: float
    y_e_m: float


def turn(track: ReferenceTrack, walker: Walker, dt_s: float) -> Walker:
    """`walker` with heading and speed brought towards what its place on the course asks for, in `dt_s`."""
    limits = track.settings.limits
    psi_d = track.heading(walker.s_m, walker.y_e_m)
    most = limits.yaw_rate_rad_s * dt_s
    psi = walker.psi_rad + max(-most, min(most, ssa(psi_d - walker.psi_rad)))
    allowed = track.course.speed_at(walker.s_m)
    speed = max(allowed * max(0.0, math.cos(psi_d - psi)), min(allowed, track.settings.steerage_m_s))
    u = min(speed, walker.u_m_s + limits.acceleration_m_s2 * dt_s)
    return walker._replace(psi_rad=psi, u_m_s=u)


def walk(track: ReferenceTrack, walker: Walker, dt_s: float) -> Walker:
    """`walker` `dt_s` later: along the course, then turned."""
    angle = track.course.at(walker.s_m)[2]
    ahead = walker.u_m_s * max(0.0, math.cos(angle - walker.psi_rad)) * dt_s
    return turn(
        track,
        walker._replace(
            s_m=min(walker.s_m + ahead, track.course.length_m),
            y_e_m=walker.y_e_m * math.exp(-walker.u_m_s * dt_s / track.settings.lookahead_m),
        ),
        dt_s,
    )


def course_rows(track: ReferenceTrack, walker: Walker, times_s: Sequence[float]) -> np.ndarray:
    """Rows of `walker` walked through `times_s`, shape (len(times_s), 8); psi continuous, r its rate."""
    rows = np.zeros((len(times_s), len(Column)))
    for k, t in enumerate(times_s):
        if k:
            walker = walk(track, walker, t - times_s[k - 1])
        n, e, angle = track.course.at(walker.s_m)
        rows[k] = (n, e, angle, walker.psi_rad, walker.u_m_s, 0.0, 0.0, track.station_weight(walker.s_m))
    if len(times_s) > 1:
        rows[:-1, Column.R] = np.diff(rows[:, Column.PSI]) / np.diff(np.asarray(times_s))
        rows[-1, Column.R] = rows[-2, Column.R]
    return rows


def within_reach(rows: np.ndarray, eta: Sequence[float]) -> np.ndarray:
    """The rows of a horizon moved towards a boat at eta = [x y psi], so that the first is `REACH_M` away at most."""
    beyond = [e - max(-REACH_M, min(REACH_M, e)) for e in path_errors(rows[0], eta[0], eta[1])]
    if any(beyond):
        rows[:, [Column.NORTH, Column.EAST]] += rotate(rows[0, Column.PATH_ANGLE], *beyond)
    return rows


def los_rows(
    start: tuple[float, float], path_angle_rad: float, psi_rad: float, u_m_s: float, times_s: Sequence[float]
) -> np.ndarray:
    """The paper's reference: constant heading and speed, the point running along the leg; (N + 1, 8)."""
    rows = np.zeros((len(times_s), len(Column)))
    s = u_m_s * np.asarray(times_s)
    rows[:, Column.NORTH] = start[0] + s * math.cos(path_angle_rad)
    rows[:, Column.EAST] = start[1] + s * math.sin(path_angle_rad)
    rows[:, Column.PATH_ANGLE] = path_angle_rad
    rows[:, Column.PSI] = psi_rad
    rows[:, Column.U] = u_m_s
    return rows
