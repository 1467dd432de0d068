"""Mission files for the page, read and checked by the boat's own functions: what passes here, the boat would drive."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Callable
from typing import Annotated

import msgspec
from aiohttp import web

from companion.core.geometry.fence import Fence
from companion.core.geometry.frames import Origin
from companion.core.guidance.course import PathLimits
from companion.core.guidance.missions.fitness import unfit_waypoints
from companion.core.guidance.missions.mission import MissionErrors, kind_of, parse
from companion.core.guidance.preview import preview
from companion.core.guidance.reference import GuidanceSettings
from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import MAX_BYTES, MissionFile
from companion.shore.console.requests import BoatName
from companion.shore.console.web_server import read_body


class SiteOrigin(msgspec.Struct, forbid_unknown_fields=True):
    """Where the boat's site lies, as its `about` says."""

    lat_deg: Annotated[float, msgspec.Meta(ge=-90, le=90)]
    lon_deg: Annotated[float, msgspec.Meta(ge=-180, le=180)]
    rotation_deg: float


class MissionToRead(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST /mission. `origin`: null: not known, and files in latitude and longitude are refused."""

    file: MissionFile
    origin: SiteOrigin | None = None


class MissionToCheck(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST /mission/check: a mission in TOML, and the boat that would drive it."""

    file: MissionFile
    boat: BoatName


def check_length(mission: MissionFile | None) -> None:
    """Raises the answer to a mission that is too long for an order."""
    if mission and len(mission.text) > MAX_BYTES:
        raise web.HTTPBadRequest(text=f"missions are at most {MAX_BYTES} bytes long")


async def read_mission(request: web.Request) -> web.Response:
    """A mission file -> its waypoints [m, m/s], heading and fences; or all that is wrong with it, as `errors`."""
    body = await read_body(request, MissionToRead)
    check_length(body.file)
    return web.Response(body=msgspec.json.encode(_read(body)), content_type="application/json")


def add_missions(app: web.Application, about: Callable[[str], shore.About | None]) -> None:
    """Serve reading and checking of missions. `about`: what a boat has reported of itself."""

    async def check(request: web.Request) -> web.Response:
        body = await read_body(request, MissionToCheck)
        check_length(body.file)
        told = await asyncio.to_thread(_check, body.file, about(body.boat))
        return web.Response(body=msgspec.json.encode(told), content_type="application/json")

    app.router.add_post("/mission", read_mission)
    app.router.add_post("/mission/check", check)


def _check(file: MissionFile, boat: shore.About | None) -> dict:
    """What the boat would find wrong, by waypoint (null: of the whole), and the course that it would drive."""
    try:
        mission = parse(file.text, kind_of(file.name), name=file.name)
    except MissionErrors as errors:
        return {"problems": [_problem(_number(error.place), error.reason) for error in errors.errors]}
    if boat is None or boat.guidance is None:
        return {"problems": []}
    given = msgspec.structs.asdict(boat.guidance)
    end = given.pop("end")
    try:
        settings = GuidanceSettings(end=end, limits=PathLimits(**given))
    except ValueError:  # telemetry is anybody's
        return {"problems": []}
    fence = Fence(boat.within, boat.without)
    found = [_problem(i, what) for i, what in unfit_waypoints(mission, fence, settings)] if fence.within else []
    course = preview(mission.path, settings.limits)
    figures = {"course": course.points, "length_m": course.length_m, "duration_s": course.duration_s}
    return {"problems": found, "end": end} | figures


def _number(place: str) -> int | None:
    """Index of the waypoint that an error's place names."""
    found = re.match(r"waypoints\[(\d+)\]", place)
    return int(found[1]) if found else None


def _problem(at: int | None, what: str) -> dict:
    """As the page shows it, which counts waypoints from 1."""
    return {"at": at, "grave": True, "text": f"Waypoint {at + 1} {what}." if at is not None else f"{what}."}


def _read(body: MissionToRead) -> dict:
    at = body.origin
    origin = Origin(at.lat_deg, at.lon_deg, math.radians(at.rotation_deg)) if at else None
    try:
        kind = kind_of(body.file.name)
        mission = parse(body.file.text, kind, origin=origin, name=body.file.name.rsplit(".", 1)[0])
    except MissionErrors as errors:
        return {"errors": [str(error) for error in errors.errors]}
    end = mission.end_heading_rad
    return {
        "name": mission.name,
        "end_heading_deg": None if end is None else math.degrees(end),
        "waypoints": mission.path.waypoints,
        "fences": mission.fences,
    }
