"""What a ground station may send through us to the autopilot: a list of what passes; the rest does not. Pure.

While the boat may be armed: what a person needs to look at it, to stop it or to take it away from us. While it is known
to be disarmed: what sets it up, too. Nothing passes that drives thrusters beside us, gives the autopilot a position or
rates of its own, makes it deaf to us or speaks in our name: on our wire the autopilot cannot tell a station from us.
What was invented after these lists were written is refused. Sources: the behaviour of ArduPilot Rover 4.6 in
docs/autopilot.md where marked (seen), else https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from drivers.mavlink.framing import Framer

ALWAYS = frozenset(
    {
        "HEARTBEAT", "PING", "TIMESYNC", "STATUSTEXT", "SET_MODE", "AUTOPILOT_VERSION_REQUEST",
        "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_EXT_REQUEST_LIST", "PARAM_EXT_REQUEST_READ",
        "MISSION_REQUEST_LIST", "MISSION_REQUEST_PARTIAL_LIST", "MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK",
        "FENCE_FETCH_POINT", "RALLY_FETCH_POINT",
    }
)  # fmt: skip
"""Types that pass, armed or not: to look, and to change the mode. COMMAND_LONG and COMMAND_INT: by their command."""
COMMANDS_ALWAYS = frozenset(
    {
        dialect.MAV_CMD_COMPONENT_ARM_DISARM,
        dialect.MAV_CMD_DO_FLIGHTTERMINATION,
        dialect.MAV_CMD_DO_SET_SAFETY_SWITCH_STATE,
        dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
        dialect.MAV_CMD_DO_SET_MODE,
        dialect.MAV_CMD_DO_PAUSE_CONTINUE,
        dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH,
        dialect.MAV_CMD_NAV_LAND,
        dialect.MAV_CMD_MISSION_START,
        dialect.MAV_CMD_RUN_PREARM_CHECKS,
        dialect.MAV_CMD_GET_HOME_POSITION,
        dialect.MAV_CMD_GET_MESSAGE_INTERVAL,
        dialect.MAV_CMD_REQUEST_MESSAGE,
        dialect.MAV_CMD_REQUEST_PROTOCOL_VERSION,
        dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
        dialect.MAV_CMD_REQUEST_CAMERA_INFORMATION,
        dialect.MAV_CMD_REQUEST_CAMERA_SETTINGS,
        dialect.MAV_CMD_REQUEST_STORAGE_INFORMATION,
        dialect.MAV_CMD_REQUEST_FLIGHT_INFORMATION,
        dialect.MAV_CMD_DO_SEND_BANNER,
    }
)
_SETTING = "a setting can turn a thruster on or our fail-safe off; disarm first"
_FILES = "files hold settings and scripts, which can turn a thruster on; disarm first"
_MISSION = "the autopilot's mission, fence and home are changed on a boat that rests; disarm first"
_CALIBRATION = "a calibration changes heading and rates under us; disarm first"
_LOGS = "its logs would take the wire that we live on; disarm first"
_CLOCK = "it sets the autopilot's clock; disarm first"
DISARMED: dict[str, str] = {
    "PARAM_SET": _SETTING,
    "PARAM_EXT_SET": _SETTING,
    "FILE_TRANSFER_PROTOCOL": _FILES,
    **dict.fromkeys(
        (
            "MISSION_COUNT", "MISSION_ITEM", "MISSION_ITEM_INT", "MISSION_WRITE_PARTIAL_LIST", "MISSION_CLEAR_ALL",
            "MISSION_SET_CURRENT", "FENCE_POINT", "RALLY_POINT", "SET_HOME_POSITION", "SET_GPS_GLOBAL_ORIGIN",
        ),
        _MISSION,
    ),
    **dict.fromkeys(("LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_REQUEST_END", "LOG_ERASE"), _LOGS),
    "SYSTEM_TIME": _CLOCK,
}  # fmt: skip
"""Types that pass while the autopilot is known to be disarmed, and why not otherwise."""
COMMANDS_DISARMED: dict[int, str] = {
    dialect.MAV_CMD_PREFLIGHT_STORAGE: _SETTING,
    dialect.MAV_CMD_DO_SET_PARAMETER: _SETTING,
    dialect.MAV_CMD_BATTERY_RESET: _SETTING,
    dialect.MAV_CMD_SET_EKF_SOURCE_SET: _SETTING,
    dialect.MAV_CMD_SCRIPTING: "the gate that our thrusters pass is a script; disarm first",
    dialect.MAV_CMD_DO_SET_HOME: _MISSION,
    dialect.MAV_CMD_DO_FENCE_ENABLE: _MISSION,
    dialect.MAV_CMD_DO_SET_MISSION_CURRENT: _MISSION,
    dialect.MAV_CMD_PREFLIGHT_CALIBRATION: _CALIBRATION,
    dialect.MAV_CMD_PREFLIGHT_SET_SENSOR_OFFSETS: _CALIBRATION,
    dialect.MAV_CMD_FIXED_MAG_CAL: _CALIBRATION,
    dialect.MAV_CMD_FIXED_MAG_CAL_FIELD: _CALIBRATION,
    dialect.MAV_CMD_FIXED_MAG_CAL_YAW: _CALIBRATION,
    dialect.MAV_CMD_DO_START_MAG_CAL: _CALIBRATION,
    dialect.MAV_CMD_DO_ACCEPT_MAG_CAL: _CALIBRATION,
    dialect.MAV_CMD_DO_CANCEL_MAG_CAL: _CALIBRATION,
    dialect.MAV_CMD_ACCELCAL_VEHICLE_POS: _CALIBRATION,
}
_STICKS = "takes the thrusters' channels from us"
_OUTPUT = "drives an output directly"
_BUS = "it speaks on the CAN bus, where speed controllers may listen"
_RATES = "the message rates of this link are ours"
_POSITION = "where the boat is the autopilot hears from its own sensors, or from us"
_GOAL = "it gives the autopilot a goal of its own; take the boat away by its mode instead"
_UNLISTED = "it is not among what a station may send through us"
WHY: dict[str, str] = {
    "RC_CHANNELS_OVERRIDE": _STICKS,  # (seen)
    "MANUAL_CONTROL": _STICKS,  # becomes overrides of the channels of steering and throttle
    "HIL_RC_INPUTS_RAW": _STICKS,
    "PARAM_MAP_RC": _STICKS,
    **dict.fromkeys(("HIL_CONTROLS", "HIL_ACTUATOR_CONTROLS", "SET_ACTUATOR_CONTROL_TARGET"), _OUTPUT),
    "REQUEST_DATA_STREAM": _RATES,  # rates are per link (seen)
    "SETUP_SIGNING": "the key would go over this network and into our log; set it over USB",
    "SERIAL_CONTROL": "it takes over a serial port, which may be ours",
    "CAN_FRAME": _BUS,
    "CANFD_FRAME": _BUS,
    "DEVICE_OP_WRITE": "it writes to the autopilot's chips",
    **dict.fromkeys(
        (
            "GPS_INPUT", "GPS_INJECT_DATA", "GPS_RTCM_DATA", "HIL_GPS", "HIL_SENSOR", "HIL_STATE", "ATT_POS_MOCAP",
            "VISION_POSITION_ESTIMATE", "VISION_POSITION_DELTA", "VISION_SPEED_ESTIMATE", "VICON_POSITION_ESTIMATE",
            "GLOBAL_VISION_POSITION_ESTIMATE", "ODOMETRY",
        ),
        _POSITION,
    ),
    **dict.fromkeys(("SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"), _GOAL),
}  # fmt: skip
"""Words for types that never pass, where there are better ones than that they are not listed."""
WHY_COMMANDS: dict[int, str] = {
    dialect.MAV_CMD_DO_SET_SERVO: _OUTPUT,
    dialect.MAV_CMD_DO_REPEAT_SERVO: _OUTPUT,
    dialect.MAV_CMD_DO_SET_ACTUATOR: _OUTPUT,
    dialect.MAV_CMD_DO_MOTOR_TEST: _OUTPUT,
    dialect.MAV_CMD_DO_SET_RELAY: _OUTPUT,
    dialect.MAV_CMD_ACTUATOR_TEST: _OUTPUT,
    dialect.MAV_CMD_DO_AUX_FUNCTION: "a switch of the autopilot can take the thrusters from us",
    dialect.MAV_CMD_CAN_FORWARD: _BUS,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL: _RATES,
    dialect.MAV_CMD_EXTERNAL_POSITION_ESTIMATE: _POSITION,
    dialect.MAV_CMD_DO_REPOSITION: _GOAL,
    dialect.MAV_CMD_FLASH_BOOTLOADER: "a bootloader is written over USB",
}
UNTOLD = frozenset({"RADIO", "RADIO_STATUS"})
"""Types that a telemetry radio adds by itself; they would thin out our streams, and nobody has sent them."""
RATE_BYTES_S, BURST_BYTES = 3000, 3000
"""Of a ground station, so that overrides never queue behind it: a quarter of 115200 baud; assumed."""
_REBOOT = 1
"""`PREFLIGHT_REBOOT_SHUTDOWN`, parameter 1: start again; 3 stays in the bootloader, 42 makes it crash."""


class GcsFirewall:
    """Judges what a ground station sends. `system`: our MAVLink system id, in which nobody else may speak.

    `passed`: frames that may go on, by type. `refused`: frames that may not, by type or command, and reason.
    `flood_bytes`: bytes that were not even looked at.
    """

    def __init__(self, system: int) -> None:
        self.passed: Counter[str] = Counter()
        self.refused: Counter[tuple[str, str]] = Counter()
        self.flood_bytes = 0
        self._system = system
        self._framer = Framer()
        self._budget_bytes, self._budget_ns = float(BURST_BYTES), 0

    def feed(self, data: bytes, t_ns: int, *, disarmed: bool) -> list[bytes]:
        """Frames of `data`, arrived at `t_ns` [ns], that may go to the autopilot as they are.

        `disarmed`: the autopilot is known to be disarmed; where nothing is known, it is not.
        """
        if not self._affords(len(data), t_ns):
            self.flood_bytes += len(data)
            return []
        out: list[bytes] = []
        for message in self._framer.feed(data, t_ns):
            reason = self._reason(message, disarmed)
            if reason is None:
                self.passed[message.get_type()] += 1
                out.append(bytes(message.get_msgbuf()))
            else:
                self.refused[_name(message), reason] += 1
        return out

    def _reason(self, message: Any, disarmed: bool) -> str | None:
        """Why a message may not pass; None: it may."""
        name = message.get_type()
        if message.get_srcSystem() == self._system:
            return f"it speaks as system {self._system}, which is ours: give the ground station another id"
        if name in ("COMMAND_LONG", "COMMAND_INT"):
            return _command_reason(message, disarmed)
        if name in ALWAYS:
            return None
        if name in DISARMED:
            return None if disarmed else DISARMED[name]
        return WHY.get(name, _UNLISTED)

    def _affords(self, size: int, t_ns: int) -> bool:
        """Token bucket: whether so many bytes may come now."""
        earned = (t_ns - self._budget_ns) * 1e-9 * RATE_BYTES_S
        self._budget_bytes, self._budget_ns = min(BURST_BYTES, self._budget_bytes + earned), t_ns
        if size > self._budget_bytes:
            return False
        self._budget_bytes -= size
        return True


def _command_reason(message: Any, disarmed: bool) -> str | None:
    """Why a COMMAND_LONG or COMMAND_INT may not pass; None: it may.

    Parameter 2 of COMPONENT_ARM_DISARM forces it: 2989 arms an ArduPilot without its checks, 21196 disarms at once.
    """
    command, first = message.command, message.param1
    if command == dialect.MAV_CMD_COMPONENT_ARM_DISARM and first != 0 and message.param2 != 0:
        return "it arms past the autopilot's own checks"
    if command == dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN and first != _REBOOT:
        return "of reboots only a plain one passes (parameter 1 = 1)"
    if command in COMMANDS_ALWAYS:
        return None
    if command in COMMANDS_DISARMED:
        return None if disarmed else COMMANDS_DISARMED[command]
    return WHY_COMMANDS.get(command, _UNLISTED)


def _name(message: Any) -> str:
    """What was sent, for people: the type, or the command. All commands without a name share one."""
    if not hasattr(message, "command") or message.get_type() not in ("COMMAND_LONG", "COMMAND_INT"):
        return message.get_type()
    known = dialect.enums["MAV_CMD"].get(message.command)
    return known.name.removeprefix("MAV_CMD_") if known else "command of an unknown number"
