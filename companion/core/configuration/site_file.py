"""The site file: where the boat floats. Origin, fence, UWB anchors.

Site axes are NED with the origin at a chosen corner: north along `rotation_deg` from true north where the
basin is not aligned with it. Tags that compute positions themselves are set up in site ENU (x east, y north,
z up), the right-handed frame that their vendors ask for.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np

from companion.core.configuration.tables import ConfigError, SourcedTable, parse_toml
from companion.core.geometry.fence import clearance, crossing


class Anchor(SourcedTable, frozen=True, kw_only=True):
    """One UWB anchor. `down_m` is negative above the water."""

    id: str
    north_m: float
    east_m: float
    down_m: float


class Site(SourcedTable, frozen=True, kw_only=True):
    """One site. `fence`: closed polygon of (north, east) [m] that the boat must not leave."""

    name: str
    lat_deg: Annotated[float, msgspec.Meta(ge=-90, le=90)]
    lon_deg: Annotated[float, msgspec.Meta(ge=-180, le=180)]
    rotation_deg: float = 0.0
    fence: Annotated[tuple[tuple[float, float], ...], msgspec.Meta(min_length=3)]
    anchors: tuple[Anchor, ...] = ()

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
    if edges := crossing(site.fence):
        problem = f"the edges that begin at corner {edges[0]} and corner {edges[1]} touch"
        raise ConfigError(f"{name}: fence: {problem}: give each corner once, in order along the fence")
    return site
