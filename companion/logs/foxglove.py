"""Messages for Foxglove's own panels, derived from ours: pose (3D panel) and alerts (Log panel).

Schema names and fields: https://docs.foxglove.dev/docs/sdk/schemas (PoseInFrame, Log, FrameTransform).
Poses are given in frame `ned` (x north, y east, z down). One transform per log file hangs `ned` below
`world` (x east, y north, z up), so that the 3D panel shows the basin from above and not mirrored.
"""

from __future__ import annotations

import math

import msgspec

from companion.core.messages import Alert, Message, StateEstimate
from companion.logs.schema import VIEWER_PREFIX

_LEVEL = {"info": 2, "warning": 3, "error": 4}  # foxglove.LogLevel


class Time(msgspec.Struct, frozen=True):
    """Seconds and nanoseconds since the Unix epoch."""

    sec: int
    nsec: int


class Vector3(msgspec.Struct, frozen=True):
    """Position or translation [m]."""

    x: float
    y: float
    z: float


class Quaternion(msgspec.Struct, frozen=True):
    """Rotation from the child (body) frame to the parent frame, w last."""

    x: float
    y: float
    z: float
    w: float


class Pose(msgspec.Struct, frozen=True):
    """Position [m] and orientation."""

    position: Vector3
    orientation: Quaternion


class PoseInFrame(msgspec.Struct, frozen=True):
    """foxglove.PoseInFrame."""

    timestamp: Time
    frame_id: str
    pose: Pose


class Log(msgspec.Struct, frozen=True):
    """foxglove.Log. `level`: 1 debug, 2 info, 3 warning, 4 error, 5 fatal."""

    timestamp: Time
    level: int
    message: str
    name: str
    file: str = ""
    line: int = 0


class FrameTransform(msgspec.Struct, frozen=True):
    """foxglove.FrameTransform: the child frame as seen from the parent frame."""

    timestamp: Time
    parent_frame_id: str
    child_frame_id: str
    translation: Vector3
    rotation: Quaternion


VIEWER_KINDS: dict[type[msgspec.Struct], str] = {
    PoseInFrame: VIEWER_PREFIX + "pose",
    Log: VIEWER_PREFIX + "log",
    FrameTransform: VIEWER_PREFIX + "tf",
}


def world_from_ned(wall_ns: int) -> FrameTransform:
    """Half a turn about (1, 1, 0)/sqrt(2): north -> y, east -> x, down -> -z."""
    half = math.sqrt(0.5)
    return FrameTransform(_time(wall_ns), "world", "ned", Vector3(0.0, 0.0, 0.0), Quaternion(half, half, 0.0, 0.0))


def viewer_message(message: Message, wall_offset_ns: int) -> PoseInFrame | Log | None:
    """What a viewer shows for `message`, or None. `wall_offset_ns`: wall clock minus monotonic clock."""
    wall_ns = message.t_ns + wall_offset_ns
    if isinstance(message, StateEstimate):
        return pose_in_frame(wall_ns, message.north_m, message.east_m, message.psi_rad)
    if isinstance(message, Alert):
        return log_line(wall_ns, message.level, message.text)
    return None


def pose_in_frame(wall_ns: int, north_m: float, east_m: float, psi_rad: float) -> PoseInFrame:
    """A pose in `ned`."""
    half = psi_rad / 2
    place = Vector3(north_m, east_m, 0.0)
    return PoseInFrame(_time(wall_ns), "ned", Pose(place, Quaternion(0.0, 0.0, math.sin(half), math.cos(half))))


def log_line(wall_ns: int, level: str, text: str, name: str = "aritra") -> Log:
    """An alert of `level` info, warning or error."""
    return Log(_time(wall_ns), _LEVEL[level], text, name)


def _time(wall_ns: int) -> Time:
    return Time(*divmod(wall_ns, 1_000_000_000))
