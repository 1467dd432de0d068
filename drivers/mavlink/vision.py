"""Our position for the autopilot's own filter: VISION_POSITION_ESTIMATE and the origin it counts from. Pure.

    p = R(rotation) (p_site + R(psi) l)       psi_ned = psi + rotation       P_ned = J P J^T

with l the lever arm to the autopilot's IMU (then the autopilot's VISO_POS_* stay 0), rotation that of the site's axes
from true north, J the derivative of (p, psi_ned) by (x, y, psi). Height, roll and pitch are 0: the boat floats.

`usec` is the companion's monotonic clock: ArduPilot learns the offset of a sender's clock by itself and takes the
quickest arrivals for true (source, AP_RTC JitterCorrection), so that our clock offset, which is corrected now and
then, would only add jumps. `reset_counter` goes up where the position jumps for any other reason than driving: without
that the autopilot sees a velocity that is not there for 5-10 s (seen on Rover 4.6). Message:
https://mavlink.io/en/messages/common.html#VISION_POSITION_ESTIMATE
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.core.geometry.frames import R2, point_position, rotate, ssa
from companion.core.messages import StateEstimate

JUMP_SIGMAS = 3.0
JUMP_M, JUMP_RAD = 0.3, 0.2
"""A step that the velocity does not explain by this much and JUMP_SIGMAS of the new position or heading; assumed."""
HEAVE_VARIANCE_M2, TILT_VARIANCE_RAD2 = 0.05**2, 0.05**2
"""Of a small hull in a basin, whose height and tilt are not estimated; assumed."""
ORIGIN_RETRY_NS, ORIGIN_RETRY_MAX_NS = 2_000_000_000, 32_000_000_000
"""The autopilot refuses an origin until its filter has started, and says nothing: asked again until it tells one."""


@dataclass(frozen=True)
class VisionPose:
    """One VISION_POSITION_ESTIMATE. `covariance`: upper triangle by rows of x y z roll pitch yaw, 21 numbers."""

    usec: int
    north_m: float
    east_m: float
    yaw_rad: float
    covariance: tuple[float, ...]
    reset_counter: int


class VisionFeed:
    """When to send a position, and which. `rate_hz`: at most; `rotation_rad`: of the site; `arm_m`: to the IMU."""

    def __init__(self, rate_hz: float, rotation_rad: float, arm_m: tuple[float, float]) -> None:
        self.resets = 0
        self._period_ns = round(1e9 / rate_hz)
        self._rotation, self._arm_m = rotation_rad, arm_m
        self._due_ns: int | None = None
        self._last: StateEstimate | None = None
        self._restarts = 0

    def step(self, estimate: StateEstimate, restarts: int) -> VisionPose | None:
        """The position to send for a new estimate, or None. `restarts`: how often the estimator began afresh.

        Nothing is sent while there is no sound estimate; the first one after that counts as a jump.
        """
        if estimate.health not in ("healthy", "degraded"):
            self._last = None
            return None
        afresh = self._due_ns is not None and (self._last is None or restarts != self._restarts)
        if afresh or (self._last is not None and jumped(self._last, estimate)):
            self.resets += 1
        self._last, self._restarts = estimate, restarts
        if self._due_ns is not None and estimate.t_ns < self._due_ns:
            return None
        due_ns = estimate.t_ns if self._due_ns is None else self._due_ns
        late = estimate.t_ns >= due_ns + self._period_ns
        self._due_ns = (estimate.t_ns if late else due_ns) + self._period_ns
        return self._fix(estimate)

    def _fix(self, estimate: StateEstimate) -> VisionPose:
        eta = estimate.north_m, estimate.east_m, estimate.psi_rad
        north, east = rotate(self._rotation, *point_position(eta, self._arm_m))
        P = np.array(estimate.covariance).reshape(6, 6)[:3, :3]
        J = np.eye(3)
        J[:2, :2] = R2(self._rotation)
        arm_north, arm_east = rotate(self._rotation + estimate.psi_rad, *self._arm_m)
        J[:2, 2] = -arm_east, arm_north
        return VisionPose(
            usec=estimate.t_ns // 1000,
            north_m=north,
            east_m=east,
            yaw_rad=ssa(estimate.psi_rad + self._rotation),
            covariance=_triangle(J @ P @ J.T),
            reset_counter=self.resets % 256,
        )


def jumped(before: StateEstimate, after: StateEstimate) -> bool:
    """Whether the pose moved farther between two estimates than velocities and what is uncertain now explain.

    Now, not before: a position found again after long dead reckoning is a step, however vague it was before.
    """
    dt_s = (after.t_ns - before.t_ns) * 1e-9
    psi = before.psi_rad + 0.5 * before.r_rad_s * dt_s
    dx, dy = rotate(psi, before.u_m_s * dt_s, before.v_m_s * dt_s)
    off_m = math.hypot(after.north_m - before.north_m - dx, after.east_m - before.east_m - dy)
    turned = abs(ssa(after.psi_rad - before.psi_rad - before.r_rad_s * dt_s))
    c = after.covariance
    return (
        off_m > JUMP_M + JUMP_SIGMAS * math.sqrt(c[0] + c[7])
        or turned > JUMP_RAD + JUMP_SIGMAS * math.sqrt(c[14])
    )  # fmt: skip


class OriginFeed:
    """When to send SET_GPS_GLOBAL_ORIGIN: after each (re)start of the autopilot, until it tells an origin.

    `told`: how many GPS_GLOBAL_ORIGIN have come from it so far.
    """

    def __init__(self, told: Callable[[], int]) -> None:
        self._told = told
        self._begins = 0
        self._told_before = 0
        self._due_ns: int | None = None
        self._retry_ns = ORIGIN_RETRY_NS

    def due(self, begins: int, t_ns: int) -> bool:
        """Whether to send it now. `begins`: how often the conversation with the autopilot began."""
        if begins != self._begins:
            self._begins, self._told_before = begins, self._told()
            self._due_ns, self._retry_ns = t_ns, ORIGIN_RETRY_NS
        if self._due_ns is None or self._told() != self._told_before:
            self._due_ns = None
            return False
        if t_ns < self._due_ns:
            return False
        self._due_ns = t_ns + self._retry_ns
        self._retry_ns = min(2 * self._retry_ns, ORIGIN_RETRY_MAX_NS)
        return True


def _triangle(P: np.ndarray) -> tuple[float, ...]:
    """Upper triangle of the 6 x 6 covariance of x y z roll pitch yaw, from that of x y yaw."""
    whole = np.zeros((6, 6))
    at = [0, 1, 5]
    whole[np.ix_(at, at)] = P
    whole[2, 2] = HEAVE_VARIANCE_M2
    whole[3, 3] = whole[4, 4] = TILT_VARIANCE_RAD2
    return tuple(map(float, whole[np.triu_indices(6)]))
