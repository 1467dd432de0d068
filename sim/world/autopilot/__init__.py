"""A simulated ArduPilot Rover that speaks MAVLink 2: bytes and time in, bytes out, nothing else.

    rover.py          composition: links, `receive`, `step`, reboot
    vehicle.py        the state behind the wires, advanced in time
    modes.py          modes and their refusals           failsafe.py   radio and ground-station fail-safes
    arming.py         what keeps it from arming
    rc.py             RC channels: overrides, receiver   stick.py      RCn_MIN/TRIM/MAX/DZ, SERVOn_*
    outputs.py        SERVOn_FUNCTION wirings, latency   mixer.py      Omni-X
    pilot_inputs.py   rudder arming, mode channel        firmware.py   what differs between 4.6 and 4.7
    script.py        the Lua machine: stopped, started again
    parameters.py     PARAM_* semantics                  parameter_table.py   names, types, defaults
    mavlink/          its side of MAVLink: `received` (what each message does), `commands` (MAV_CMD table), `streams`
                      (what is sent when), `telemetry`, `estimator_messages`, `board_messages` (one builder a message),
                      `link` (rates), `signing`, `files`, `parameter_file`, `missions`, `logs`

It reproduces what the real firmware was seen to do, the unsafe things included. Time is always the
simulation's, in ns; there is no clock, socket, thread or random number in here.
"""

from sim.world.autopilot.parameter_table import BOAT_PARAMETERS
from sim.world.autopilot.rover import Rover
from sim.world.autopilot.vehicle import AT_REST, SensorFrame

__all__ = ["AT_REST", "BOAT_PARAMETERS", "Rover", "SensorFrame"]
