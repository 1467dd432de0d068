"""The sensors of one boat: every kind is named here, and whoever deals with sensors iterates over this table.

The filter (screening, stamps, states, fusion), the monitors of frozen and queued readings, the pre-flight check, the
reader of logs, the simulator and the program's devices ask it; none of them knows a kind by name.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from companion.core.configuration.sensors import Sensors
from companion.core.configuration.site_file import Site
from companion.core.geometry.frames import Origin
from companion.core.messages import Message
from companion.core.sensors.dvl import DopplerLog
from companion.core.sensors.gnss import GnssReceiver
from companion.core.sensors.inertial import AttitudeSensor, InertialSensor
from companion.core.sensors.sensor import PositionHealth, Sensor
from companion.core.sensors.uwb import RangingSensor

KINDS: tuple[type[Sensor], ...] = (InertialSensor, AttitudeSensor, RangingSensor, GnssReceiver, DopplerLog)
KIND_OF: dict[type[Message], type[Sensor]] = {message: kind for kind in KINDS for message in kind.messages}
AIDING = tuple(message for kind in KINDS if kind.aids for message in kind.messages)
"""Those of sensors that are not inertial."""
REPEATABLE = tuple(message for kind in KINDS if kind.repeatable is not Sensor.repeatable for message in kind.messages)
"""Messages that show by themselves whether their sensor is frozen."""


def origin_of(site: Site) -> Origin:
    """The site's origin on the earth, and how its axes are turned."""
    return Origin(site.lat_deg, site.lon_deg, math.radians(site.rotation_deg))


def screen(m: Any) -> tuple[Any | None, str]:
    """A sensor's message fit for use, or None and the reason (`Sensor.screen`)."""
    return KIND_OF[type(m)].screen(m)


def position_kind(sensors: Sensors) -> type[Sensor]:
    """Kind of the boat's sensor of positions."""
    return next(kind for kind in KINDS if getattr(sensors, kind.key) is sensors.position)


def sensors_of(sensors: Sensors, site: Site) -> SensorTable:
    """The sensors that a vessel file names, at a site."""
    each: list[Sensor] = [InertialSensor(sensors.imu), AttitudeSensor(sensors.imu)]
    if sensors.uwb:
        each.append(RangingSensor(sensors.uwb, len(site.anchors)))
    if sensors.gnss:
        each.append(GnssReceiver(sensors.gnss, origin_of(site)))
    if sensors.dvl:
        each.append(DopplerLog(sensors.dvl))
    return SensorTable(tuple(each))


class SensorTable:
    """Sensors in order, with UWB before what else has states of its own."""

    def __init__(self, sensors: tuple[Sensor, ...]):
        self.sensors = sensors
        self._by_message: dict[type, Sensor] = {message: sensor for sensor in sensors for message in sensor.messages}

    def __iter__(self) -> Iterator[Sensor]:
        return iter(self.sensors)

    def of(self, m: object) -> Sensor | None:
        """The sensor that a message comes from; None: no sensor of this boat."""
        return self._by_message.get(type(m))

    def __getitem__(self, m: object) -> Sensor:
        """The same, of a message that comes from one."""
        return self._by_message[type(m)]

    @property
    def position(self) -> Sensor:
        """The sensor of positions, of which a vessel file has one."""
        return next(sensor for sensor in self.sensors if sensor.health)

    @property
    def limits(self) -> PositionHealth:
        """When an estimate is degraded or lost, by the sensor of positions."""
        return next(sensor.health for sensor in self.sensors if sensor.health)
