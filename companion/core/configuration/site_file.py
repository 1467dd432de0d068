"""The site file: where the boat floats. Origin, fence, UWB anchors.

Site axes are NED with the origin at a chosen corner: north along `rotation_deg` from true north where the
basin is not aligned with it. Tags that compute positions themselves are set up in site ENU (x east, y north,
z up), the right-handed frame that their vendors ask for.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec
import numpy as np

from companion.core.configuration import file_kinds
from companion.core.configuration.tables import ConfigError, SourcedTable, parse_toml
from companion.core.geometry.anchors import SAME_PLACE_M, in_one_place, on_one_another
from companion.core.geometry.fence import FARTHEST_CORNER_M, MOST_CORNERS, ONCE, clearance, crossing, enclosed_m2

Metres = Annotated[float, msgspec.Meta(ge=-FARTHEST_CORNER_M, le=FARTHEST_CORNER_M)]
"""A place in site axes [m]."""
LEAST_FENCE_M2 = 1.0
"""Less is no water that a boat fits in; assumed."""


class Anchor(SourcedTable, frozen=True, kw_only=True):
    """One UWB anchor. `down_m` is negative above the water."""

    id: str
    north_m: Metres
    east_m: Metres
    down_m: Annotated[float, msgspec.Meta(ge=-200, le=200)]


class Site(SourcedTable, frozen=True, kw_only=True):
    """One site. `fence`: closed polygon of (north, east) [m] that the boat must not leave."""

    FILE: ClassVar = file_kinds.SITE
    name: str
    lat_deg: Annotated[float, msgspec.Meta(ge=-90, le=90)]
    lon_deg: Annotated[float, msgspec.Meta(ge=-180, le=180)]
    rotation_deg: Annotated[float, msgspec.Meta(ge=-360, le=360)] = 0.0
    fence: Annotated[tuple[tuple[Metres, Metres], ...], msgspec.Meta(min_length=3)]
    anchors: Annotated[tuple[Anchor, ...], msgspec.Meta(max_length=64)] = ()

    @property
    def anchors_m(self) -> np.ndarray:
        """Places of the anchors, NED, shape (m, 3) [m]."""
        return np.array([(a.north_m, a.east_m, a.down_m) for a in self.anchors]).reshape(-1, 3)

    def inside(self, north_m: float, east_m: float) -> bool:
        """Whether a place lies within the fence, not on its edge."""
        return bool(clearance(np.array(self.fence), np.array([[north_m, east_m]]))[0] > 0)


def load_site(text: str, *, name: str) -> Site:
    """Site file text -> Site. Raises ConfigError naming file and key."""
    site = parse_toml(text, Site, name=name)
    ids = [a.id for a in site.anchors]
    for i, anchor in enumerate(ids):
        if anchor in ids[:i]:
            raise ConfigError(f"{name}: anchors[{i}].id: anchor {anchor!r} is there twice")
    if same := on_one_another(site.anchors_m):
        first, second = (site.anchors[i].id for i in same)
        raise ConfigError(f"{name}: anchors[{same[1]}]: {second!r} stands where {first!r} does: measure again")
    if in_one_place(site.anchors_m):
        problem = f"all stand within {SAME_PLACE_M} m of one another: no position follows"
        raise ConfigError(f"{name}: anchors: {problem}: spread them around the water")
    if len(site.fence) > MOST_CORNERS:
        problem = f"{len(site.fence)} corners; expected at most {MOST_CORNERS}"
        raise ConfigError(f"{name}: fence: {problem}: leave out those that lie nearly on a line with their neighbours")
    if edges := crossing(site.fence):
        problem = f"the edges that begin at corner {edges[0]} and corner {edges[1]} touch"
        raise ConfigError(f"{name}: fence: {problem}: {ONCE}")
    if (m2 := enclosed_m2(site.fence)) < LEAST_FENCE_M2:
        raise ConfigError(f"{name}: fence: encloses {m2:g} m^2; expected at least {LEAST_FENCE_M2:g}")
    return site
