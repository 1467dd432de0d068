"""Mission files for the page: read by the boat's own loader, so that what opens here is what the boat would drive."""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
from aiohttp import web

from companion.core.geometry.frames import Origin
from companion.core.guidance.missions.mission import MissionErrors, kind_of, parse
from companion.core.telemetry.order_gate import MAX_BYTES, MissionFile
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


def check_length(mission: MissionFile | None) -> None:
    """Raises the answer to a mission that is too long for an order."""
    if mission and len(mission.text) > MAX_BYTES:
        raise web.HTTPBadRequest(text=f"missions are at most {MAX_BYTES} bytes long")


async def read_mission(request: web.Request) -> web.Response:
    """A mission file -> its waypoints [m, m/s], heading and fences; or all that is wrong with it, as `errors`."""
    body = await read_body(request, MissionToRead)
    check_length(body.file)
    return web.Response(body=msgspec.json.encode(_read(body)), content_type="application/json")


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
