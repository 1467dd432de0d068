"""Which messages can be asked for, and which come unasked: one row a message.

A row is there for every message that Rover 4.6 or 4.7 accepts a rate for (`mavlink_id_to_ap_message_id`); what needs a
position or a sensor that the simulation lacks never comes, as on the real one without it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.mavlink import board_messages as board
from sim.world.autopilot.mavlink import estimator_messages as estimator
from sim.world.autopilot.mavlink import telemetry
from sim.world.autopilot.vehicle import SimulatedVehicle


class Streamed(NamedTuple):
    """A message: how it is built, and the SR0_ parameter with its rate unasked ("": only on request)."""

    build: Callable[[SimulatedVehicle], wire.MAVLink_message | None]
    group: str = ""


def _never(v: SimulatedVehicle) -> None:
    """A message that cannot be filled."""


HEARTBEAT_ID, PARAM_VALUE_ID, TIMESYNC_ID = 0, 22, 111
_NEVER = (
    32, 35, 49, 62, 83, 85, 87, 124, 127, 128, 132, 136, 133, 143, 158, 162, 168, 173, 180, 181, 191, 192, 194, 226,
    235, 246, 259, 260, 262, 271, 280, 281, 284, 285, 286, 301, 11030, 11038,
)  # fmt: skip
STREAMED: dict[int, Streamed] = {
    **{number: Streamed(_never) for number in _NEVER},
    HEARTBEAT_ID: Streamed(telemetry.heartbeat),
    1: Streamed(telemetry.sys_status, "EXT_STAT"),
    2: Streamed(telemetry.system_time, "EXTRA3"),
    PARAM_VALUE_ID: Streamed(_never),
    24: Streamed(telemetry.gps_raw_int, "EXT_STAT"),
    26: Streamed(telemetry.scaled_imu),
    27: Streamed(telemetry.raw_imu, "RAW_SENS"),
    29: Streamed(board.scaled_pressure, "RAW_SENS"),
    30: Streamed(telemetry.attitude, "EXTRA1"),
    31: Streamed(estimator.attitude_quaternion),
    33: Streamed(estimator.global_position_int, "POSITION"),
    34: Streamed(board.rc_channels_scaled, "RAW_CTRL"),
    36: Streamed(telemetry.servo_output_raw, "RC_CHAN"),
    42: Streamed(telemetry.mission_current, "EXT_STAT"),
    46: Streamed(telemetry.mission_item_reached),
    65: Streamed(telemetry.rc_channels, "RC_CHAN"),
    74: Streamed(telemetry.vfr_hud, "EXTRA2"),
    105: Streamed(telemetry.highres_imu),
    TIMESYNC_ID: Streamed(telemetry.timesync),
    116: Streamed(telemetry.scaled_imu2, "RAW_SENS"),
    125: Streamed(board.power_status, "EXT_STAT"),
    129: Streamed(telemetry.scaled_imu3, "RAW_SENS"),
    137: Streamed(board.scaled_pressure2, "RAW_SENS"),
    147: Streamed(telemetry.battery_status, "EXTRA3"),
    148: Streamed(telemetry.autopilot_version),
    152: Streamed(board.meminfo, "EXT_STAT"),
    163: Streamed(estimator.ahrs, "EXTRA3"),
    165: Streamed(board.hwstatus),
    178: Streamed(estimator.ahrs2, "EXTRA1"),
    193: Streamed(estimator.ekf_status_report, "EXTRA3"),
    241: Streamed(estimator.vibration, "EXTRA3"),
    242: Streamed(telemetry.home_position),
    245: Streamed(board.extended_sys_state),
    376: Streamed(board.relay_status),
}
NEW_IN_4_7, GONE_IN_4_7 = frozenset({105, 136}), frozenset({181})
"""Messages that one of the versions has no rate for."""
ALWAYS_NS: dict[int, int] = {HEARTBEAT_ID: 1_000_000_000, PARAM_VALUE_ID: 100_000_000, TIMESYNC_ID: 10_000_000_000}
"""What every link gets whatever it asks for, and how often."""
GROUP_OF_STREAM: dict[int, tuple[str, ...]] = {
    0: ("RAW_SENS", "EXT_STAT", "RC_CHAN", "RAW_CTRL", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3"),
    1: ("RAW_SENS",),
    2: ("EXT_STAT",),
    3: ("RC_CHAN",),
    4: ("RAW_CTRL",),
    6: ("POSITION",),
    10: ("EXTRA1",),
    11: ("EXTRA2",),
    12: ("EXTRA3",),
}
"""MAV_DATA_STREAM of REQUEST_DATA_STREAM -> groups."""


def streamed(v: SimulatedVehicle, message_id: int) -> Streamed | None:
    """The row of a message that may be asked for; None where this version has no rate for it."""
    absent = GONE_IN_4_7 if v.parameters.firmware.minor >= 7 else NEW_IN_4_7
    if message_id == TIMESYNC_ID or message_id in absent:
        return None
    return STREAMED.get(message_id)
