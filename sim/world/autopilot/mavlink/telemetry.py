"""One builder per message that the autopilot streams: vehicle state -> MAVLink message, in wire units.

Accelerations are in milli-g and rates in mrad/s, cut towards zero to whole numbers, as the firmware does. What is
sent when is in `streams`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.core.constants import GRAVITY_M_S2
from sim.world.autopilot.modes import Mode
from sim.world.autopilot.vehicle import SimulatedVehicle

_STATE_CALIBRATING, _STATE_STANDBY, _STATE_ACTIVE, _STATE_CRITICAL = 2, 3, 4, 5
_GYRO, _ACCEL, _MOTORS, _RC = 0x1, 0x2, 0x8000, 0x10000
_FENCE, _AHRS, _BATTERY, _PREARM = 0x100000, 0x200000, 0x2000000, 0x10000000
_NO_RSSI = 255


def _int16(values: Sequence[float], unit: float) -> list[int]:
    return [max(-32768, min(32767, int(value / unit))) for value in values]


def heartbeat(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Type 11 SURFACE_BOAT (10 unless FRAME_CLASS is 2), autopilot 3."""
    state = {Mode.INITIALISING: _STATE_CALIBRATING, Mode.HOLD: _STATE_STANDBY}.get(v.modes.mode, _STATE_ACTIVE)
    state = _STATE_CRITICAL if v.failsafe.triggered else state
    kind = wire.MAV_TYPE_SURFACE_BOAT if v.parameters["FRAME_CLASS"] == 2 else wire.MAV_TYPE_GROUND_ROVER
    return wire.MAVLink_heartbeat_message(
        kind, wire.MAV_AUTOPILOT_ARDUPILOTMEGA, v.modes.base_mode, v.modes.mode, state, 3
    )


def sys_status(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Health bits (PREARM_CHECK: it would arm; no fence to breach), battery mV and cA."""
    present = _GYRO | _ACCEL | _MOTORS | _RC | _AHRS | _BATTERY | _PREARM
    enabled = present & ~(_MOTORS if v.modes.safety_on else 0)
    ready = v.modes.armed or not v.pre_arm_faults()
    health = (present | _FENCE) & ~(0 if v.failsafe.rc_valid else _RC) & ~(0 if ready else _PREARM)
    voltage_mv, current_ca = _power(v)
    return wire.MAVLink_sys_status_message(
        present, enabled, health, 0, voltage_mv, current_ca, _remaining(v), 0, 0, 0, 0, 0, 0
    )


def system_time(v: SimulatedVehicle) -> wire.MAVLink_message:
    """time_unix_usec stays 0: there is no satellite fix."""
    return wire.MAVLink_system_time_message(0, v.clock_ms)


def gps_raw_int(v: SimulatedVehicle) -> wire.MAVLink_message:
    """The receiver's fix, stamped as it came, in whole ms; no receiver: fix type 0, unknown accuracy."""
    fix = v.sensors.gnss
    if fix is None:
        return wire.MAVLink_gps_raw_int_message(v.clock_us, 0, 0, 0, 0, 65535, 65535, 0, 0, 0)
    north, east = fix.v_north_m_s or 0.0, fix.v_east_m_s or 0.0
    return wire.MAVLink_gps_raw_int_message(
        v.clock_us_at(fix.t_ns) // 1000 * 1000, fix.fix_type, round(fix.lat_deg * 1e7), round(fix.lon_deg * 1e7), 0,
        65535, 65535, round(math.hypot(north, east) * 100), round(math.degrees(math.atan2(east, north)) % 360.0 * 100),
        fix.satellites or 0, h_acc=round((fix.h_acc_m or 0.0) * 1e3), vel_acc=round((fix.v_acc_m_s or 0.0) * 1e3),
    )  # fmt: skip


def raw_imu(v: SimulatedVehicle) -> wire.MAVLink_message:
    """First IMU, microseconds; no magnetometer is simulated."""
    return wire.MAVLink_raw_imu_message(v.clock_us, *_imu(v), 0, 0, 0)


def scaled_imu(v: SimulatedVehicle) -> wire.MAVLink_message:
    """First IMU, milliseconds."""
    return wire.MAVLink_scaled_imu_message(v.clock_ms, *_imu(v), 0, 0, 0)


def scaled_imu2(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Second IMU; the simulated boat has one, so the same sample."""
    return wire.MAVLink_scaled_imu2_message(v.clock_ms, *_imu(v), 0, 0, 0)


def scaled_imu3(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Third IMU: the same sample once more."""
    return wire.MAVLink_scaled_imu3_message(v.clock_ms, *_imu(v), 0, 0, 0)


def highres_imu(v: SimulatedVehicle) -> wire.MAVLink_message:
    """First IMU in SI units, with the accelerometers and gyros alone (fields_updated)."""
    s = v.sensors
    return wire.MAVLink_highres_imu_message(v.clock_us, *s.accel_m_s2, *s.gyro_rad_s, 0, 0, 0, 0, 0, 0, 0, 0x3F)


def attitude(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Angles in rad, yaw within -pi to pi; rates in rad/s."""
    s = v.sensors
    yaw = math.remainder(s.psi_rad, math.tau)
    return wire.MAVLink_attitude_message(v.clock_ms, s.phi_rad, s.theta_rad, yaw, s.p_rad_s, s.q_rad_s, s.r_rad_s)


def servo_output_raw(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Pulses leaving now; the time is the lower 32 bits of the clock [us]."""
    return wire.MAVLink_servo_output_raw_message(v.clock_us & 0xFFFFFFFF, 0, *v.outputs.pulses_us)


def rc_channels(v: SimulatedVehicle) -> wire.MAVLink_message:
    """16 channels, 17 and 18 always 0; chancount is the receiver's, 0 without one."""
    count = len(v.sensors.receiver_us)
    channels = [*v.rc.radio_in_us, 0, 0]
    return wire.MAVLink_rc_channels_message(v.clock_ms, count, *channels, rssi=_NO_RSSI)


def mission_current(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Nothing flies a mission."""
    return wire.MAVLink_mission_current_message(0)


def mission_item_reached(v: SimulatedVehicle) -> wire.MAVLink_message:
    """None was."""
    return wire.MAVLink_mission_item_reached_message(0)


def home_position(v: SimulatedVehicle) -> wire.MAVLink_message | None:
    """Home, once it was set; None before."""
    if v.home is None:
        return None
    return wire.MAVLink_home_position_message(*v.home, 0, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)


def vfr_hud(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Heading in whole degrees; speeds are 0 without a position."""
    return wire.MAVLink_vfr_hud_message(0.0, 0.0, int(math.degrees(v.sensors.psi_rad) % 360.0), 0, 0.0, 0.0)


def battery_status(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Whole pack in the first cell [mV], current cA, consumed mAh."""
    voltage_mv, current_ca = _power(v)
    cells = [voltage_mv] + [65535] * 9
    return wire.MAVLink_battery_status_message(
        0, 0, 0, 32767, cells, current_ca, int(v.consumed_mah), -1, _remaining(v)
    )


def timesync(v: SimulatedVehicle) -> wire.MAVLink_message:
    """The autopilot's own question: tc1 0, ts1 its clock [ns]."""
    return wire.MAVLink_timesync_message(0, v.clock_us * 1000)


_CAPABILITIES = (
    wire.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | wire.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | wire.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | wire.MAV_PROTOCOL_CAPABILITY_FTP
    | wire.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | wire.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | wire.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | wire.MAV_PROTOCOL_CAPABILITY_COMPASS_CALIBRATION
    | wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | wire.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | wire.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
)
"""What Rover says that it can do, 61935; targets and the compass' calibration have no effect here."""


def autopilot_version(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Development build of the firmware on a Cube Orange (board 140)."""
    return wire.MAVLink_autopilot_version_message(
        _CAPABILITIES,
        v.parameters.firmware.flight_sw_version,
        0,
        0,
        140 << 16,
        list(b"aritra00"),
        [0] * 8,
        [0] * 8,
        0x2DAE,
        0x1016,
        0,
    )


def _imu(v: SimulatedVehicle) -> tuple[int, int, int, int, int, int]:
    xacc, yacc, zacc = _int16(v.sensors.accel_m_s2, GRAVITY_M_S2 / 1000.0)
    xgyro, ygyro, zgyro = _int16(v.sensors.gyro_rad_s, 1e-3)
    return xacc, yacc, zacc, xgyro, ygyro, zgyro


def _power(v: SimulatedVehicle) -> tuple[int, int]:
    return min(65534, int(v.sensors.voltage_v * 1000.0)), _int16((v.sensors.current_a,), 0.01)[0]


def _remaining(v: SimulatedVehicle) -> int:
    capacity = v.parameters["BATT_CAPACITY"]
    return int(max(0.0, 100.0 * (1.0 - v.consumed_mah / capacity))) if capacity > 0 else -1
