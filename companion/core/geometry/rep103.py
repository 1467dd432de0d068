"""From our frames to those of ROS: site axes and NED -> map (x east, y north, z up), body FRD -> FLU, heading -> yaw.

REP-103 (https://www.ros.org/reps/rep-0103.html): forward, left, up in the body; east, north, up on the map, and yaw
counter-clockwise from east. The map has the site's origin and true east and north, however the site is turned.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])
"""Of a vector in the body, of its rates, and of planar [u v r] and [X Y N]: starboard becomes port, down becomes up."""


def flu(vector: Sequence[float]) -> tuple[float, float, float]:
    """Forward, starboard, down -> forward, left, up: a vector or a rate."""
    forward, starboard, down = vector
    return forward, -starboard, -down


def map_from_site(rotation_rad: float) -> np.ndarray:
    """Matrix of [x east, y north, yaw] from [first axis, second axis, psi] of the site, shape (3, 3), yaw without its
    constant; `rotation_rad` as in `frames`.
    """
    c, s = math.cos(rotation_rad), math.sin(rotation_rad)
    return np.array([[s, c, 0.0], [c, -s, 0.0], [0.0, 0.0, -1.0]])


def yaw(psi_rad: float) -> float:
    """Heading clockwise from true north -> yaw counter-clockwise from east [rad]."""
    return math.pi / 2 - psi_rad


def orientation(phi_rad: float, theta_rad: float, psi_rad: float) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) of the body (FLU) on the map from roll, pitch and true heading of FRD in NED [rad]."""
    half = phi_rad / 2, -theta_rad / 2, yaw(psi_rad) / 2
    (cr, cp, cy), (sr, sp, sy) = map(math.cos, half), map(math.sin, half)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
