r"""ArduPilot's JSON physics interface, byte for byte: servo packets in, lines of state out.

    servo packet   little-endian: magic u16, frame rate u16 [Hz], frame count u32, 16 or 32 pulse widths u16 [us]
    state          \n{"timestamp":...,"imu":{"gyro":[...],"accel_body":[...]},"position":[...],...}\n

The firmware does not parse the state, it searches the text: for a section, from there for a key, and reads the
number that begins two characters after the key's name. So nothing may stand between `":` and a value, and no key may
occur inside an earlier one. It takes the text between the last two line feeds that it has received.

An output that nobody writes (safety switch on, no script) is 0 inside the firmware. But Rover in SITL limits outputs 1
and 3 (4.7: output 1) to 1000..2000 us before it sends them, for its own model of a car: 1000/0/1000/0 are four outputs
without a pulse (`ServoPacket.outputs_us`).

Sources: ArduPilot, libraries/SITL/examples/JSON/readme.md, SIM_JSON.cpp and AP_HAL_SITL/SITL_State.cpp
(`_simulator_servos`); Rover 4.6 and 4.7 observed.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass

Vec3 = tuple[float, float, float]

PORT = 9002
"""Where instance 0 of the firmware sends; instance N sends to 9002 + 10 N."""
_HEAD = struct.Struct("<HHI")
_PULSES = {18458: 16, 29569: 32}
"""Outputs by magic number; 32 with SERVO_32_ENABLE."""
_LIMITED, _FREE = (0, 2), (1, 3)
"""Places of the outputs that SITL limits, and of those beside them that it does not."""
_LOWEST_US = 1000
"""What a limited output shows instead of no pulse. Our wirings command 1100 to 1900 us."""


class NotServos(ValueError):
    """The datagram is no servo packet; the text says why."""


@dataclass(frozen=True)
class ServoPacket:
    """What the firmware sends: pulse widths [us] of outputs 1 to 16 or 32, 0: no pulse.

    `frame_count`: from 0 at its start, one more for each state that it has taken; `frame_rate_hz`: 1 / the step that
    it asks for.
    """

    frame_rate_hz: int
    frame_count: int
    pulses_us: tuple[int, ...]

    @property
    def outputs_us(self) -> tuple[int, ...]:
        """Pulse widths before SITL's limits [us]: a limited output at its lowest beside free ones at 0 has no pulse.

        While a free one has a pulse, 1000 us is what was commanded: full astern is never hidden.
        """
        if any(self.pulses_us[place] for place in _FREE):
            return self.pulses_us
        silent = [place for place in _LIMITED if self.pulses_us[place] == _LOWEST_US]
        return tuple(0 if place in silent else pulse for place, pulse in enumerate(self.pulses_us))


@dataclass(frozen=True)
class PhysicsState:
    """The state that the firmware receives. Body axes x forward, y starboard, z down; NED about the firmware's home.

    `timestamp_s`: time of the physics; `accel_m_s2`: specific force, (0, 0, -9.81) in a level boat at rest;
    `attitude_rad`: roll, pitch, yaw.
    """

    timestamp_s: float
    gyro_rad_s: Vec3
    accel_m_s2: Vec3
    position_m: Vec3
    velocity_m_s: Vec3
    attitude_rad: Vec3
    voltage_v: float
    current_a: float


def decode(data: bytes) -> ServoPacket:
    """The servo packet in one datagram. Raises NotServos."""
    if len(data) < _HEAD.size:
        raise NotServos(f"{len(data)} bytes, a servo packet has 40 or 72")
    magic, rate, count = _HEAD.unpack_from(data)
    pulses = _PULSES.get(magic)
    if pulses is None:
        raise NotServos(f"magic number {magic}, expected one of {', '.join(map(str, _PULSES))}")
    if len(data) != _HEAD.size + 2 * pulses:
        raise NotServos(f"{len(data)} bytes, with magic number {magic} a servo packet has {_HEAD.size + 2 * pulses}")
    return ServoPacket(rate, count, struct.unpack_from(f"<{pulses}H", data, _HEAD.size))


def encode(state: PhysicsState) -> bytes:
    """The datagram that tells the firmware `state`. Raises ValueError for a number that is not finite."""
    fields = {
        "timestamp": state.timestamp_s,
        "imu": {"gyro": state.gyro_rad_s, "accel_body": state.accel_m_s2},
        "position": state.position_m,
        "attitude": state.attitude_rad,
        "velocity": state.velocity_m_s,
        "battery": {"voltage": state.voltage_v, "current": state.current_a},
    }
    text = json.dumps(fields, separators=(",", ":"), allow_nan=False)
    return f"\n{text}\n".encode("ascii")
