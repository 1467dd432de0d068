"""MAVLink mission items, as QGroundControl writes them to .plan (JSON) and .waypoints (QGC WPL 110).

Understood: NAV_WAYPOINT (acceptance radius, yaw at the last one), LOITER_UNLIM and LOITER_TIME as the last
position (station keeping goes on for ever there), DO_CHANGE_SPEED. Altitudes are ignored, and so is the
plan's cruiseSpeed, which the ground station uses for its own estimates only. Anything else is an error with
its index. Formats: docs.qgroundcontrol.com (plan file format) and mavlink.io (file formats, MAV_CMD).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec

from companion.core.guidance.missions.draft import Draft
from companion.core.guidance.path import Waypoint

WAYPOINT, LOITER_UNLIM, LOITER_TIME, CHANGE_SPEED = 16, 17, 19, 178
POSITIONS = (WAYPOINT, LOITER_UNLIM, LOITER_TIME)
NAMES = {
    16: "NAV_WAYPOINT", 17: "NAV_LOITER_UNLIM", 18: "NAV_LOITER_TURNS", 19: "NAV_LOITER_TIME",
    20: "NAV_RETURN_TO_LAUNCH", 21: "NAV_LAND", 22: "NAV_TAKEOFF", 82: "NAV_SPLINE_WAYPOINT",
    92: "NAV_GUIDED_ENABLE", 93: "NAV_DELAY", 112: "CONDITION_DELAY", 115: "CONDITION_YAW",
    177: "DO_JUMP", 178: "DO_CHANGE_SPEED", 179: "DO_SET_HOME", 181: "DO_SET_RELAY", 183: "DO_SET_SERVO",
    201: "DO_SET_ROI", 203: "DO_DIGICAM_CONTROL", 206: "DO_SET_CAM_TRIGG_DIST", 530: "SET_CAMERA_MODE",
}  # fmt: skip
INSTEAD: dict[int, str] = dict.fromkeys((18, 20, 21), "; the boat keeps station at the last waypoint")
"""What happens without the item, for those that end a mission elsewhere."""
FRAMES = (0, 3, 5, 6, 10, 11)
"""MAV_FRAME with latitude and longitude: global, above home or terrain, and their integer forms."""
HOME_FRAMES = (0, 5)
"""Of these without "above home": ground stations and autopilots write home so, and never a waypoint of their own."""


@dataclass(frozen=True)
class MissionItem:
    """One mission item: MAV_CMD number, MAV_FRAME, seven parameters (None where not given)."""

    place: str
    command: int
    frame: int
    params: tuple[float | None, ...]
    auto_continue: bool

    @property
    def name(self) -> str:
        """Command number and, where known, its name."""
        return f"command {self.command} {NAMES.get(self.command, '')}".rstrip()

    def param(self, number: int) -> float:
        """Parameter 1-7, 0 where it is not given."""
        return self.params[number - 1] or 0.0


def read_items(draft: Draft, items: list[MissionItem]) -> None:
    """Turn items into waypoints, speeds and the heading at the end; the errors go to the draft."""
    last = max((i for i, item in enumerate(items) if item.command in POSITIONS), default=-1)
    speed: float | None = None
    for i, item in enumerate(items):
        if not item.auto_continue:
            draft.error(item.place, "autocontinue off (wait for the operator) is not supported")
        if item.command == CHANGE_SPEED:
            speed = _speed(draft, item, speed)
            if i > last:
                draft.error(item.place, f"{item.name}: no waypoint follows")
        elif item.command in POSITIONS:
            _position(draft, item, speed, is_last=i == last)
        else:
            draft.error(item.place, f"{item.name} is not supported: delete the item{INSTEAD.get(item.command, '')}")


def _speed(draft: Draft, item: MissionItem, before: float | None) -> float | None:
    """Speed [m/s] after a DO_CHANGE_SPEED: param 1 type, param 2 speed (-1: no change), param 3 throttle."""
    if item.param(1) not in (0.0, 1.0):
        draft.error(item.place, f"{item.name}: speed type {item.param(1):g} is not supported, only 0 and 1")
    if item.param(3) > 0:
        draft.error(item.place, f"{item.name}: a throttle setting is not supported")
    speed = item.params[1]
    if speed == -1:
        return before
    if speed is None or not speed > 0:
        draft.error(item.place, f"{item.name}: speed must be positive, not {speed}")
        return before
    return speed


def _position(draft: Draft, item: MissionItem, speed: float | None, *, is_last: bool) -> None:
    """A waypoint. Param 1 hold s, 2 acceptance m, 3 pass-by or circle radius m, 4 yaw deg, 5-6 position."""
    if item.frame not in FRAMES:
        draft.error(item.place, f"frame {item.frame} is not supported, only global ones {FRAMES}")
        return
    if item.command == WAYPOINT:
        if item.param(1) != 0.0 and not is_last:
            draft.error(item.place, f"{item.name}: a hold time is supported only at the last waypoint")
        if item.param(3) != 0.0:
            draft.error(item.place, f"{item.name}: a pass-by radius is not supported")
    else:
        if not is_last:
            draft.error(item.place, f"{item.name} is supported only as the last position")
        if item.param(3) != 0.0:
            draft.error(item.place, f"{item.name}: circling is not supported, the radius must be 0")
    if item.param(4) != 0.0 and not is_last:
        draft.error(item.place, f"{item.name}: a yaw angle is supported only at the last waypoint")
    elif item.param(4) != 0.0:
        draft.heading(item.place, item.param(4), from_north=True)
    acceptance = (item.param(2) or None) if item.command == WAYPOINT else None
    at = draft.position(item.place, item.params[4], item.params[5])
    if at:
        draft.waypoint(item.place, Waypoint(*at, speed, acceptance))


# --- .plan ------------------------------------------------------------------------------------------


class _Item(msgspec.Struct):
    type: str
    command: int | None = None
    frame: int | None = None
    params: list[float | None] | None = None
    autoContinue: bool = True
    complexItemType: str = ""


class _Mission(msgspec.Struct):
    items: list[_Item]


class _Polygon(msgspec.Struct, forbid_unknown_fields=True):
    inclusion: bool
    polygon: list[tuple[float, float]]
    version: int = 1


class _GeoFence(msgspec.Struct, forbid_unknown_fields=True):
    circles: list[dict] = []
    polygons: list[_Polygon] = []
    version: int = 2
    breachReturn: list[float] | None = None


class _Rally(msgspec.Struct, forbid_unknown_fields=True):
    points: list[list[float | None]] = []
    version: int = 2


class _Plan(msgspec.Struct, forbid_unknown_fields=True):
    fileType: str
    mission: _Mission
    version: int
    geoFence: _GeoFence = msgspec.field(default_factory=_GeoFence)
    rallyPoints: _Rally = msgspec.field(default_factory=_Rally)
    groundStation: str = ""


def read_plan(draft: Draft, text: str) -> None:
    """A QGroundControl .plan, version 1, into the draft."""
    try:
        plan = msgspec.json.decode(text, type=_Plan)
    except msgspec.ValidationError as error:
        draft.schema_error("", error)
        return
    except msgspec.DecodeError as error:
        draft.error("(file)", f"not valid JSON: {error}")
        return
    if (plan.fileType, plan.version) != ("Plan", 1):
        draft.error("(file)", f"is a {plan.fileType!r} of version {plan.version}, not a 'Plan' of version 1")
        return
    read_items(draft, _simple_items(draft, plan.mission.items))
    for i, fence in enumerate(plan.geoFence.polygons):
        place = f"geoFence.polygons[{i}]"
        corners = [draft.position(f"{place}.polygon[{k}]", *at) for k, at in enumerate(fence.polygon)]
        draft.fence(place, fence.inclusion, corners)
    for i in range(len(plan.geoFence.circles)):
        draft.error(f"geoFence.circles[{i}]", "a circular fence is not supported, use a polygon")
    if plan.geoFence.breachReturn is not None:
        draft.error("geoFence.breachReturn", "a return point is not supported: a breach ends in a hold")
    for i in range(len(plan.rallyPoints.points)):
        draft.error(f"rallyPoints.points[{i}]", "rally points are not supported")


def _simple_items(draft: Draft, found: list[_Item]) -> list[MissionItem]:
    items = []
    for i, item in enumerate(found):
        place = f"mission.items[{i}]"
        if item.type != "SimpleItem":
            draft.error(place, f"{item.type} {item.complexItemType}".rstrip() + " is not supported")
        elif item.command is None or item.frame is None or item.params is None or len(item.params) != 7:
            draft.error(place, "needs command, frame and 7 params")
        else:
            items.append(MissionItem(place, item.command, item.frame, tuple(item.params), item.autoContinue))
    return items


# --- .waypoints -------------------------------------------------------------------------------------


def read_waypoints(draft: Draft, text: str) -> None:
    """A QGC WPL 110 file into the draft. Item 0 is home: it must be there, and is not driven to.

    Files that programs without a home write begin with their first waypoint instead: it would be left out.
    """
    lines = text.splitlines()
    if not lines or lines[0].split() != ["QGC", "WPL", "110"]:
        draft.error("line 1", f"expected 'QGC WPL 110', found {lines[0][:40] if lines else 'nothing'!r}")
        return
    items: list[MissionItem] = []
    count = 0
    for number, line in enumerate(lines[1:], start=2):
        if line.strip() and not line.startswith("#"):
            item = _waypoints_line(draft, f"line {number} (item {count})", line, count)
            if item and count > 0:
                items.append(item)
            elif item and (item.command != WAYPOINT or item.frame not in HOME_FRAMES):
                found = (
                    f"is {item.name} in frame {item.frame}, not home (command 16 in frame 0), and would not be driven"
                )
                draft.error(item.place, f"{found}: put a line for home before it, and number the items anew")
            count += 1
    read_items(draft, items)


def _waypoints_line(draft: Draft, place: str, line: str, index: int) -> MissionItem | None:
    """index, current, frame, command, param 1-4, latitude, longitude, altitude, autocontinue."""
    fields = line.split()
    if len(fields) != 12:
        draft.error(place, f"expected 12 fields, found {len(fields)}")
        return None
    try:
        seq, _, frame, command, auto = (int(fields[k]) for k in (0, 1, 2, 3, 11))
        params = tuple(None if math.isnan(p) else p for p in map(float, fields[4:11]))
    except ValueError as error:
        draft.error(place, str(error))
        return None
    if seq != index:
        draft.error(place, f"has index {seq}")
        return None
    return MissionItem(place, command, frame, params, auto != 0)
