"""Plausibility of sensor messages before the filter: finite, and within what such a sensor can measure."""

from __future__ import annotations

import math

from companion.core.estimation.filter_state import Fusible
from companion.core.messages import Attitude, ImuSample, UwbPosition, UwbRanges

MAX_ACCEL_M_S2 = 320.0
"""Twice the largest full scale of an autopilot's IMU (16 g)."""
MAX_RATE_RAD_S = 70.0
"""Twice the largest full scale (2000 deg/s)."""
MAX_ANGLE_RAD = 7.0
"""Beyond a full turn; angles come as -pi..pi or 0..2 pi."""
MAX_DISTANCE_M = 2000.0
"""Beyond any UWB; assumed."""


def screen(m: Fusible) -> tuple[Fusible | None, str]:
    """The message fit for the filter, or None and the reason. Bad ranges are taken out one by one."""
    match m:
        case ImuSample():
            rates = _within(MAX_RATE_RAD_S, m.p_rad_s, m.q_rad_s, m.r_rad_s)
            return _verdict(m, rates and _within(MAX_ACCEL_M_S2, m.ax_m_s2, m.ay_m_s2, m.az_m_s2), "imu")
        case Attitude():
            angles = _within(MAX_ANGLE_RAD, m.phi_rad, m.theta_rad, 0.0 if math.isnan(m.psi_rad) else m.psi_rad)
            return _verdict(m, angles and _within(MAX_RATE_RAD_S, m.r_rad_s), "heading")
        case UwbPosition():
            return _verdict(m, _within(MAX_DISTANCE_M, m.x_m, m.y_m, m.z_m), "position")
        case UwbRanges():
            good = tuple(r for r in m.ranges if 0 < r.range_m <= MAX_DISTANCE_M)
            if len(good) == len(m.ranges):
                return m, ""
            kept = UwbRanges(t_ns=m.t_ns, t_rx_ns=m.t_rx_ns, tag=m.tag, ranges=good)
            return kept if good else None, "range: not finite or absurd"


def _within(limit: float, *values: float) -> bool:
    """Whether all values are finite and no larger than the limit."""
    return all(math.isfinite(v) and abs(v) <= limit for v in values)


def _verdict(m: Fusible, good: bool, kind: str) -> tuple[Fusible | None, str]:
    """The message or the reason."""
    return (m, "") if good else (None, f"{kind}: not finite or absurd")
