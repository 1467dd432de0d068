"""A circle in which all damping of the hull is larger: D (1 + share w), w = 1 / (1 + exp((d - radius) / edge))."""

from __future__ import annotations

from typing import Any

from companion.core.model.effects.elementwise import library
from companion.core.model.effects.term import LoadParameter, Term, Values

EDGE_M = 0.5
"""How fast the bottom rises, assumed; that does not go with the size of the zone."""


def damping_factor(p: Values, eta: Any) -> Any:
    """1 + share w at eta, w from 1 inside to 0 outside: 1 / (1 + exp(-x)) as (1 + tanh(x / 2)) / 2 cannot overflow."""
    lib = library(eta[0], *p.values())
    d = lib.sqrt((eta[0] - p["north_m"]) ** 2 + (eta[1] - p["east_m"]) ** 2 + 1e-12)
    return 1 + p["share"] * (1 + lib.tanh((p["radius_m"] - d) / (2 * p["edge_m"]))) / 2


TERM = Term(
    "shallow_zone",
    "D (1 + share w), w = 1 / (1 + exp((d - radius) / edge)); d: distance to the middle of the zone",
    (
        LoadParameter("north_m", "m", 0.0, -1000.0, 1000.0, "middle of the zone, site axes"),
        LoadParameter("east_m", "m", 0.0, -1000.0, 1000.0, "the same, east"),
        LoadParameter("radius_m", "m", 1.0, 0.01, 1000.0, "where half of it is felt"),
        LoadParameter("share", "1", 0.0, -0.9, 20.0, "extra damping inside over that outside"),
        LoadParameter("edge_m", "m", EDGE_M, 0.01, 1000.0, "width of its edge"),
    ),
    damping_factor=damping_factor,
)
