"""What each MAVLink message means: one line of the table per type, SI units out.

A decoder takes the pymavlink message, the instant it speaks of and its arrival [ns], and returns a message
of `companion.core.messages`, or None where it tells nothing (unknown voltage, absent sensor). Fields that
MAVLink marks as unknown (65535, -1, UINT8_MAX) become None; in the pulse width tuples, which hold integers,
0: "no pulse", as ArduPilot itself reports outputs and channels it does not have. RAW_IMU and SCALED_IMU* are
milli-g and mrad/s (observed on ArduPilot; the MAVLink text calls RAW_IMU raw), cut towards zero to whole ones
(source: GCS_MAVLINK::send_raw_imu, floats handed over as int16): each stands for the middle of what it may have been.
Source: https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.core.constants import GRAVITY_M_S2
from companion.core.messages import (
    Attitude,
    AutopilotInfo,
    Battery,
    CommandAck,
    Heartbeat,
    ImuSample,
    Message,
    MotorOutputs,
    ParamValue,
    RcChannels,
    TimeSync,
)
from companion.core.messages.sensors import GnssFix

MILLI = 1e-3
UINT16_MAX = 65535
UINT8_MAX = 255

Decoder = Callable[[Any, int, int], Message | None]

_US, _MS = 1_000, 1_000_000
STAMPS: dict[str, tuple[str, int, int | None]] = {
    "ATTITUDE": ("time_boot_ms", _MS, 2**32 * _MS),
    "RAW_IMU": ("time_usec", _US, None),
    "SCALED_IMU": ("time_boot_ms", _MS, 2**32 * _MS),
    "SCALED_IMU2": ("time_boot_ms", _MS, 2**32 * _MS),
    "SCALED_IMU3": ("time_boot_ms", _MS, 2**32 * _MS),
    "HIGHRES_IMU": ("time_usec", _US, None),
    "SERVO_OUTPUT_RAW": ("time_usec", _US, 2**32 * _US),
    "RC_CHANNELS": ("time_boot_ms", _MS, 2**32 * _MS),
    "SYSTEM_TIME": ("time_boot_ms", _MS, 2**32 * _MS),
}
"""Message type -> (field of the autopilot's clock since boot, its unit [ns], where it wraps [ns])."""
FIX_STAMPS: dict[str, tuple[str, int, int | None]] = {"GPS_RAW_INT": ("time_usec", _US, None)}
"""The same of a fix: since boot with ArduPilot, Unix time with others, so that no clock can be made of them."""
FIX = dialect.GPS_FIX_TYPE_2D_FIX
"""The least fix_type that is one; without a fix the stamp is that of the last one, and the arrival counts."""

_NO_VEHICLES = frozenset(
    (
        dialect.MAV_TYPE_GCS,
        dialect.MAV_TYPE_ONBOARD_CONTROLLER,
        dialect.MAV_TYPE_ANTENNA_TRACKER,
        dialect.MAV_TYPE_GIMBAL,
        dialect.MAV_TYPE_ADSB,
        dialect.MAV_TYPE_CAMERA,
    )
)
_IMU_UPDATED = 0b111111
"""HIGHRES_IMU.fields_updated: three accelerometer and three gyro axes."""


def is_autopilot(heartbeat: Any) -> bool:
    """Does this HEARTBEAT come from an autopilot, not from a ground station, camera or companion?"""
    return heartbeat.autopilot != dialect.MAV_AUTOPILOT_INVALID and heartbeat.type not in _NO_VEHICLES


def pulses(m: Any, stem: str, count: int) -> tuple[int, ...]:
    """Pulse widths [us] of the fields `stem` 1..count; 0 for unknown."""
    values = (getattr(m, stem.format(i)) for i in range(1, count + 1))
    return tuple(0 if v == UINT16_MAX else v for v in values)


def _heartbeat(m: Any, t_ns: int, _: int) -> Heartbeat | None:
    if not is_autopilot(m):
        return None
    return Heartbeat(
        t_ns=t_ns,
        system=m.get_srcSystem(),
        component=m.get_srcComponent(),
        vehicle_type=m.type,
        autopilot=m.autopilot,
        base_mode=m.base_mode,
        custom_mode=m.custom_mode,
        system_status=m.system_status,
        armed=bool(m.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED),
    )


def gyro_drift(m: Any) -> tuple[float, float, float]:
    """What the AHRS adds to its gyros [rad/s]: AHRS.omegaI, contained in the rates of ATTITUDE (ArduPilot)."""
    return m.omegaIx, m.omegaIy, m.omegaIz


def _attitude(m: Any, t_ns: int, t_rx_ns: int) -> Attitude:
    return Attitude(
        t_ns=t_ns,
        t_rx_ns=t_rx_ns,
        phi_rad=m.roll,
        theta_rad=m.pitch,
        psi_rad=m.yaw,
        p_rad_s=m.rollspeed,
        q_rad_s=m.pitchspeed,
        r_rad_s=m.yawspeed,
    )


def _imu(m: Any, t_ns: int, t_rx_ns: int, accel: Sequence[float], gyro: Sequence[float]) -> ImuSample:
    return ImuSample(
        t_ns=t_ns,
        t_rx_ns=t_rx_ns,
        ax_m_s2=accel[0],
        ay_m_s2=accel[1],
        az_m_s2=accel[2],
        p_rad_s=gyro[0],
        q_rad_s=gyro[1],
        r_rad_s=gyro[2],
        source=m.get_type(),
    )


def _whole(count: int, unit: float) -> float:
    """The middle of the values that become `count` whole units when they are cut towards zero."""
    return (count + math.copysign(0.5, count)) * unit if count else 0.0


def _scaled_imu(m: Any, t_ns: int, t_rx_ns: int) -> ImuSample | None:
    """All six axes exactly 0 is how ArduPilot reports an IMU that is not there (seen in the real log)."""
    if not any((m.xacc, m.yacc, m.zacc, m.xgyro, m.ygyro, m.zgyro)):
        return None
    accel = [_whole(count, MILLI * GRAVITY_M_S2) for count in (m.xacc, m.yacc, m.zacc)]
    return _imu(m, t_ns, t_rx_ns, accel, [_whole(count, MILLI) for count in (m.xgyro, m.ygyro, m.zgyro)])


def _highres_imu(m: Any, t_ns: int, t_rx_ns: int) -> ImuSample | None:
    if m.fields_updated & _IMU_UPDATED != _IMU_UPDATED:
        return None
    return _imu(m, t_ns, t_rx_ns, (m.xacc, m.yacc, m.zacc), (m.xgyro, m.ygyro, m.zgyro))


def _gps_raw_int(m: Any, t_ns: int, t_rx_ns: int) -> GnssFix | None:
    """The receiver's own fix, before any filter of the autopilot's; without a receiver (fix type 0) nothing.

    Velocity comes as speed and course over ground; accuracies of 0 are those of MAVLink 1, which has none.
    """
    if m.fix_type == dialect.GPS_FIX_TYPE_NO_GPS:
        return None
    speed = None if UINT16_MAX in (m.vel, m.cog) else m.vel * 1e-2
    course_rad = math.radians(m.cog * 1e-2)
    return GnssFix(
        t_ns=t_ns,
        t_rx_ns=t_rx_ns,
        fix_type=m.fix_type,
        lat_deg=m.lat * 1e-7,
        lon_deg=m.lon * 1e-7,
        v_north_m_s=None if speed is None else speed * math.cos(course_rad),
        v_east_m_s=None if speed is None else speed * math.sin(course_rad),
        satellites=None if m.satellites_visible == UINT8_MAX else m.satellites_visible,
        h_acc_m=m.h_acc * MILLI or None,
        v_acc_m_s=m.vel_acc * MILLI or None,
    )


def _sys_status(m: Any, t_ns: int, _: int) -> Battery | None:
    if m.voltage_battery == UINT16_MAX:
        return None
    return _battery(t_ns, m.voltage_battery, m.current_battery, m.battery_remaining)


def motor_outputs(m: Any, t_ns: int) -> MotorOutputs | None:
    """What a SYS_STATUS says of the safety switch; None: this autopilot does not tell."""
    bit = dialect.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    if not m.onboard_control_sensors_present & bit:
        return None
    return MotorOutputs(t_ns=t_ns, enabled=bool(m.onboard_control_sensors_enabled & bit))


def _battery_status(m: Any, t_ns: int, _: int) -> Battery | None:
    """Only the first battery, which SYS_STATUS speaks of too: its cells add up to the voltage.

    Cells 11 to 14 that are not there are 0, but 65535 where ArduPilot reads single cells (source: send_battery_status).
    """
    cells = [v for v in m.voltages if v != UINT16_MAX]
    if m.id != 0 or not cells:
        return None
    cells += [v for v in m.voltages_ext if v != UINT16_MAX]
    return _battery(t_ns, sum(cells), m.current_battery, m.battery_remaining)


def _battery(t_ns: int, voltage_mv: int, current_ca: int, remaining: int) -> Battery:
    return Battery(
        t_ns=t_ns,
        voltage_v=voltage_mv * MILLI,
        current_a=None if current_ca == -1 else current_ca * 1e-2,
        remaining_percent=None if remaining == -1 else remaining,
    )


def _rc_channels(m: Any, t_ns: int, _: int) -> RcChannels:
    rssi = None if m.rssi == UINT8_MAX else m.rssi
    return RcChannels(t_ns=t_ns, pwm_us=pulses(m, "chan{}_raw", 18), rssi=rssi)


def _command_ack(m: Any, t_ns: int, _: int) -> CommandAck:
    return CommandAck(t_ns=t_ns, command=m.command, result=m.result)


def _param_value(m: Any, t_ns: int, _: int) -> ParamValue:
    index = None if m.param_index == UINT16_MAX else m.param_index
    return ParamValue(t_ns=t_ns, name=m.param_id, value=m.param_value, index=index, count=m.param_count)


def _timesync(m: Any, t_ns: int, _: int) -> TimeSync:
    return TimeSync(t_ns=t_ns, tc1_ns=m.tc1, ts1_ns=m.ts1)


def _autopilot_version(m: Any, t_ns: int, _: int) -> AutopilotInfo:
    return AutopilotInfo(
        t_ns=t_ns,
        flight_sw_version=m.flight_sw_version,
        board_version=m.board_version,
        capabilities=m.capabilities,
    )


DECODERS: dict[str, Decoder] = {
    "HEARTBEAT": _heartbeat,
    "ATTITUDE": _attitude,
    "RAW_IMU": _scaled_imu,
    "SCALED_IMU": _scaled_imu,
    "SCALED_IMU2": _scaled_imu,
    "SCALED_IMU3": _scaled_imu,
    "HIGHRES_IMU": _highres_imu,
    "GPS_RAW_INT": _gps_raw_int,
    "SYS_STATUS": _sys_status,
    "BATTERY_STATUS": _battery_status,
    "RC_CHANNELS": _rc_channels,
    "COMMAND_ACK": _command_ack,
    "PARAM_VALUE": _param_value,
    "TIMESYNC": _timesync,
    "AUTOPILOT_VERSION": _autopilot_version,
}
"""Message type -> decoder. AHRS, SERVO_OUTPUT_RAW and STATUSTEXT need memory and live in the codec; SYS_STATUS
also becomes `motor_outputs`."""
