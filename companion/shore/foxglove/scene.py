"""Telemetry as Foxglove draws it: the scene of its 3D panel, and the place on the earth of its map panel.

Schemas are those of foxglove-sdk (https://docs.foxglove.dev/docs/sdk/schemas): SceneUpdate in frame `ned` (x north,
y east, z down, site axes), LocationFix with a covariance in east, north, up. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from foxglove.messages import (
    Color,
    Duration,
    LinePrimitive,
    LinePrimitiveLineType,
    LocationFix,
    LocationFixPositionCovarianceType,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
)

from companion.core.geometry.frames import R2, Origin, geodetic_from_site
from companion.core.geometry.rep103 import map_from_site
from companion.core.telemetry import structs as shore
from companion.logs.series import KNOWN

CHI2_95 = 5.991
"""95 % of a normal distribution in two dimensions lie within this squared distance."""
ELLIPSE_POINTS = 48
SILENT_S = 3
"""A hull of which nothing new is heard for this long is drawn no more [s]; assumed."""
ABOVE_M = -0.05
"""Down coordinate of the hull [m]: so little above the plane of the grid that the two do not flicker."""
DECK = ((1.0, 0.0), (0.72, 0.72), (0.35, 1.0), (-1.0, 0.92), (-1.0, -0.92), (0.35, -1.0), (0.72, -0.72))
"""Outline of the hull in half lengths and half beams, as the console draws it."""
INSIDE, OUTSIDE = Color(r=0.9, g=0.6, b=0.1, a=1.0), Color(r=0.85, g=0.2, b=0.2, a=1.0)
PATH, ANCHOR = Color(r=0.2, g=0.55, b=0.9, a=1.0), Color(r=0.55, g=0.35, b=0.75, a=1.0)
HULL, RIM = Color(r=0.2, g=0.7, b=0.4, a=0.8), Color(r=0.1, g=0.4, b=0.2, a=1.0)
ELLIPSE = Color(r=0.2, g=0.7, b=0.4, a=0.9)


def scene(sample: shore.ShoreMessage, about: shore.About | None, unix_ns: int) -> SceneUpdate | None:
    """What a sample changes in the scene: fence and anchors, path, or hull and ellipse; None: nothing.

    `about`: of the same boat, if it was heard: without the size in it there is no hull. `unix_ns`: stamp of the sample.
    """
    stamp = Timestamp(*divmod(unix_ns, 1_000_000_000))
    match sample:
        case shore.About():
            return SceneUpdate(entities=[_fence(sample, stamp), _anchors(sample, stamp)])
        case shore.PathNow():
            return SceneUpdate(entities=[_path(sample, stamp)])
        case shore.StateNow() if sample.health in KNOWN:
            return SceneUpdate(entities=[*_hull(sample, about, stamp), _ellipse(sample, stamp)])
    return None


def location(state: shore.StateNow, about: shore.About, frame: str, unix_ns: int) -> LocationFix | None:
    """The body origin on the earth, at altitude 0 (nobody measures it); None while the place is not known.

    `frame`: name of the boat's own frame. Heading clockwise from true north [rad], velocity over ground [m/s].
    """
    if state.health not in KNOWN:
        return None
    turn = math.radians(about.rotation_deg)
    latitude, longitude = geodetic_from_site(Origin(about.lat_deg, about.lon_deg, turn), state.north_m, state.east_m)
    heading = state.psi_rad + turn
    north_m_s, east_m_s = R2(heading) @ (state.u_m_s, state.v_m_s)
    site, covariance = map_from_site(turn)[:2, :2], np.zeros((3, 3))
    covariance[:2, :2] = site @ _horizontal(state) @ site.T
    return LocationFix(
        timestamp=Timestamp(*divmod(unix_ns, 1_000_000_000)),
        frame_id=frame,
        latitude=latitude,
        longitude=longitude,
        position_covariance=covariance.ravel().tolist(),
        position_covariance_type=LocationFixPositionCovarianceType.Approximated,
        heading=heading % math.tau,
        velocity=Vector3(x=float(east_m_s), y=float(north_m_s)),
    )


def _horizontal(state: shore.StateNow) -> np.ndarray:
    """Covariance of north and east, site axes, shape (2, 2) [m^2]."""
    return np.array(shore.square(state.covariance))[:2, :2]


def _fence(about: shore.About, stamp: Timestamp) -> SceneEntity:
    rings = [*((ring, INSIDE) for ring in about.within), *((ring, OUTSIDE) for ring in about.without)]
    lines = [_line(ring, color, LinePrimitiveLineType.LineLoop) for ring, color in rings]
    return SceneEntity(timestamp=stamp, frame_id="ned", id="fence", lines=lines)


def _anchors(about: shore.About, stamp: Timestamp) -> SceneEntity:
    places = [(a.north_m, a.east_m) for a in about.anchors]
    names = [
        TextPrimitive(pose=_pose((n, e + 0.6)), billboard=True, font_size=0.6, color=ANCHOR, text=a.id)
        for a, (n, e) in zip(about.anchors, places, strict=True)
    ]
    return SceneEntity(timestamp=stamp, frame_id="ned", id="anchors", spheres=_dots(places, 0.4, ANCHOR), texts=names)


def _path(path: shore.PathNow, stamp: Timestamp) -> SceneEntity:
    places = [(w.north_m, w.east_m) for w in path.waypoints]
    line = _line(places, PATH, LinePrimitiveLineType.LineStrip)
    return SceneEntity(timestamp=stamp, frame_id="ned", id="path", lines=[line], spheres=_dots(places, 0.25, PATH))


def _hull(state: shore.StateNow, about: shore.About | None, stamp: Timestamp) -> Iterable[SceneEntity]:
    if about is None or about.length_m is None or about.beam_m is None:
        return
    points = [Point3(x=x * about.length_m / 2, y=y * about.beam_m / 2, z=ABOVE_M) for x, y in DECK]
    fan = [k for second in range(1, len(points) - 1) for k in (0, second, second + 1)]
    pose = _pose((state.north_m, state.east_m), state.psi_rad)
    rim = LinePrimitive(
        type=LinePrimitiveLineType.LineLoop, pose=pose, points=points, color=RIM, thickness=2.0, scale_invariant=True
    )
    deck = TriangleListPrimitive(pose=pose, points=points, color=HULL, indices=fan)
    yield SceneEntity(
        timestamp=stamp, frame_id="ned", id="hull", lifetime=Duration(SILENT_S), triangles=[deck], lines=[rim]
    )


def _ellipse(state: shore.StateNow, stamp: Timestamp) -> SceneEntity:
    """Where the boat is with 95 % probability."""
    squares, axes = np.linalg.eigh(_horizontal(state))
    angles = np.linspace(0.0, math.tau, ELLIPSE_POINTS, endpoint=False)
    round_ = np.sqrt(CHI2_95 * np.clip(squares, 0.0, None))[:, None] * (np.cos(angles), np.sin(angles))
    places = (axes @ round_).T + (state.north_m, state.east_m)
    line = _line(places.tolist(), ELLIPSE, LinePrimitiveLineType.LineLoop)
    return SceneEntity(timestamp=stamp, frame_id="ned", id="ellipse", lifetime=Duration(SILENT_S), lines=[line])


def _line(places: Iterable[shore.Place], color: Color, kind: LinePrimitiveLineType) -> LinePrimitive:
    points = [Point3(x=north, y=east) for north, east in places]
    return LinePrimitive(type=kind, points=points, color=color, thickness=2.0, scale_invariant=True)


def _dots(places: Iterable[shore.Place], size_m: float, color: Color) -> list[SpherePrimitive]:
    size = Vector3(x=size_m, y=size_m, z=size_m)
    return [SpherePrimitive(pose=_pose(place), size=size, color=color) for place in places]


def _pose(place: shore.Place, psi_rad: float = 0.0) -> Pose:
    turned = Quaternion(z=math.sin(psi_rad / 2), w=math.cos(psi_rad / 2))
    return Pose(position=Vector3(x=place[0], y=place[1]), orientation=turned)
