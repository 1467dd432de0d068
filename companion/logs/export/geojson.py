"""The track of a log on the earth: GeoJSON (RFC 7946, longitude before latitude, WGS84), as QGIS and others read it.

Features, distinguished by their property `kind`:

    track       the estimate, a line a piece: broken where the boat did not know its place or the log has a gap
    truth       the simulator's, where its log is given
    mission     the path that was to be driven, one for every mission loaded
    state       a point a second: time, speeds, heading from true north, mode
    alert       a point where the boat was when it said something
    fence       polygons;  anchor: points

QGIS makes a layer of each kind of geometry. Latitudes and longitudes are rounded to 1e-8 degrees (1 mm).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

from companion.core.configuration.site_file import Site
from companion.core.geometry.frames import Origin, geodetic_from_site
from companion.core.messages import (
    Alert,
    GroundTruth,
    Message,
    ModeStatus,
    NewMission,
    StateEstimate,
)
from companion.logs.configuration import setup_in, zero_ns_of
from companion.logs.log_file import LogError, LogFile
from companion.logs.metadata import site_in
from companion.logs.series import GAP_S, KNOWN

DECIMALS = 8
Place = tuple[float, float]
Feature = dict[str, Any]


def features(log: LogFile, site: Site | None = None, truth: LogFile | None = None) -> list[Feature]:
    """All features of a log. `site`: instead of the log's own; `truth`: the simulator's log of the same run.

    Raises LogError: the position of the site's origin is unknown, or the log has no position estimate; ConfigError: the
    log's own site file is refused.
    """
    site = site or site_in(log.metadata, log.path)
    if site is None:
        reason = "holds no site file, so nobody knows where on the earth its origin lies: name one with --site FILE"
        raise LogError(f"{log.path}: {reason}")
    drawn = _Drawing(site, zero_ns_of(log), log.wall_offset_ns)
    for message in log.messages(StateEstimate, ModeStatus, Alert, NewMission):
        drawn.see(message)
    if not drawn.track.pieces:
        raise LogError("; ".join([f"{log.path}: no estimate of a place in it: there is no track", *log.damage]))
    for message in truth.messages(GroundTruth) if truth else ():
        drawn.see(message)
    return drawn.features(_first_mission(log))


def _first_mission(log: LogFile) -> list[Place]:
    """Waypoints of the mission that the run began with; none where the log does not hold it."""
    try:
        mission = setup_in(log).pilot.mission
    except (LogError, ValueError):
        return []
    return [(w.north_m, w.east_m) for w in mission.path.waypoints]


class _Line:
    """Positions in segments: a new one after a gap."""

    def __init__(self) -> None:
        self.pieces: list[list[Place]] = []
        self.t_ns = 0

    def add(self, t_ns: int, place: Place) -> None:
        if not self.pieces or t_ns - self.t_ns > GAP_S * 1e9:
            self.pieces.append([])
        self.t_ns = t_ns
        self.pieces[-1].append(place)

    def lost(self) -> None:
        """The next position begins a new segment."""
        self.t_ns = 0


class _Drawing:
    def __init__(self, site: Site, zero_ns: int, wall_offset_ns: int) -> None:
        self._site, self._zero_ns, self._offset_ns = site, zero_ns, wall_offset_ns
        self._origin = Origin(site.lat_deg, site.lon_deg, math.radians(site.rotation_deg))
        self.track, self._truth = _Line(), _Line()
        self._points: list[Feature] = []
        self._missions: list[tuple[str, list[Place]]] = []
        self._place: Place | None = None
        self._mode: str | None = None
        self._told_ns = -(10**18)

    def see(self, message: Message) -> None:
        """Note one message, in the order written."""
        match message:
            case StateEstimate():
                self._estimate(message)
            case GroundTruth():
                self._truth.add(message.t_ns, (message.north_m, message.east_m))
            case ModeStatus():
                self._mode = message.mode
            case NewMission():
                self._missions.append((message.name, [(w.north_m, w.east_m) for w in message.waypoints]))
            case Alert() if self._place:
                properties = {"kind": "alert", **self._when(message.t_ns), "level": message.level, "text": message.text}
                self._points.append(self._feature("Point", self._at(self._place), properties))

    def features(self, first_mission: list[Place]) -> list[Feature]:
        """Everything seen, lines first."""
        out = [*self._lines("track", self.track), *self._lines("truth", self._truth)]
        for name, places in (("mission of the run file", first_mission), *self._missions):
            if len(places) > 1:
                properties = {"kind": "mission", "name": name}
                out.append(self._feature("LineString", self._all(places), properties))
        ring = _counterclockwise(self._all(self._site.fence))
        out.append(self._feature("Polygon", [ring], {"kind": "fence", "name": self._site.name}))
        for a in self._site.anchors:
            properties = {"kind": "anchor", "name": a.id, "down_m": a.down_m}
            out.append(self._feature("Point", self._at((a.north_m, a.east_m)), properties))
        return out + self._points

    def _estimate(self, e: StateEstimate) -> None:
        if e.health not in KNOWN:
            self.track.lost()
            return
        self._place = (e.north_m, e.east_m)
        self.track.add(e.t_ns, self._place)
        if e.t_ns - self._told_ns < 1e9:
            return
        self._told_ns = e.t_ns
        heading = math.degrees(e.psi_rad) + self._site.rotation_deg
        properties = {
            "kind": "state",
            **self._when(e.t_ns),
            "heading_deg": round(heading % 360.0, 2) % 360.0,
            "u_m_s": round(e.u_m_s, 4),
            "v_m_s": round(e.v_m_s, 4),
            "r_rad_s": round(e.r_rad_s, 5),
            "position_sigma_m": round(math.sqrt(max(e.covariance[0], e.covariance[7], 0.0)), 4),
            "health": e.health,
            "mode": self._mode,
        }
        self._points.append(self._feature("Point", self._at(self._place), properties))

    def _when(self, t_ns: int) -> dict[str, Any]:
        """`t_s` since the log's first message; `time`, ISO 8601, null where the log does not know the wall clock."""
        time = None
        if self._offset_ns:
            time = datetime.fromtimestamp((t_ns + self._offset_ns) / 1e9, UTC).isoformat(timespec="milliseconds")
        return {"t_s": round((t_ns - self._zero_ns) / 1e9, 3), "time": time}

    def _lines(self, kind: str, line: _Line) -> Iterable[Feature]:
        for number, piece in enumerate(line.pieces):
            if len(piece) > 1:
                yield self._feature("LineString", self._all(piece), {"kind": kind, "piece": number})

    def _at(self, place: Place) -> list[float]:
        lat, lon = geodetic_from_site(self._origin, *place)
        return [round(lon, DECIMALS), round(lat, DECIMALS)]

    def _all(self, places: Sequence[Place]) -> list[list[float]]:
        return [self._at(place) for place in places]

    @staticmethod
    def _feature(geometry: str, coordinates: Any, properties: dict[str, Any]) -> Feature:
        shape = {"type": geometry, "coordinates": coordinates}
        return {"type": "Feature", "geometry": shape, "properties": properties}


def collection(name: str, found: Sequence[Feature], encode: Callable[[Any], bytes]) -> bytes:
    """The file: one feature a line."""
    lines = b",\n".join(encode(feature) for feature in found)
    return b'{"type":"FeatureCollection","name":' + encode(name) + b',"features":[\n' + lines + b"\n]}\n"


def _counterclockwise(ring: list[list[float]]) -> list[list[float]]:
    """Closed, and turning left, as RFC 7946 wants the outer ring of a polygon."""
    closed = [*ring, ring[0]]
    area = sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in pairwise(closed))
    return closed if area > 0 else closed[::-1]
