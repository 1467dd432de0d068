"""What a ground station may send through us to the autopilot: a table of refusals, each with its reason. Pure.

Everything passes that a person needs to look after the boat or to take it away from us: disarm, HOLD, modes,
missions, reading parameters. Refused is what drives thrusters beside us, what makes the autopilot deaf to us, and
what speaks in our name: on our wire the autopilot cannot tell it from us. A type that pymavlink does not know cannot be
judged and does not pass either. Sources: the behaviour of ArduPilot
Rover 4.6 in docs/autopilot.md where marked (seen), else https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from drivers.mavlink.framing import Framer

_STICKS = "takes the thrusters' channels from us"
_OUTPUT = "drives an output directly"
_BUS = "it speaks on the CAN bus, where speed controllers may listen"
_RATES = "the message rates of this link are ours"
_SETTING = "a setting can turn a thruster on or our fail-safe off; disarm first"

REFUSED: dict[str, str] = {
    "RC_CHANNELS_OVERRIDE": _STICKS,  # (seen)
    "MANUAL_CONTROL": _STICKS,  # becomes overrides of the channels of steering and throttle
    "HIL_RC_INPUTS_RAW": _STICKS,
    "HIL_CONTROLS": _OUTPUT,
    "HIL_ACTUATOR_CONTROLS": _OUTPUT,
    "SET_ACTUATOR_CONTROL_TARGET": _OUTPUT,
    "REQUEST_DATA_STREAM": _RATES,  # rates are per link (seen)
    "SETUP_SIGNING": "the key would go over this network and into our log; set it over USB",
    "SERIAL_CONTROL": "it takes over a serial port, which may be ours",
    "CAN_FRAME": _BUS,
    "CANFD_FRAME": _BUS,
    "DEVICE_OP_WRITE": "it writes to the autopilot's chips",
}
REFUSED_COMMANDS: dict[int, str] = {
    dialect.MAV_CMD_DO_SET_SERVO: _OUTPUT,
    dialect.MAV_CMD_DO_REPEAT_SERVO: _OUTPUT,
    dialect.MAV_CMD_DO_SET_ACTUATOR: _OUTPUT,
    dialect.MAV_CMD_DO_MOTOR_TEST: _OUTPUT,
    dialect.MAV_CMD_ACTUATOR_TEST: _OUTPUT,
    dialect.MAV_CMD_CAN_FORWARD: _BUS,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL: _RATES,
}
REFUSED_UNLESS_DISARMED: dict[str, str] = {
    "PARAM_SET": _SETTING,
    "PARAM_EXT_SET": _SETTING,
    "FILE_TRANSFER_PROTOCOL": "files hold settings and scripts, which can turn a thruster on; disarm first",
}
REFUSED_COMMANDS_UNLESS_DISARMED: dict[int, str] = {
    dialect.MAV_CMD_PREFLIGHT_STORAGE: _SETTING,
    dialect.MAV_CMD_DO_SET_PARAMETER: _SETTING,
}
RATE_BYTES_S, BURST_BYTES = 3000, 3000
"""Of a ground station, so that overrides never queue behind it: a quarter of 115200 baud; assumed."""


class GcsFirewall:
    """Judges what a ground station sends. `system`: our MAVLink system id, in which nobody else may speak.

    `passed`: frames that may go on, by type. `refused`: frames that may not, by type and reason. `flood_bytes`:
    bytes that were not even looked at.
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
            name, reason = message.get_type(), self._reason(message, disarmed)
            if reason is None:
                self.passed[name] += 1
                out.append(bytes(message.get_msgbuf()))
            else:
                self.refused[name, reason] += 1
        return out

    def _reason(self, message: Any, disarmed: bool) -> str | None:
        name = message.get_type()
        if message.get_srcSystem() == self._system:
            return f"it speaks as system {self._system}, which is ours: give the ground station another id"
        if name in ("COMMAND_LONG", "COMMAND_INT"):
            later = None if disarmed else REFUSED_COMMANDS_UNLESS_DISARMED.get(message.command)
            return REFUSED_COMMANDS.get(message.command) or later
        return REFUSED.get(name) or (None if disarmed else REFUSED_UNLESS_DISARMED.get(name))

    def _affords(self, size: int, t_ns: int) -> bool:
        """Token bucket: whether so many bytes may come now."""
        earned = (t_ns - self._budget_ns) * 1e-9 * RATE_BYTES_S
        self._budget_bytes, self._budget_ns = min(BURST_BYTES, self._budget_bytes + earned), t_ns
        if size > self._budget_bytes:
            return False
        self._budget_bytes -= size
        return True
