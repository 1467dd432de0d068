"""Angles and frames: NED, the site's (basin) axes, the body, lever arms, and local flat earth.

    p_ned = R(psi) p_body          v_ned = R(psi) v_body            (Fossen 2021, eq. 2.40, planar case)
    p_point = p_origin + R(psi) l  v_point = v_origin + r x l       (lever arm l, body axes)

Frames. NED: x north, y east, z down. Site: the axes of the basin or field in which anchors, missions and
states are written; same origin, turned clockwise from true north by `rotation_rad` (0: site = NED). Inside
the program "north" and "east" are the site's first and second axis, and psi counts from the first.
Body: x forward, y starboard, z down. Angles in rad, lengths in m.

Rotations and the motion of a point are for floats, arrays (components first) and CasADi expressions alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

RAD_PER_DEG = math.pi / 180.0
WGS84_A_M = 6378137.0
"""Semi-major axis of the WGS84 ellipsoid (NIMA TR8350.2)."""
WGS84_E2 = 6.69437999014e-3
"""First eccentricity squared of the WGS84 ellipsoid (NIMA TR8350.2)."""


def ssa(angle_rad: float) -> float:
    """Smallest signed angle: `angle_rad` wrapped to [-pi, pi) (Fossen 2021, sec. 13.4)."""
    angle_rad = wrapped(angle_rad)
    return -math.pi if angle_rad >= math.pi else angle_rad


def wrapped(angle_rad: Any) -> Any:
    """As `ssa`, also of an array or a column of a table; just below -pi rounding may leave pi."""
    return (angle_rad + math.pi) % math.tau - math.pi


def near(angle_rad: float, reference_rad: float) -> float:
    """The angle equal to `angle_rad` modulo 2 pi that lies within pi of `reference_rad` [rad]."""
    return reference_rad + ssa(angle_rad - reference_rad)


def cos_sin(angle_rad: Any) -> tuple[Any, Any]:
    """Cosine and sine of a float, of an array, or of a CasADi expression."""
    if isinstance(angle_rad, float | int):
        return math.cos(angle_rad), math.sin(angle_rad)
    if isinstance(angle_rad, np.ndarray):
        return np.cos(angle_rad), np.sin(angle_rad)
    return angle_rad.cos(), angle_rad.sin()


def R2(psi_rad: float | np.ndarray) -> np.ndarray:
    """Planar rotation body -> NED, shape (*psi.shape, 2, 2)."""
    c, s = cos_sin(psi_rad)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def rotate(psi_rad: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """R2(psi) [x y]: body components to NED, or site components to NED with psi = rotation."""
    c, s = cos_sin(psi_rad)
    return c * x - s * y, s * x + c * y


def unrotate(psi_rad: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """R2(psi)^T [x y]: NED components to body, or NED to site with psi = rotation."""
    c, s = cos_sin(psi_rad)
    return c * x + s * y, c * y - s * x


def to_level(phi_rad: Any, theta_rad: Any, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """R_y(theta) R_x(phi) [x y z]: body components to level axes that keep the heading."""
    (cp, sp), (ct, st) = cos_sin(phi_rad), cos_sin(theta_rad)
    down = sp * y + cp * z
    return ct * x + st * down, cp * y - sp * z, ct * down - st * x


def point_position(eta: Any, arm_m: Any) -> tuple[Any, Any]:
    """Where a sensor is, in NED: eta = [x y psi] of the body origin, `arm_m` = [forward, starboard] to the sensor."""
    dx, dy = rotate(eta[2], arm_m[0], arm_m[1])
    return eta[0] + dx, eta[1] + dy


def origin_position(point_m: tuple[float, float], psi_rad: float, arm_m: tuple[float, float]) -> tuple[float, float]:
    """Where the body origin is when the sensor at `arm_m` is at `point_m`: inverse of `point_position`."""
    dx, dy = rotate(psi_rad, *arm_m)
    return point_m[0] - dx, point_m[1] - dy


def point_velocity(nu: Any, arm_m: Any) -> tuple[Any, Any]:
    """Velocity of the point at `arm_m` in body axes [m/s]: [u - r l_y, v + r l_x]; nu = [u v r]."""
    return nu[0] - nu[2] * arm_m[1], nu[1] + nu[2] * arm_m[0]


def point_acceleration(nu: Any, nu_dot: Any, arm_m: Any) -> tuple[Any, Any]:
    """Acceleration of the point at `arm_m` in body axes [m/s^2]: what a level accelerometer there measures.

    a_x = u_dot - v r - l_x r^2 - l_y r_dot,  a_y = v_dot + u r - l_y r^2 + l_x r_dot   (Fossen 2021, sec. 2.4, planar)
    """
    (u, v, r), r_dot = (nu[0], nu[1], nu[2]), nu_dot[2]
    a_x = nu_dot[0] - v * r - arm_m[0] * r**2 - arm_m[1] * r_dot
    a_y = nu_dot[1] + u * r - arm_m[1] * r**2 + arm_m[0] * r_dot
    return a_x, a_y


@dataclass(frozen=True)
class Origin:
    """Where the site's origin lies on the earth, and how far its axes are turned clockwise from north."""

    latitude_deg: float
    longitude_deg: float
    rotation_rad: float = 0.0


def earth_radii(latitude_rad: float) -> tuple[float, float]:
    """Radii of curvature of WGS84: meridian R_M and prime vertical R_N [m] (Fossen 2021, eq. 2.92-2.93)."""
    q = 1.0 - WGS84_E2 * math.sin(latitude_rad) ** 2
    prime_vertical = WGS84_A_M / math.sqrt(q)
    return prime_vertical * (1.0 - WGS84_E2) / q, prime_vertical


def site_from_geodetic(origin: Origin, latitude_deg: Any, longitude_deg: Any) -> tuple[Any, Any]:
    """Latitude, longitude -> (north_m, east_m) in site axes, earth flat around the origin; floats or arrays.

    dN = R_M dmu, dE = R_N cos(mu0) dl. Error below 2 mm at 100 m and 0.2 m at 1 km (latitudes up to 60 deg).
    """
    meridian, prime_vertical = earth_radii(math.radians(origin.latitude_deg))
    north = meridian * (RAD_PER_DEG * (latitude_deg - origin.latitude_deg))
    dlon = wrapped(RAD_PER_DEG * (longitude_deg - origin.longitude_deg))
    east = prime_vertical * math.cos(math.radians(origin.latitude_deg)) * dlon
    return unrotate(origin.rotation_rad, north, east)


def geodetic_from_site(origin: Origin, north_m: Any, east_m: Any) -> tuple[Any, Any]:
    """(north_m, east_m) in site axes -> latitude, longitude [deg]: inverse of `site_from_geodetic`."""
    mu = math.radians(origin.latitude_deg)
    meridian, prime_vertical = earth_radii(mu)
    north, east = rotate(origin.rotation_rad, north_m, east_m)
    longitude = math.radians(origin.longitude_deg) + east / (prime_vertical * math.cos(mu))
    return origin.latitude_deg + north / meridian / RAD_PER_DEG, wrapped(longitude) / RAD_PER_DEG
