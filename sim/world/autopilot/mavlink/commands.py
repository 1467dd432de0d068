"""The MAV_CMD table: what each command does, and its MAV_RESULT. What is not in it is UNSUPPORTED.

A handler gets the vehicle, the link and seven parameters (a NaN counts as 0), and answers with a result and
the messages that follow the COMMAND_ACK on that link.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.mavlink.link import PeerLink
from sim.world.autopilot.mavlink.telemetry import ACCEPTED_NEVER_SENT, STREAMED, autopilot_version
from sim.world.autopilot.vehicle import SimulatedVehicle

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
FORCE = frozenset({2989.0, 21196.0})
FORCED_REBOOT = 20190226.0
"""Parameter 6 with which an armed autopilot starts again, too (source: GCS_Common.cpp)."""
_CUSTOM_MODE = 1
_INFO = 6

Reply = tuple[int, tuple[wire.MAVLink_message, ...]]
Handler = Callable[[SimulatedVehicle, PeerLink, Sequence[float]], Reply]


def run(command: int, vehicle: SimulatedVehicle, link: PeerLink, params: Sequence[float]) -> Reply:
    """Carry out one command."""
    handler = HANDLERS.get(command)
    if handler is None:
        return UNSUPPORTED, ()
    return handler(vehicle, link, [p if math.isfinite(p) else 0.0 for p in params])


def set_mode(vehicle: SimulatedVehicle, base_mode: int, custom_mode: int) -> int:
    """DO_SET_MODE and SET_MODE: without the custom flag DENIED, an unknown or refused mode FAILED."""
    if not base_mode & _CUSTOM_MODE:
        return DENIED
    return ACCEPTED if vehicle.modes.set_mode(custom_mode) else FAILED


def _do_set_mode(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    return set_mode(vehicle, int(p[0]), int(p[1])), ()


def _arm_disarm(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    if p[0] == 1:
        return (ACCEPTED if vehicle.modes.arm(force=p[1] in FORCE) else FAILED), ()
    if p[0] == 0:
        vehicle.modes.disarm()
        return ACCEPTED, ()
    return UNSUPPORTED, ()


def _run_prearm_checks(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    for fault in vehicle.modes.arming_faults():
        vehicle.say(2, f"PreArm: {fault}")
    return ACCEPTED, ()


def _get_home(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    return FAILED, ()  # without a position there is no home


def _get_interval(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    message_id = int(p[0])
    if message_id not in STREAMED:
        return FAILED, ()
    return ACCEPTED, (wire.MAVLink_message_interval_message(message_id, link.interval_us(message_id)),)


def _set_interval(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    message_id = int(p[0])
    if message_id in STREAMED:
        return (ACCEPTED if link.set_interval_us(message_id, p[1]) else DENIED), ()
    if message_id in ACCEPTED_NEVER_SENT:
        return ACCEPTED, ()
    vehicle.say(_INFO, f"No ap_message for mavlink id ({message_id})")
    return DENIED, ()


def _request_message(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    message_id = int(p[0])
    streamed = STREAMED.get(message_id)
    if streamed is not None:
        return ACCEPTED, (streamed.build(vehicle),)
    return (ACCEPTED if message_id in ACCEPTED_NEVER_SENT else FAILED), ()


def _request_capabilities(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    return (ACCEPTED, (autopilot_version(vehicle),)) if p[0] == 1 else (FAILED, ())


def _safety_switch(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    if p[0] not in (0, 1):
        return DENIED, ()
    vehicle.modes.safety_on = p[0] == 0
    return ACCEPTED, ()


def _scripting(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    if p[0] not in (wire.SCRIPTING_CMD_STOP, wire.SCRIPTING_CMD_STOP_AND_RESTART):
        return UNSUPPORTED, ()  # the terminal is not simulated
    vehicle.script.stop(vehicle.t_ns, restart=p[0] == wire.SCRIPTING_CMD_STOP_AND_RESTART)
    return ACCEPTED, ()


def _reboot(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    if p[0] != 1:
        return UNSUPPORTED, ()  # shutting down and the boot loader are not simulated
    if vehicle.modes.armed and p[5] != FORCED_REBOOT:
        return FAILED, ()
    vehicle.reboot_asked = True
    return ACCEPTED, ()


HANDLERS: dict[int, Handler] = {
    wire.MAV_CMD_DO_SET_MODE: _do_set_mode,
    wire.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    wire.MAV_CMD_RUN_PREARM_CHECKS: _run_prearm_checks,
    wire.MAV_CMD_GET_HOME_POSITION: _get_home,
    wire.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    wire.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    wire.MAV_CMD_REQUEST_MESSAGE: _request_message,
    wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _request_capabilities,
    wire.MAV_CMD_DO_SET_SAFETY_SWITCH_STATE: _safety_switch,
    wire.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    wire.MAV_CMD_SCRIPTING: _scripting,
}
"""Handlers by MAV_CMD number."""
