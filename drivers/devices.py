"""Sensors with a wire of their own: table of the vessel file -> codec. What comes over MAVLink: `mavlink.decode`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from companion.core.configuration.sensors import Sensors
from companion.core.messages import Message
from drivers.dvl import DvlCodec, encode_report
from drivers.uwb import uwb_codec


class DeviceCodec(Protocol):
    """What every codec offers; sans-I/O."""

    @property
    def understood(self) -> int:
        """Frames or lines that followed the format so far."""
        ...

    def start_bytes(self) -> list[bytes]:
        """Call when the port has been opened: forgets half a record; what to send at once."""
        ...

    def step(self, t_ns: int) -> list[bytes]:
        """What to send now; call at about 10 Hz."""
        ...

    def feed(self, data: bytes, t_ns: int) -> list[Message]:
        """Messages completed by bytes that arrived at `t_ns`. Never raises."""
        ...


def _uwb(sensors: Sensors, name: str) -> DeviceCodec:
    return uwb_codec(sensors.tag.wire_format, name, sensors.tag.rate_Hz)


class Wire(NamedTuple):
    """`codec`: from the sensors and the device's name in logs; `encode`: what a simulated device sends for a message;
    None: it is a world of its own (`sim.world.uwb_tag`).
    """

    codec: Callable[[Sensors, str], DeviceCodec]
    encode: Callable[[Any], bytes] | None = None


DEVICES: dict[str, Wire] = {"uwb": Wire(_uwb), "dvl": Wire(lambda sensors, name: DvlCodec(), encode_report)}
"""Key of `[sensors.*]` -> wire."""


def devices_of(sensors: Sensors) -> tuple[str, ...]:
    """Keys of this boat's sensors with a wire of their own."""
    return tuple(key for key in DEVICES if getattr(sensors, key) is not None)
