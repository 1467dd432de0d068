"""What the autopilot says of its board: supply, memory, air pressure, relays. Nothing of it is simulated: constants."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.vehicle import SimulatedVehicle

_SUPPLY_MV = 5000
_FREE_BYTES = 131_072
_PRESSURE_HPA = 1013.25
_TEMPERATURE_CENTI_C = 2500
_ON_GROUND = 1


def power_status(v: SimulatedVehicle) -> wire.MAVLink_message:
    """5 V, from the first supply."""
    return wire.MAVLink_power_status_message(_SUPPLY_MV, 0, wire.MAV_POWER_STATUS_BRICK_VALID)


def hwstatus(v: SimulatedVehicle) -> wire.MAVLink_message:
    """5 V, no errors of the I2C bus."""
    return wire.MAVLink_hwstatus_message(_SUPPLY_MV, 0)


def meminfo(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Free memory; assumed."""
    return wire.MAVLink_meminfo_message(0, 65535, _FREE_BYTES)


def scaled_pressure(v: SimulatedVehicle) -> wire.MAVLink_message:
    """The standard atmosphere at sea level, 25 C."""
    return wire.MAVLink_scaled_pressure_message(v.clock_ms, _PRESSURE_HPA, 0.0, _TEMPERATURE_CENTI_C)


def scaled_pressure2(v: SimulatedVehicle) -> wire.MAVLink_message:
    """A second barometer says the same."""
    return wire.MAVLink_scaled_pressure2_message(v.clock_ms, _PRESSURE_HPA, 0.0, _TEMPERATURE_CENTI_C)


def rc_channels_scaled(v: SimulatedVehicle) -> wire.MAVLink_message:
    """Steering and throttle outputs of a rover, which this boat does not have."""
    return wire.MAVLink_rc_channels_scaled_message(v.clock_ms, 0, 0, 0, 0, 0, 0, 0, 0, 0, 255)


def extended_sys_state(v: SimulatedVehicle) -> wire.MAVLink_message:
    """On the ground."""
    return wire.MAVLink_extended_sys_state_message(0, _ON_GROUND)


def relay_status(v: SimulatedVehicle) -> wire.MAVLink_message:
    """No relays."""
    return wire.MAVLink_relay_status_message(v.clock_ms, 0, 0)
