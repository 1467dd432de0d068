"""A log as a rosbag2 folder: MCAP storage, message definitions of ROS 2 Humble, which later versions read as well.

rosbags is of the extra `analysis`; which message becomes what is in `ros_messages`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from companion.core.configuration.site_file import Site
from companion.core.geometry.frames import Origin
from companion.core.messages import GroundTruth, Measured, Message
from companion.core.model.thrusters import configuration_matrix
from companion.core.pilot.state import PilotSettings
from companion.logs.configuration import setup_in, zero_ns_of
from companion.logs.export.ros_messages import RosMessages, Told
from companion.logs.log_file import LogError, LogFile
from companion.logs.metadata import site_in

VERSION = 8
"""Of metadata.yaml: what Humble reads."""


class BagWritten(NamedTuple):
    """How many messages a bag holds, and how many had numbers that ROS has no room for; why it has neither the
    mission's path nor the boat's force, where this version refuses the log's configuration.
    """

    messages: int
    left_out: int
    refused: str = ""


def write(log: LogFile, folder: Path, truth: LogFile | None = None) -> BagWritten:
    """Write a log to a new folder. `truth`: the simulator's log of the same run. Raises WriterError, OSError,
    ConfigError: the log's site file is refused.

    A message is recorded when its bytes arrived, and its header says when it was measured, both as Unix time.
    """
    site = site_in(log.metadata, log.path)
    settings, refused = _settings(log)
    types, connections = get_typestore(Stores.ROS2_HUMBLE), {}
    written = left_out = 0
    with Writer(folder, version=VERSION, storage_plugin=StoragePlugin.MCAP) as bag:
        for at_ns, told in _all(log, site, settings, truth):
            for topic, message in told:
                kind = message.__msgtype__
                try:
                    data = types.serialize_cdr(message, kind)
                except (struct.error, OverflowError):
                    left_out += 1
                    continue
                if topic not in connections:
                    connections[topic] = bag.add_connection(topic, kind, typestore=types)
                bag.write(connections[topic], at_ns, data)
                written += 1
    return BagWritten(written, left_out, refused)


def _settings(log: LogFile) -> tuple[PilotSettings | None, str]:
    """The run's settings, None without any or where they are refused, and why."""
    try:
        return setup_in(log).pilot, ""
    except LogError:
        return None, ""
    except ValueError as error:
        return None, str(error)


def _all(
    log: LogFile, site: Site | None, settings: PilotSettings | None, truth: LogFile | None
) -> Iterator[tuple[int, Told]]:
    """When, and what ROS is told then."""
    begin_ns = zero_ns_of(log)
    origin = Origin(site.lat_deg, site.lon_deg, math.radians(site.rotation_deg)) if site else None
    B = configuration_matrix(settings.vessel) if settings and not settings.vessel.servos else None
    turned = RosMessages(log.wall_offset_ns, origin, B)
    if settings:
        yield begin_ns + log.wall_offset_ns, turned.path(settings.mission.path.waypoints, begin_ns)
    for message in log.messages():
        yield _heard_ns(message) + log.wall_offset_ns, turned.see(message)
    for message in truth.messages(GroundTruth) if truth else ():
        yield message.t_ns + log.wall_offset_ns, turned.see(message)


def _heard_ns(message: Message) -> int:
    return message.t_rx_ns if isinstance(message, Measured) else message.t_ns
