"""Messages of sensors with channels (`core.sensors.sensor`) as streams of a run.

A channel about positions becomes `north_m`, `east_m`; any other `extra_<sensor>_<channel>_<axis>`, in the unit of the
sensor's own equation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from companion.core.messages import Measured, Message
from companion.core.sensors.sensor import Channel, Sensor
from companion.logs.readers.join import Stream


def channel_streams(
    sensors: Iterable[Sensor], messages: Mapping[type[Message], Sequence[Measured]]
) -> tuple[list[Stream], dict[str, str]]:
    """A stream for each channel, and the source of its columns as text. Stamps are those of the messages.

    `messages`: by type. What a sensor would not let the filter have is left out.
    """
    streams, sources = [], {}
    for sensor in sensors:
        rows: dict[str, list[tuple[float, ...]]] = {channel.name: [] for channel in sensor.channels}
        for m in (m for kind in sensor.messages if sensor.channels for m in messages.get(kind, ())):
            good, _ = sensor.screen(m)
            for reading in sensor.readings(sensor.correct(good)) if good is not None else ():
                rows[reading.channel].append((m.t_ns, *reading.z))
        for channel in sensor.channels:
            names = columns_of(sensor, channel)
            streams.append(Stream.of(f"{sensor.label} {channel.name}", names, rows[channel.name]))
            if rows[channel.name]:
                sources |= dict.fromkeys(names, f"{sensor.label}, {channel.name}")
    return streams, sources


def columns_of(sensor: Sensor, channel: Channel) -> tuple[str, ...]:
    """Columns of a run that hold a channel."""
    if channel.about == "position":
        return "north_m", "east_m"
    return tuple(f"extra_{sensor.key}_{channel.name}_{axis}" for axis in channel.axes)
