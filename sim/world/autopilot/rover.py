"""The simulated ArduPilot Rover: MAVLink bytes of any number of peers in and out, PWM out.

    receive(data, peer, t_ns) -> bytes         answers for that peer, at once
    step(t_ns, sensors) -> [(peer, bytes)]     what is due by t on every link
    outputs_us                                 16 pulse widths [us] as of the last call (0: no pulse)

The same calls give the same bytes. Times are the simulation's [ns] and must not fall.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot import commands, ftp
from sim.world.autopilot.link import Link
from sim.world.autopilot.parameter_table import BOAT_PARAMETERS, TABLE
from sim.world.autopilot.parameters import INDEX
from sim.world.autopilot.telemetry import GROUP_OF_STREAM
from sim.world.autopilot.vehicle import SensorFrame, Vehicle

GATE_CHANNELS = (9, 10, 11, 12)
"""RC channels that the Lua gate passes to Script1-4."""


class Rover:
    """System 1, component 1. `parameters` are changes to the firmware's defaults; ValueError if unknown.

    `boot_ns`: when it was switched on; `drift_ppm`: how much faster than the simulation its clock runs.
    """

    def __init__(
        self,
        boot_ns: int,
        parameters: Mapping[str, float] = BOAT_PARAMETERS,
        drift_ppm: float = 0.0,
        gate_channels: tuple[int, ...] = GATE_CHANNELS,
    ):
        self.vehicle = Vehicle(boot_ns, parameters, drift_ppm, gate_channels)
        self.links: dict[Hashable, Link] = {}

    @property
    def outputs_us(self) -> tuple[int, ...]:
        """The 16 pulse widths that leave the autopilot now [us]."""
        return self.vehicle.outputs.pulses_us

    def add_link(self, peer: Hashable) -> None:
        """Start talking to a peer that has not spoken yet; without effect on a known one."""
        if peer not in self.links:
            self.links[peer] = Link(self.vehicle)

    def remove_link(self, peer: Hashable) -> None:
        """Forget a peer and its rates; without effect on an unknown one."""
        self.links.pop(peer, None)

    def receive(self, data: bytes, peer: Hashable, t_ns: int) -> bytes:
        """Bytes from `peer` at t; a new peer gets a link. Garbage is counted on the link, never raised."""
        self.vehicle.advance(t_ns)
        self.add_link(peer)
        link = self.links[peer]
        for message in link.mav.parse_buffer(data) or ():
            if message.get_type() == "BAD_DATA":
                link.bad_data += 1
                continue
            handler = HANDLERS.get(message.get_type())
            if handler is not None and self._is_for_me(message):
                handler(self, link, message)
        self.vehicle.advance(t_ns)
        self._send_texts()
        return link.take()

    def step(self, t_ns: int, sensors: SensorFrame) -> list[tuple[Hashable, bytes]]:
        """Advance to t with new sensor values; the bytes due on each link."""
        self.vehicle.sense(sensors, t_ns)
        self._send_texts()
        for link in self.links.values():
            link.poll()
        taken = ((peer, link.take()) for peer, link in self.links.items())
        return [(peer, data) for peer, data in taken if data]

    def _is_for_me(self, message: wire.MAVLink_message) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.vehicle.system_id) and component in (0, 1)

    def _send_texts(self) -> None:
        for severity, text in self.vehicle.texts:
            for link in self.links.values():
                link.send_text(severity, text)
        self.vehicle.texts.clear()

    # --- received messages -------------------------------------------------------------------------

    def _from_my_gcs(self, message: wire.MAVLink_message) -> bool:
        mine = message.get_srcSystem() == self.vehicle.parameters["SYSID_MYGCS"]
        if mine:
            self.vehicle.failsafe.gcs_heard_ns = self.vehicle.t_ns
        return mine

    def _heartbeat(self, link: Link, message: Any) -> None:
        self._from_my_gcs(message)

    def _override(self, link: Link, message: Any) -> None:
        if self._from_my_gcs(message):
            values = [getattr(message, f"chan{n}_raw") for n in range(1, 19)]
            self.vehicle.rc.override(values, self.vehicle.t_ns)

    def _command(self, link: Link, message: Any) -> None:
        params = [message.param1, message.param2, message.param3, message.param4]
        result, after = commands.run(message.command, self.vehicle, link, [*params, 0.0, 0.0, 0.0])
        self._acknowledge(link, message, message.command, result)
        for reply in after:
            link.send(reply)

    def _set_mode(self, link: Link, message: Any) -> None:
        result = commands.set_mode(self.vehicle, message.base_mode, message.custom_mode)
        self._acknowledge(link, message, message.get_msgId(), result)  # 11: improper, but what it does

    def _acknowledge(self, link: Link, message: Any, command: int, result: int) -> None:
        link.send(
            wire.MAVLink_command_ack_message(command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent())
        )

    def _timesync(self, link: Link, message: Any) -> None:
        if message.tc1 == 0:
            link.send(wire.MAVLink_timesync_message(self.vehicle.clock_us * 1000, message.ts1))

    def _param_list(self, link: Link, message: Any) -> None:
        link.start_download()

    def _param_read(self, link: Link, message: Any) -> None:
        if 0 <= message.param_index < len(TABLE):
            link.send_parameter(TABLE[message.param_index].name, message.param_index)
        elif message.param_index == -1 and message.param_id in INDEX:
            link.send_parameter(message.param_id)

    def _param_set(self, link: Link, message: Any) -> None:
        if self.vehicle.parameters.set(message.param_id, message.param_value):
            for each in self.links.values():
                each.send_parameter(message.param_id)

    def _data_stream(self, link: Link, message: Any) -> None:
        rate_hz = message.req_message_rate if message.start_stop else 0
        link.set_group_rate(GROUP_OF_STREAM.get(message.req_stream_id, ()), rate_hz)

    def _file_transfer(self, link: Link, message: Any) -> None:
        payload = ftp.answer(message.payload)
        sender = message.get_srcSystem(), message.get_srcComponent()
        link.send(wire.MAVLink_file_transfer_protocol_message(0, *sender, payload))


HANDLERS: dict[str, Callable[[Rover, Link, Any], None]] = {
    "HEARTBEAT": Rover._heartbeat,
    "RC_CHANNELS_OVERRIDE": Rover._override,
    "COMMAND_LONG": Rover._command,
    "COMMAND_INT": Rover._command,
    "SET_MODE": Rover._set_mode,
    "TIMESYNC": Rover._timesync,
    "PARAM_REQUEST_LIST": Rover._param_list,
    "PARAM_REQUEST_READ": Rover._param_read,
    "PARAM_SET": Rover._param_set,
    "REQUEST_DATA_STREAM": Rover._data_stream,
    "FILE_TRANSFER_PROTOCOL": Rover._file_transfer,
}
"""Received message type -> what to do with it; all others are ignored."""
