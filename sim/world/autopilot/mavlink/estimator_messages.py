"""What the autopilot's estimator says of itself: attitude; with a GNSS fix also a position, which here is the fix."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.core.messages.sensors import GnssFix
from sim.world.autopilot.vehicle import SimulatedVehicle

_ATTITUDE_ONLY = wire.EKF_ATTITUDE | wire.EKF_VELOCITY_VERT | wire.EKF_POS_VERT_ABS | wire.EKF_CONST_POS_MODE
_POSITION = (
    wire.EKF_ATTITUDE | wire.EKF_VELOCITY_HORIZ | wire.EKF_VELOCITY_VERT | wire.EKF_POS_HORIZ_REL
    | wire.EKF_POS_HORIZ_ABS | wire.EKF_POS_VERT_ABS | wire.EKF_PRED_POS_HORIZ_REL | wire.EKF_PRED_POS_HORIZ_ABS
)  # fmt: skip
_NO_HEADING, _FIX_3D = 65535, 3


def _yaw(v: SimulatedVehicle) -> float:
    return math.remainder(v.sensors.psi_rad, math.tau)


def attitude_quaternion(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Attitude as a quaternion w x y z (NED to body), and the rates [rad/s]."""
    s = v.sensors
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(angle / 2), math.sin(angle / 2)) for angle in (s.phi_rad, s.theta_rad, _yaw(v))
    )
    return wire.MAVLink_attitude_quaternion_message(
        v.clock_ms,
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        s.p_rad_s,
        s.q_rad_s,
        s.r_rad_s,
    )


def ahrs(v: SimulatedVehicle) -> wire.MAVLink_message:
    """The correction of the gyros that the rates of ATTITUDE contain [rad/s]; errors of the attitude: none."""
    return wire.MAVLink_ahrs_message(*v.sensors.gyro_drift_rad_s, 0.0, 0.0, 0.0, 0.0)


def ahrs2(v: SimulatedVehicle) -> wire.MAVLink_message:
    """The second estimator's attitude: the same."""
    return wire.MAVLink_ahrs2_message(v.sensors.phi_rad, v.sensors.theta_rad, _yaw(v), 0.0, 0, 0)


def ekf_status_report(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Attitude is known; a horizontal position with a fix."""
    return wire.MAVLink_ekf_status_report_message(
        _POSITION if _fix(v) else _ATTITUDE_ONLY, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    )


def global_position_int(v: SimulatedVehicle) -> wire.MAVLink_message:
    """The latest fix, or zeros; and the heading [centidegrees]."""
    heading, fix = int(math.degrees(v.sensors.psi_rad) % 360.0 * 100.0), _fix(v)
    lat, lon = (round(fix.lat_deg * 1e7), round(fix.lon_deg * 1e7)) if fix else (0, 0)
    north, east = (round((fix.v_north_m_s or 0.0) * 100), round((fix.v_east_m_s or 0.0) * 100)) if fix else (0, 0)
    return wire.MAVLink_global_position_int_message(
        v.clock_ms, lat, lon, 0, 0, north, east, 0, min(heading, _NO_HEADING)
    )


def _fix(v: SimulatedVehicle) -> GnssFix | None:
    """The latest fix that has a position."""
    fix = v.sensors.gnss
    return fix if fix and fix.fix_type >= _FIX_3D else None


def vibration(v: SimulatedVehicle) -> wire.MAVLink_message:
    """None, and no clipping."""
    return wire.MAVLink_vibration_message(v.clock_us, 0.0, 0.0, 0.0, 0, 0, 0)
