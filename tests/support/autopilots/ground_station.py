"""A ground station, system 255, on a world's MAVLink wire: commands to the autopilot beside the companion."""

from __future__ import annotations

from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as wire

SAFETY_ON = wire.MAV_CMD_DO_SET_SAFETY_SWITCH_STATE, wire.SAFETY_SWITCH_STATE_SAFE
SAFETY_OFF = wire.MAV_CMD_DO_SET_SAFETY_SWITCH_STATE, wire.SAFETY_SWITCH_STATE_DANGEROUS
SCRIPTS_STOP = wire.MAV_CMD_SCRIPTING, wire.SCRIPTING_CMD_STOP
SCRIPTS_RESTART = wire.MAV_CMD_SCRIPTING, wire.SCRIPTING_CMD_STOP_AND_RESTART
FORCED_REBOOT = wire.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1, 0, 0, 0, 0, 20190226
"""With the number that an armed ArduPilot wants to see."""


class Wire(Protocol):
    """What it asks of a world."""

    def mavlink(self, data: bytes, peer: str) -> bytes:
        """Bytes to the autopilot."""
        ...


class GroundStation:
    """Sends and does not listen."""

    def __init__(self, world: Wire):
        self._world = world
        self._mav = wire.MAVLink(None, srcSystem=255, srcComponent=190)

    def command(self, number: int, *params: float) -> None:
        """COMMAND_LONG to the autopilot."""
        padded = [*params, *[0] * (7 - len(params))]
        self._send(wire.MAVLink_command_long_message(1, 1, number, 0, *padded))

    def mode(self, custom_mode: int) -> None:
        """Change the autopilot's mode."""
        self.command(wire.MAV_CMD_DO_SET_MODE, wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, custom_mode)

    def parameter(self, name: str, value: float) -> None:
        """PARAM_SET."""
        self._send(wire.MAVLink_param_set_message(1, 1, name.encode(), value, wire.MAV_PARAM_TYPE_REAL32))

    def _send(self, message: wire.MAVLink_message) -> None:
        self._world.mavlink(bytes(message.pack(self._mav)), "ground station")
