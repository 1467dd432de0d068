"""A mission while it is read: waypoints and fences with their places in the file, and every error found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeGuard

import msgspec

from companion.core.configuration.tables import found_wrong
from companion.core.geometry.fence import FARTHEST_CORNER_M, MOST_CORNERS, ONCE, crossing
from companion.core.geometry.frames import Origin, site_from_geodetic
from companion.core.guidance.path import Path, Waypoint, path_problems

FARTHEST_M = 2000.0
"""A waypoint farther from the origin is taken for a mistake; flat earth errs by 0.6 m there (assumed)."""


@dataclass(frozen=True)
class MissionError:
    """One thing wrong with a mission file: where, and what."""

    place: str
    reason: str

    def __str__(self) -> str:
        return f"{self.place}: {self.reason}"


class MissionErrors(ValueError):
    """Everything found wrong with a mission file."""

    def __init__(self, errors: Sequence[MissionError]) -> None:
        super().__init__("\n".join(map(str, errors)))
        self.errors = tuple(errors)


@dataclass(frozen=True)
class MissionFence:
    """A polygon of (north, east) [m], site axes, to stay in (`inclusion`) or out of."""

    inclusion: bool
    polygon: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Mission:
    """What a mission file asks for. `end_heading_rad`: site axes; None: that of the last leg."""

    name: str
    path: Path
    end_heading_rad: float | None = None
    fences: tuple[MissionFence, ...] = ()


@dataclass
class Draft:
    """Collects waypoints, fences and errors; `finish` makes the Mission or raises them all."""

    origin: Origin | None = None
    errors: list[MissionError] = field(default_factory=list)
    places: list[str] = field(default_factory=list)
    waypoints: list[Waypoint] = field(default_factory=list)
    fences: list[MissionFence] = field(default_factory=list)
    end_heading_rad: float | None = None

    def error(self, place: str, reason: str) -> None:
        """Note one error."""
        self.errors.append(MissionError(place, reason))

    def schema_error(self, prefix: str, error: msgspec.ValidationError) -> None:
        """Note what msgspec found, its path behind `prefix`: `waypoints[1].speed: unknown key`."""
        place, what = found_wrong(error)
        self.error(".".join(part for part in (prefix, place) if part) or "(file)", what)

    def waypoint(self, place: str, waypoint: Waypoint) -> None:
        """Add a waypoint."""
        self.places.append(place)
        self.waypoints.append(waypoint)

    def heading(self, place: str, heading_deg: float | None, *, from_north: bool) -> None:
        """Set the heading at the end, degrees clockwise from true north or from the site's first axis."""
        if heading_deg is None:
            return
        if not _within(heading_deg, 360.0):
            self.error(place, f"heading: expected -360 to 360 deg, found {heading_deg:g}")
            return
        turned = self.origin.rotation_rad if from_north and self.origin else 0.0
        self.end_heading_rad = math.fmod(math.radians(heading_deg) - turned, math.tau)

    def position(self, place: str, latitude: object, longitude: object) -> tuple[float, float] | None:
        """Latitude, longitude [deg] -> (north, east) [m], site axes; None, and an error, where it is none."""
        if not _within(latitude, 90.0) or not _within(longitude, 180.0):
            swapped = self._hint_if_swapped(latitude, longitude)
            self.error(place, f"latitude {latitude}, longitude {longitude} is not a position{swapped}")
            return None
        if self.origin is None:
            self.error(place, "latitude and longitude need the site's origin, and no site was given")
            return None
        north, east = site_from_geodetic(self.origin, latitude, longitude)
        away = math.hypot(north, east)
        if away > FARTHEST_M:
            swapped = self._hint_if_swapped(latitude, longitude)
            remedy = f"plan it there, or set lat_deg, lon_deg of the site file{swapped}"
            away_km = f"{away / 1000:.1f} km"
            self.error(place, f"is {away_km} from the site's origin, farther than {FARTHEST_M:g} m: {remedy}")
            return None
        return north, east

    def _hint_if_swapped(self, latitude: object, longitude: object) -> str:
        """What to say where the place lies at the site with its two numbers exchanged; else nothing."""
        if self.origin is None or not _within(longitude, 90.0) or not _within(latitude, 180.0):
            return ""
        near = math.hypot(*site_from_geodetic(self.origin, longitude, latitude)) <= FARTHEST_M
        return "; it would be there with latitude and longitude exchanged" if near else ""

    def fence(self, place: str, inclusion: bool, corners: Sequence[tuple[float, float] | None]) -> None:
        """Add a fence; a corner that is None has been reported already."""
        if len(corners) < 3:
            self.error(place, f"a fence needs at least 3 corners, not {len(corners)}")
        polygon = tuple(c for c in corners if c is not None)
        if not all(math.isfinite(x) for corner in polygon for x in corner):
            self.error(place, "has a corner that is not finite")
        elif any(abs(x) > FARTHEST_CORNER_M for corner in polygon for x in corner):
            self.error(place, f"has a corner more than {FARTHEST_CORNER_M:g} m north or east of the site's origin")
        elif len(polygon) + sum(len(fence.polygon) for fence in self.fences) > MOST_CORNERS:
            self.error(place, f"{len(polygon)} corners; the fences of a mission may have {MOST_CORNERS} together")
        elif len(polygon) > 2 and (edges := crossing(polygon)):
            self.error(place, f"the edges that begin at corner {edges[0]} and corner {edges[1]} touch: {ONCE}")
        self.fences.append(MissionFence(inclusion, polygon))

    def finish(self, name: str) -> Mission:
        """The mission. Raises MissionErrors with everything found wrong."""
        problems = path_problems(tuple(self.waypoints))
        if self.waypoints:
            for i, reason in problems:
                self.error(self.places[i], reason)
        elif not self.errors:
            self.error("(file)", problems[0][1])
        if self.errors:
            raise MissionErrors(self.errors)
        return Mission(name, Path(tuple(self.waypoints)), self.end_heading_rad, tuple(self.fences))


def _within(value: object, most: float) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= most
