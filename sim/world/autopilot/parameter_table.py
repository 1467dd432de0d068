"""Parameters of the simulated Rover: names, wire types, firmware defaults, and our boat's own values.

Source of names, types and defaults: ArduPilot Rover 4.6's parameter reference. A real autopilot has
some 1270; these are the ones that the simulation obeys and the ones a client looks at beside them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

CHANNELS = 16


class WireType(IntEnum):
    """MAV_PARAM_TYPE of the four types that ArduPilot uses."""

    INT8 = 2
    INT16 = 4
    INT32 = 6
    REAL32 = 9


class AutopilotParameter(NamedTuple):
    """One row: name, wire type, default of the firmware."""

    name: str
    kind: WireType
    default: float


_INT8 = """FS_ACTION=2 FS_THR_ENABLE=1 FS_GCS_ENABLE=0 FS_CRASH_CHECK=0 FS_EKF_ACTION=1 INITIAL_MODE=0
    TELEM_DELAY=0 PILOT_STEER_TYPE=0 MODE_CH=8 MODE1=0 MODE2=0 MODE3=0 MODE4=0 MODE5=0 MODE6=0 FRAME_CLASS=1
    FRAME_TYPE=0 CRUISE_THROTTLE=50 ARMING_REQUIRE=1 ARMING_RUDDER=2 BRD_SAFETY_DEFLT=1 MOT_PWM_TYPE=0
    MOT_THR_MIN=0 MOT_THR_MAX=100 MOT_SAFE_DISARM=0 RCMAP_ROLL=1 RCMAP_PITCH=2 RCMAP_THROTTLE=3 RCMAP_YAW=4
    SERVO_32_ENABLE=0 SERVO_AUTO_TRIM=0 SCHED_DEBUG=0 SCHED_OPTIONS=0 SCR_ENABLE=0 AHRS_EKF_TYPE=3
    AHRS_ORIENTATION=0 EK3_ENABLE=1 EK3_SRC1_POSXY=3 EK3_SRC1_VELXY=3 EK3_SRC1_POSZ=1 EK3_SRC1_VELZ=3
    EK3_SRC1_YAW=1 GPS1_TYPE=1 VISO_TYPE=0 COMPASS_ENABLE=1 COMPASS_USE=1 BATT_MONITOR=0 BATT_FS_LOW_ACT=0
    LOG_BACKEND_TYPE=1 LOG_DISARMED=0 SERIAL0_PROTOCOL=2 SERIAL1_PROTOCOL=2 SERIAL2_PROTOCOL=2"""
_INT16 = """FORMAT_VERSION=16 SYSID_THISMAV=1 SYSID_MYGCS=255 GCS_PID_MASK=0 FS_THR_VALUE=910 MOT_SLEWRATE=100
    SERVO_RATE=50 SCHED_LOOP_RATE=50 MIS_TOTAL=0 INS_GYRO_FILTER=4 INS_ACCEL_FILTER=10 STAT_BOOTCNT=1 SR0_RAW_SENS=1
    SR0_EXT_STAT=1 SR0_RC_CHAN=1 SR0_RAW_CTRL=1 SR0_POSITION=1 SR0_EXTRA1=1 SR0_EXTRA2=1 SR0_EXTRA3=1
    SR0_PARAMS=10"""
_INT32 = """FS_OPTIONS=0 ARMING_CHECK=1 RC_OPTIONS=32 RC_PROTOCOLS=1 SERVO_RC_FS_MSK=0 SCR_HEAP_SIZE=204800
    SCR_VM_I_COUNT=10000 BATT_CAPACITY=3300 LOG_BITMASK=65535 SERIAL0_BAUD=115 SERIAL1_BAUD=57
    SERIAL2_BAUD=57"""
_REAL32 = """FS_TIMEOUT=1.5 FS_GCS_TIMEOUT=5 FS_EKF_THRESH=0.8 CRUISE_SPEED=2 WP_SPEED=2 WP_RADIUS=2
    RC_OVERRIDE_TIME=3 AHRS_TRIM_X=0 AHRS_TRIM_Y=0 BATT_LOW_VOLT=0 BATT_CRT_VOLT=0"""


def _rows(text: str, kind: WireType) -> list[AutopilotParameter]:
    pairs = (entry.split("=") for entry in text.split())
    return [AutopilotParameter(name, kind, float(value)) for name, value in pairs]


def _channel_rows() -> list[AutopilotParameter]:
    """RCn_* and SERVOn_*: the dead zone of 30 us is the default of the four control channels only."""
    functions = {1: 26.0, 3: 70.0}  # a rover's steering and throttle
    rows = []
    for n in range(1, CHANNELS + 1):
        for stem, dead_zone in ((f"RC{n}", 30.0 if n <= 4 else 0.0), (f"SERVO{n}", None)):
            rows += _rows(f"{stem}_MIN=1100 {stem}_MAX=1900 {stem}_TRIM=1500", WireType.INT16)
            rows += _rows(f"{stem}_REVERSED=0", WireType.INT8)
            if dead_zone is None:
                rows.append(AutopilotParameter(f"{stem}_FUNCTION", WireType.INT16, functions.get(n, 0.0)))
            else:
                rows.append(AutopilotParameter(f"{stem}_DZ", WireType.INT16, dead_zone))
                rows.append(AutopilotParameter(f"{stem}_OPTION", WireType.INT16, 0.0))
    return rows


TABLE: tuple[AutopilotParameter, ...] = tuple(
    _rows(_INT16, WireType.INT16)
    + _rows(_INT8, WireType.INT8)
    + _rows(_INT32, WireType.INT32)
    + _rows(_REAL32, WireType.REAL32)
    + _channel_rows()
)
"""All parameters in the order of their index on the wire."""

BOARD_PARAMETERS: dict[str, float] = {
    "BRD_SAFETY_DEFLT": 0.0,  # no safety switch fitted
    "GPS1_TYPE": 0.0,
    "BATT_MONITOR": 4.0,
    "BATT_CAPACITY": 18000.0,  # mAh; assumed: one 4S 18 Ah pack
    "BATT_LOW_VOLT": 14.0,  # assumed: 3.5 V a cell
}
"""The simulated boat's hardware, whatever its wiring."""

BOAT_PARAMETERS: dict[str, float] = {
    **BOARD_PARAMETERS,
    "FRAME_CLASS": 2.0,  # a boat: HEARTBEAT type 11
    "SYSID_MYGCS": 1.0,  # the companion 1/191 may override, a ground station 255 may not
    "SCHED_LOOP_RATE": 200.0,  # 50 Hz streams exact, 7 ms from override to output
    "INS_GYRO_FILTER": 20.0,  # 11 ms late instead of 56: nothing on board steers by it
    "INS_ACCEL_FILTER": 20.0,
    "ARMING_RUDDER": 0.0,  # a thruster command on channel 1 must not arm the boat
    "FS_GCS_ENABLE": 1.0,
    "RC_OVERRIDE_TIME": 0.5,  # s; with a receiver its channels are back this soon
    "SCR_ENABLE": 1.0,  # the Lua gate
    **{f"RC{n}_DZ": 0.0 for n in range(1, 5)},
    **{f"SERVO{n}_FUNCTION": float(93 + n) for n in range(1, 5)},  # Script1-4
}
"""What our boat's autopilot has been given on top of the firmware's defaults: deploy/ardupilot/gate.param."""
