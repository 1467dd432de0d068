"""The MAV_CMD table: what each command does, and its MAV_RESULT. What is not in it is UNSUPPORTED.

A handler gets the vehicle, the link and seven parameters (a NaN counts as 0), and answers with a result and
the messages that follow the COMMAND_ACK on that link. `WITHOUT_EFFECT` are commands for what this boat does not have,
with the answer of Rover 4.6 and 4.7 (scripts/evidence firmware asks them).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.arming import in_full
from sim.world.autopilot.mavlink.link import PeerLink
from sim.world.autopilot.mavlink.streams import streamed
from sim.world.autopilot.mavlink.telemetry import autopilot_version, home_position
from sim.world.autopilot.modes import Mode
from sim.world.autopilot.parameter_table import CHANNELS
from sim.world.autopilot.vehicle import SimulatedVehicle

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
FORCE = 2989.0
FORCED_REBOOT = 20190226.0
"""Parameter 6 with which an armed autopilot starts again, too (source: GCS_Common.cpp)."""
_CUSTOM_MODE = 1
_CRITICAL, _ERROR, _INFO = 2, 3, 6
_FREE_FUNCTIONS = frozenset({0, 1, *range(51, 67), *range(140, 156)})
"""SERVOn_FUNCTION of outputs that DO_SET_SERVO may have: nothing, and pass-through (source: `do_set_servo`)."""

Reply = tuple[int, tuple[wire.MAVLink_message, ...]]
Handler = Callable[[SimulatedVehicle, PeerLink, Sequence[float]], Reply]


def run(command: int, vehicle: SimulatedVehicle, link: PeerLink, params: Sequence[float]) -> Reply:
    """Carry out one command."""
    if vehicle.parameters.firmware.minor >= 7:
        if command == wire.MAV_CMD_DO_SET_MISSION_CURRENT and params[0] < 1:
            return FAILED, ()  # home, which is always there, but no item to fly to
        if command in OTHERWISE_IN_4_7:
            return OTHERWISE_IN_4_7[command], ()
    handler = HANDLERS.get(command)
    if handler is None:
        return WITHOUT_EFFECT.get(command, UNSUPPORTED), ()
    return handler(vehicle, link, [p if math.isfinite(p) else 0.0 for p in params])


def _known(message: wire.MAVLink_message | None) -> tuple[wire.MAVLink_message, ...]:
    return () if message is None else (message,)


def set_mode(vehicle: SimulatedVehicle, base_mode: int, custom_mode: int) -> int:
    """DO_SET_MODE and SET_MODE: without the custom flag DENIED, an unknown or refused mode FAILED."""
    if not base_mode & _CUSTOM_MODE:
        return DENIED
    return ACCEPTED if vehicle.modes.set_mode(custom_mode) else FAILED


def _do_set_mode(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    return set_mode(vehicle, int(p[0]), int(p[1])), ()


def _enter(mode: Mode) -> Handler:
    return lambda vehicle, link, p: (set_mode(vehicle, _CUSTOM_MODE, mode), ())


def _arm_disarm(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    if p[0] == 1:
        return (ACCEPTED if vehicle.modes.arm(force=p[1] == FORCE) else FAILED), ()
    if p[0] == 0:
        vehicle.modes.disarm()
        return ACCEPTED, ()
    return UNSUPPORTED, ()


def _run_prearm_checks(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    if vehicle.modes.armed:
        return TEMPORARILY_REJECTED, ()
    for fault in vehicle.pre_arm_faults():
        vehicle.say(_CRITICAL, in_full(fault, asked=False))
    return ACCEPTED, ()


def _get_home(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    home = _known(home_position(vehicle))
    return (ACCEPTED if home else FAILED), home


def _set_home(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    """To a place; "here" fails without a position."""
    lat_deg, lon_deg = p[4], p[5]
    if p[0] or not (lat_deg or lon_deg) or abs(lat_deg) > 90 or abs(lon_deg) > 180:
        return FAILED, ()
    vehicle.home = _e7(lat_deg), _e7(lon_deg)
    vehicle.say(_INFO, f"Set HOME to {lat_deg:.5f} {lon_deg:.5f} at {p[6]:.2f}m")
    return ACCEPTED, _known(home_position(vehicle))


def _e7(angle_deg: float) -> int:
    """1e-7 deg, as a product of 32-bit floats: a step of some 0.7 m in home's longitude."""
    return int(struct.unpack("<f", struct.pack("<f", angle_deg * 1e7))[0])


def _set_servo(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    """Accepted for a free output, and without effect: its pulses are those of its function."""
    number = int(p[0])
    if not 1 <= number <= CHANNELS:
        return FAILED, ()
    if int(vehicle.parameters[f"SERVO{number}_FUNCTION"]) in _FREE_FUNCTIONS:
        return ACCEPTED, ()
    vehicle.say(_INFO, f"ServoRelayEvent: Channel {number} is already in use")
    return FAILED, ()


def _get_interval(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    message_id = int(p[0])
    known = 0 <= message_id <= 0xFFFF and streamed(vehicle, message_id) is not None
    interval_us = link.interval_us(message_id) if known else 0
    reply = wire.MAVLink_message_interval_message(message_id & 0xFFFF, interval_us)
    return (ACCEPTED if known else FAILED), (reply,)


def _set_interval(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    message_id = int(p[0])
    if streamed(vehicle, message_id) is not None:
        if link.set_interval_us(message_id, p[1]):
            return ACCEPTED, ()
        if p[1] > 0:
            vehicle.say(_INFO, f"Requested rate for message ID {message_id} too fast. Increase SCHED_LOOP_RATE")
        return DENIED, ()
    vehicle.say(_INFO, f"No ap_message for mavlink id ({message_id & 0xFFFFFFFF})")
    return DENIED, ()


def _request_message(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    row = streamed(vehicle, int(p[0]))
    if row is None:
        return FAILED, ()
    return ACCEPTED, _known(row.build(vehicle))


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
    if vehicle.modes.armed and p[5] != FORCED_REBOOT:
        return FAILED, ()
    if p[0] != 1:
        return UNSUPPORTED, ()  # the boot loader is not simulated
    vehicle.reboot_asked = True
    return ACCEPTED, ()


def _aux_function(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    """Function 0 does nothing; no other one is simulated."""
    if p[1] > 2:
        return DENIED, ()
    if p[0] == 0:
        return ACCEPTED, ()
    vehicle.say(_INFO, f"Invalid channel option ({int(p[0])})")
    return FAILED, ()


def _banner(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    vehicle.say(_INFO, vehicle.parameters.firmware.banner)
    return ACCEPTED, ()


def _yaw_speed(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    """What it asks for needs GUIDED, and a position."""
    vehicle.say(_INFO, "Received message (MAV_CMD_NAV_SET_YAW_SPEED) is deprecated")
    return FAILED, ()


def _compass_by_yaw(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    vehicle.say(_ERROR, "Mag: no position available")
    return FAILED, ()


def _ekf_sources(vehicle: SimulatedVehicle, link: PeerLink, p: Sequence[float]) -> Reply:
    return (ACCEPTED if p[0] in (1, 2, 3) else DENIED), ()


HANDLERS: dict[int, Handler] = {
    wire.MAV_CMD_DO_SET_MODE: _do_set_mode,
    wire.MAV_CMD_NAV_RETURN_TO_LAUNCH: _enter(Mode.RTL),
    wire.MAV_CMD_MISSION_START: _enter(Mode.AUTO),
    wire.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    wire.MAV_CMD_RUN_PREARM_CHECKS: _run_prearm_checks,
    wire.MAV_CMD_GET_HOME_POSITION: _get_home,
    wire.MAV_CMD_DO_SET_HOME: _set_home,
    wire.MAV_CMD_DO_SET_SERVO: _set_servo,
    wire.MAV_CMD_DO_REPEAT_SERVO: _set_servo,
    wire.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    wire.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    wire.MAV_CMD_REQUEST_MESSAGE: _request_message,
    wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _request_capabilities,
    wire.MAV_CMD_DO_SET_SAFETY_SWITCH_STATE: _safety_switch,
    wire.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    wire.MAV_CMD_SCRIPTING: _scripting,
    wire.MAV_CMD_DO_AUX_FUNCTION: _aux_function,
    wire.MAV_CMD_DO_SEND_BANNER: _banner,
    wire.MAV_CMD_NAV_SET_YAW_SPEED: _yaw_speed,
    wire.MAV_CMD_FIXED_MAG_CAL_YAW: _compass_by_yaw,
    wire.MAV_CMD_SET_EKF_SOURCE_SET: _ekf_sources,
}
"""Handlers by MAV_CMD number."""
WITHOUT_EFFECT: dict[int, int] = {
    **dict.fromkeys((194, 195, 197, 201, 203, 206, 207, 42425, 42426, 42651), ACCEPTED),  # region, camera, fence, ...
    **dict.fromkeys((224, 245, 42700), DENIED),  # an item, a storage that is not there
    **dict.fromkeys((178, 181, 182, 205, 211, 500, 601, 1000, 2000, 2500, 42429), FAILED),  # speed, relays, ...
}
"""Results by MAV_CMD number."""
OTHERWISE_IN_4_7 = {213: UNSUPPORTED, 500: ACCEPTED}
"""What 4.7 answers to set yaw and speed, pairing of a receiver."""
