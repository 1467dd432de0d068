"""Evidence for logs in other programs: what foxglove and ROS libraries read of a log is what was logged."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from companion.core.geometry.frames import Origin, site_from_geodetic
from companion.core.messages import LoopTiming, StateEstimate
from companion.logs.configuration import setup_in
from companion.logs.export import foxglove, rosbag2
from companion.logs.log_file import LogFile
from companion.logs.series import KNOWN
from tests.companion.logs.page.page_logs import page_log
from tests.evidence.line import Line, at_most, exactly

ENTITIES = {"fence", "anchors", "path", "hull", "ellipse"}
STANDARD = {"nav_msgs", "sensor_msgs", "geometry_msgs", "std_msgs", "rcl_interfaces", "diagnostic_msgs"}


def _known(log: LogFile) -> dict[int, StateEstimate]:
    """Unix time [ns] -> estimate, while the boat knows its place."""
    states = (x for x in log.messages(StateEstimate) if isinstance(x, StateEstimate) and x.health in KNOWN)
    return {x.t_ns + log.wall_offset_ns: x for x in states}


def foxglove_file(full: bool) -> Iterator[Line]:
    """Foxglove: a log as SceneUpdate and LocationFix, read by the mcap library and Foxglove's protobuf classes"""
    with tempfile.TemporaryDirectory() as folder:
        log, out = LogFile(page_log(Path(folder))), Path(folder) / "fox.mcap"
        foxglove.write(log, out)
        ended_ns = max(x.t_ns for x in log.messages(LoopTiming)) + log.wall_offset_ns
        states, site, drawn, off_m = _known(log), setup_in(log).pilot.site, set(), []
        origin = Origin(site.lat_deg, site.lon_deg, math.radians(site.rotation_deg))
        with out.open("rb") as file:
            for schema, _, message in make_reader(file).iter_messages(topics=["/aritra/scene", "/aritra/location"]):
                assert schema is not None
                if schema.name == "foxglove.SceneUpdate":
                    drawn |= {entity.id for entity in SceneUpdate.FromString(message.data).entities}
                else:
                    fix, state = LocationFix.FromString(message.data), states[message.log_time]
                    north, east = site_from_geodetic(origin, fix.latitude, fix.longitude)
                    off_m.append(math.hypot(north - state.north_m, east - state.east_m))
    yield exactly("hull, ellipse, path, fence, anchors in the scene", len(drawn & ENTITIES), len(ENTITIES))
    due = sum(t_ns <= ended_ns for t_ns in states)  # telemetry is sent when a tick ends, and the log ends within one
    yield exactly("estimates of a known place without a LocationFix", due - len(off_m), 0)
    # telemetry is rounded to the millimetre, in each axis
    yield at_most("largest distance of a LocationFix from its estimate", max(off_m) * 1e3, 1.0, "mm")


def rosbag2_folder(full: bool) -> Iterator[Line]:
    """ROS 2: a log as a bag, read by the rosbags library and its message types"""
    with tempfile.TemporaryDirectory() as folder:
        log, out = LogFile(page_log(Path(folder))), Path(folder) / "bag"
        count, left_out, _ = rosbag2.write(log, out)
        states, read, off = _known(log), 0, []
        with AnyReader([out]) as bag:
            packages = {connection.msgtype.split("/")[0] for connection in bag.connections}
            for connection, t_ns, raw in bag.messages():
                message = bag.deserialize(raw, connection.msgtype)
                read += 1
                if connection.topic == "/odometry":  # of a site that is not turned
                    state, pose, twist = states[t_ns], message.pose.pose, message.twist.twist
                    heading = math.pi / 2 - 2 * math.atan2(pose.orientation.z, pose.orientation.w)
                    turned = math.sin(0.5 * (heading - state.psi_rad))
                    found = (pose.position.y, pose.position.x, twist.linear.x, -twist.linear.y, -twist.angular.z)
                    logged = (state.north_m, state.east_m, state.u_m_s, state.v_m_s, state.r_rad_s)
                    off.append(max(abs(turned), float(np.abs(np.subtract(found, logged)).max())))
    yield exactly("messages of packages that are not ROS's own", len(packages - STANDARD), 0)
    yield exactly("messages that were written and not read back", count - read, 0)
    yield exactly("messages left out", left_out, 0)
    yield exactly("estimates of a known place without an Odometry", len(states) - len(off), 0)
    yield at_most("largest error of pose or speed after the way back", max(off), 1e-12, "SI")


PARTS = (foxglove_file, rosbag2_folder)
