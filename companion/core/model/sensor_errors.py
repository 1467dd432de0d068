"""Known errors of the sensors: the measurement of a true value, and its inverse.

Each pair is inverse: `correct_imu` of `apply_imu_errors`, and so on. The simulator's sensors apply them, the filter and
the fits correct for them, with the numbers of `[sensors.imu]` and `[sensors.uwb]`. All zero: nothing changes, bit for
bit.

IMU      [a_x a_y] = R(m)^T a + b      m: `misalignment_rad`, by which its axes are turned about z, from x towards y
         r         = (1 + `gyro_scale`) r + `gyro_bias_rad_s`
heading  psi       = psi + `heading_offset_rad` + `hard_iron_cos_rad` cos psi + `hard_iron_sin_rad` sin psi
place    p         = (1 + `scale`) p   of the tag, horizontal, about the site's origin; ranges as measured from there
sight    p         = p + extra e       in `nlos_share` of measurements, e away from `nlos_anchor`, horizontal, extra
                                       exponential of mean `nlos_extra_m`: drawn, and not corrected; a gate's matter
stamp    t         = t + `latency_s` + `clock_drift_s_s` (t - t_0)      t_0: the first UWB message

Heading in the axes of the site. A constant heading offset and UWB anchors surveyed in a frame that is turned the other
way look the same in every log: one number stands for both. Numbers and arrays alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from companion.core.configuration.sensors import Imu, Sensors, Uwb
from companion.core.geometry.frames import rotate, unrotate

NEWTON_STEPS = 8
"""Newton steps of the heading with hard iron; amplitudes of 0.5 rad need six to reach rounding."""


def apply_imu_errors(imu: Imu, a_x: Any, a_y: Any, r: Any) -> tuple[Any, Any, Any]:
    """Measured specific force [m/s^2] along the IMU's x and y, and yaw rate [rad/s], of the true ones."""
    a_x, a_y = unrotate(imu.misalignment_rad, a_x, a_y)
    rate = (1 + imu.gyro_scale) * r + imu.gyro_bias_rad_s
    return a_x + imu.accel_bias_x_m_s2, a_y + imu.accel_bias_y_m_s2, rate


def correct_imu(imu: Imu, a_x: Any, a_y: Any, r: Any) -> tuple[Any, Any, Any]:
    """Specific force along the body's x and y, and yaw rate, of the measured ones."""
    a_x, a_y = rotate(imu.misalignment_rad, a_x - imu.accel_bias_x_m_s2, a_y - imu.accel_bias_y_m_s2)
    return a_x, a_y, correct_yaw_rate(imu, r)


def correct_yaw_rate(imu: Imu, r: Any) -> Any:
    """Yaw rate [rad/s] of a measured one."""
    return (r - imu.gyro_bias_rad_s) / (1 + imu.gyro_scale)


def apply_heading_errors(imu: Imu, psi: Any) -> Any:
    """Measured heading [rad] of a true one, not wrapped."""
    return psi + imu.heading_offset_rad + imu.hard_iron_cos_rad * np.cos(psi) + imu.hard_iron_sin_rad * np.sin(psi)


def correct_heading(imu: Imu, psi_measured: Any) -> Any:
    """Heading [rad] of a measured one, by Newton's method; unique while hard iron turns it by less than a radian."""
    a, b = imu.hard_iron_cos_rad, imu.hard_iron_sin_rad
    psi = psi_measured - imu.heading_offset_rad
    if a or b:
        for _ in range(NEWTON_STEPS):
            psi = psi + (psi_measured - apply_heading_errors(imu, psi)) / (1 - a * np.sin(psi) + b * np.cos(psi))
    return psi


def apply_uwb_scale(uwb: Uwb, north: Any, east: Any) -> tuple[Any, Any]:
    """Position of the tag as its ranges make it appear [m]."""
    return (1 + uwb.scale) * north, (1 + uwb.scale) * east


def out_of_sight(anchor_m: tuple[float, float], north: Any, east: Any, extra_m: Any) -> tuple[Any, Any]:
    """Position [m] at which a tag appears that is measured `extra_m` too far from an anchor (north, east)."""
    dn, de = north - anchor_m[0], east - anchor_m[1]
    far = np.hypot(dn, de) + 1e-9
    return north + extra_m * dn / far, east + extra_m * de / far


def correct_uwb_scale(uwb: Uwb, north: Any, east: Any) -> tuple[Any, Any]:
    """Position of the tag [m] that appears at a place."""
    return north / (1 + uwb.scale), east / (1 + uwb.scale)


def arrival_time_ns(uwb: Uwb, t_ns: int, zero_ns: int) -> int:
    """Instant [ns] at which a measurement of `t_ns` arrives, never before it; `zero_ns`: t_0 above."""
    since = t_ns - zero_ns
    return t_ns + max(0, round(uwb.latency_s * 1e9) + round(uwb.clock_drift_s_s * since))


def measurement_time_ns(uwb: Uwb, t_ns: int, zero_ns: int) -> int:
    """Instant [ns] of the measurement that arrived at `t_ns`, never after it."""
    since = t_ns - zero_ns - round(uwb.latency_s * 1e9)
    return min(t_ns, zero_ns + since - round(drifted(uwb.clock_drift_s_s, since)))


def drifted(drift_s_s: float, since: Any) -> Any:
    """How much older than its latency what arrives is, `since` after t_0 by the stamps less latency; in that unit."""
    return since * drift_s_s / (1 + drift_s_s)


IMU_KEYS = (
    "accel_bias_x_m_s2",
    "accel_bias_y_m_s2",
    "gyro_bias_rad_s",
    "gyro_scale",
    "misalignment_rad",
    "heading_offset_rad",
    "hard_iron_cos_rad",
    "hard_iron_sin_rad",
)


def knows_imu_errors(imu: Imu) -> bool:
    """Whether the file states an error of IMU or compass."""
    return any(getattr(imu, key) for key in IMU_KEYS)


def is_exact(sensors: Sensors) -> bool:
    """Whether the file has no error that can be corrected message by message."""
    return not ((sensors.uwb and sensors.uwb.scale) or knows_imu_errors(sensors.imu))
