"""Mission text -> Mission, or all that is wrong with it, each with its place.

    toml        our own: metres in site axes (keys below); an unknown key is refused
    plan        QGroundControl plan           waypoints   QGC WPL 110           geojson   RFC 7946

The last three hold latitudes and longitudes and need the site's origin. TOML keys: name, end_heading_deg
(from the site's first axis), [[waypoints]] north_m, east_m, speed_m_s (of the leg that leads there),
acceptance_m, and [[fences]] inclusion, polygon = [[north_m, east_m], ...].
"""

from __future__ import annotations

from typing import Literal, TypeVar, get_args

import msgspec

from companion.core.configuration.file_kinds import MISSION
from companion.core.configuration.ranges import problems
from companion.core.configuration.tables import ConfigError, Table, refuse_other_kind, toml_of_text
from companion.core.geometry.frames import Origin
from companion.core.guidance.missions.draft import Draft, Mission, MissionError, MissionErrors, MissionFence
from companion.core.guidance.missions.geojson import read_geojson
from companion.core.guidance.missions.mavlink_items import read_plan, read_waypoints
from companion.core.guidance.path import Waypoint

__all__ = ["Kind", "Mission", "MissionError", "MissionErrors", "MissionFence", "kind_of", "parse"]

T = TypeVar("T", bound=msgspec.Struct)
Kind = Literal["toml", "plan", "waypoints", "geojson"]


class _Waypoint(Table, frozen=True, kw_only=True):
    north_m: float
    east_m: float
    speed_m_s: float | None = None
    acceptance_m: float | None = None


class _Fence(Table, frozen=True, kw_only=True):
    inclusion: bool
    polygon: list[tuple[float, float]]


class _File(Table, frozen=True, kw_only=True):
    name: str | None = None
    end_heading_deg: float | None = None
    waypoints: tuple[dict, ...]
    fences: tuple[dict, ...] = ()


def kind_of(file_name: str) -> Kind:
    """Format by the end of the file's name (.json is GeoJSON). Raises MissionErrors."""
    suffix = file_name.rsplit(".", 1)[-1].lower()
    suffix = "geojson" if suffix == "json" else suffix
    for kind in get_args(Kind):
        if suffix == kind:
            return kind
    known = ", ".join(f".{kind}" for kind in get_args(Kind))
    raise MissionErrors([MissionError(file_name, f"is not a mission file: expected one of {known}")])


def parse(text: str, kind: Kind, *, origin: Origin | None = None, name: str = "mission") -> Mission:
    """Mission text -> Mission, called `name` where the file gives none. Raises MissionErrors."""
    draft = Draft(origin)
    if kind == "toml":
        name = _read_toml(draft, text) or name
    else:
        {"plan": read_plan, "waypoints": read_waypoints, "geojson": read_geojson}[kind](draft, text)
    return draft.finish(name)


def _read_toml(draft: Draft, text: str) -> str | None:
    """Our own format into the draft; returns the mission's name, if it has one."""
    try:
        document = toml_of_text(text, name="(file)")
        refuse_other_kind(document, MISSION, name="(file)")
        file = _converted(draft, "", document, _File)
    except ConfigError as error:
        draft.error("(file)", str(error).removeprefix("(file): "))
        return None
    if file is None:
        return None
    draft.heading("end_heading_deg", file.end_heading_deg, from_north=False)
    for i, table in enumerate(file.waypoints):
        if w := _converted(draft, f"waypoints[{i}]", table, _Waypoint):
            draft.waypoint(f"waypoints[{i}]", Waypoint(w.north_m, w.east_m, w.speed_m_s, w.acceptance_m))
    for i, table in enumerate(file.fences):
        if fence := _converted(draft, f"fences[{i}]", table, _Fence):
            draft.fence(f"fences[{i}]", fence.inclusion, fence.polygon)
    return file.name


def _converted(draft: Draft, place: str, table: dict, kind: type[T]) -> T | None:
    """One table of the file; None, and what is wrong in the draft, where it is none."""
    wrong = [problem.partition(": ") for problem in problems(table, kind)]
    for key, _, what in wrong:
        draft.error(f"{place}.{key}" if place else key, what)
    if wrong:
        return None
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        draft.schema_error(place, error)
        return None
