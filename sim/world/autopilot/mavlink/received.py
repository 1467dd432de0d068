"""What each received message type does. The answers go into the sender's link."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.mavlink import commands
from sim.world.autopilot.mavlink.files import OPCODE_AT, is_known
from sim.world.autopilot.mavlink.link import PeerLink
from sim.world.autopilot.mavlink.streams import GROUP_OF_STREAM
from sim.world.autopilot.parameter_table import TABLE

if TYPE_CHECKING:
    from sim.world.autopilot.rover import Rover

_ERROR, _DEBUG = 3, 7


def is_for(rover: Rover, link: PeerLink, message: wire.MAVLink_message) -> bool:
    """Whether this autopilot acts upon a message (source: `MAVLink_routing::check_and_forward`).

    Beside what is addressed to it or to everyone: what is for a component of its system that no other link has heard.
    """
    own = rover.vehicle.system_id
    link.heard.add((message.get_srcSystem(), message.get_srcComponent()))
    if (message.get_srcSystem(), message.get_srcComponent()) == (own, 1):
        return False
    system, component = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
    if system not in (0, own):
        return False
    others = (each.heard for each in rover.links.values() if each is not link)
    return system == 0 or component in (0, 1) or not any((own, component) in heard for heard in others)


def _from_my_gcs(rover: Rover, message: wire.MAVLink_message) -> bool:
    mine = message.get_srcSystem() == rover.vehicle.parameters["SYSID_MYGCS"]
    if mine:
        rover.vehicle.failsafe.gcs_heard_ns = rover.vehicle.t_ns
    return mine


def _heartbeat(rover: Rover, link: PeerLink, message: Any) -> None:
    _from_my_gcs(rover, message)


def _override(rover: Rover, link: PeerLink, message: Any) -> None:
    if _from_my_gcs(rover, message):
        values = [getattr(message, f"chan{n}_raw") for n in range(1, 19)]
        rover.vehicle.rc.override(values, rover.vehicle.t_ns)


def _command(rover: Rover, link: PeerLink, message: Any) -> None:
    params = [message.param1, message.param2, message.param3, message.param4]
    if message.get_type() == "COMMAND_INT":
        params += [message.x * 1e-7, message.y * 1e-7, message.z]
    else:
        params += [message.param5, message.param6, message.param7]
    result, after = commands.run(message.command, rover.vehicle, link, params)
    _acknowledge(link, message, message.command, result)
    for reply in after:
        link.send(reply)


def _set_mode(rover: Rover, link: PeerLink, message: Any) -> None:
    commands.set_mode(rover.vehicle, message.base_mode, message.custom_mode)  # without an answer


def _acknowledge(link: PeerLink, message: Any, command: int, result: int) -> None:
    link.send(
        wire.MAVLink_command_ack_message(command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent())
    )


def _timesync(rover: Rover, link: PeerLink, message: Any) -> None:
    if message.tc1 == 0:
        link.send(wire.MAVLink_timesync_message(rover.vehicle.clock_us * 1000, message.ts1))


def _param_list(rover: Rover, link: PeerLink, message: Any) -> None:
    link.start_download()


def _param_read(rover: Rover, link: PeerLink, message: Any) -> None:
    if 0 <= message.param_index < len(TABLE):
        link.send_parameter(message.param_index, by_index=True)
    elif message.param_index == -1 and (index := rover.vehicle.parameters.find(message.param_id)) is not None:
        link.send_parameter(index, by_index=False)


def _param_set(rover: Rover, link: PeerLink, message: Any) -> None:
    index = rover.vehicle.parameters.find(message.param_id)
    if index is None:
        return
    if rover.vehicle.parameters.set(TABLE[index].name, message.param_value):
        for each in rover.links.values():
            each.send_parameter(index, by_index=False)


def _setup_signing(rover: Rover, link: PeerLink, message: Any) -> None:
    if rover.vehicle.modes.armed:
        rover.vehicle.say(_ERROR, "ERROR: Won't setup signing when armed")
        return
    rover.key.set(bytes(message.secret_key), message.initial_timestamp)
    for each in rover.links.values():
        each.install_key()


def _data_stream(rover: Rover, link: PeerLink, message: Any) -> None:
    rate_hz = message.req_message_rate if message.start_stop else 0
    link.set_group_rate(GROUP_OF_STREAM.get(message.req_stream_id, ()), rate_hz)


def _file_transfer(rover: Rover, link: PeerLink, message: Any) -> None:
    sender = message.get_srcSystem(), message.get_srcComponent()
    opcode = message.payload[OPCODE_AT]
    if not is_known(opcode):
        rover.vehicle.say(_DEBUG, f"Unsupported FTP: {opcode}")
    for payload in rover.files.answers(message.payload, rover.vehicle.t_ns):
        link.send(wire.MAVLink_file_transfer_protocol_message(0, *sender, payload))


def _mission(rover: Rover, link: PeerLink, message: Any) -> None:
    rover.missions.receive(link, message, rover.vehicle.t_ns)


def _mission_set_current(rover: Rover, link: PeerLink, message: Any) -> None:
    rover.missions.set_current(link, message.seq)


def _log_list(rover: Rover, link: PeerLink, message: Any) -> None:
    rover.logs.list_to(link, message.start, message.end)


def _log_data(rover: Rover, link: PeerLink, message: Any) -> None:
    rover.logs.data_to(link, message.id, message.ofs, message.count)


def _log_end(rover: Rover, link: PeerLink, message: Any) -> None:
    rover.logs.end(link)


HANDLERS: dict[str, Callable[[Rover, PeerLink, Any], None]] = {
    "HEARTBEAT": _heartbeat,
    "RC_CHANNELS_OVERRIDE": _override,
    "COMMAND_LONG": _command,
    "COMMAND_INT": _command,
    "SET_MODE": _set_mode,
    "TIMESYNC": _timesync,
    "PARAM_REQUEST_LIST": _param_list,
    "PARAM_REQUEST_READ": _param_read,
    "PARAM_SET": _param_set,
    "SETUP_SIGNING": _setup_signing,
    "REQUEST_DATA_STREAM": _data_stream,
    "FILE_TRANSFER_PROTOCOL": _file_transfer,
    "MISSION_COUNT": _mission,
    "MISSION_ITEM_INT": _mission,
    "MISSION_REQUEST_LIST": _mission,
    "MISSION_REQUEST_INT": _mission,
    "MISSION_REQUEST": _mission,
    "MISSION_CLEAR_ALL": _mission,
    "MISSION_SET_CURRENT": _mission_set_current,
    "LOG_REQUEST_LIST": _log_list,
    "LOG_REQUEST_DATA": _log_data,
    "LOG_REQUEST_END": _log_end,
}
"""Received message type -> what to do with it; all others are ignored."""
