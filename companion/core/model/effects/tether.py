"""A line to an anchor, fastened on the boat's centreline: a spring that does not push.

F = k max(1 - slack / d, 0) (p_anchor - p_t),  p_t = p + R(psi) [x_t 0],  d = |p_anchor - p_t|,  N = x_t Y
"""

from __future__ import annotations

from typing import Any

from companion.core.geometry.frames import point_position, unrotate
from companion.core.model.effects.elementwise import library
from companion.core.model.effects.term import LoadParameter, Term, Values


def spring(pull_N: tuple[Any, Any], k_N_m: Any, x_t_m: Any, eta: Any) -> tuple[Any, Any, Any]:
    """Body force [N, N, N m] at x_t of a spring without slack that pulls by `pull_N` (north, east) at eta = 0."""
    north_m, east_m = point_position(eta, (x_t_m, 0.0))
    X, Y = unrotate(eta[2], pull_N[0] - k_N_m * north_m, pull_N[1] - k_N_m * east_m)
    return X, Y, x_t_m * Y


def force(p: Values, vessel: Any, eta: Any, nu: Any) -> tuple[Any, Any, Any]:
    """Body force [N, N, N m] of the line."""
    seen = (eta[0] - p["north_m"], eta[1] - p["east_m"], eta[2])  # from the anchor
    X, Y, N = spring((0.0, 0.0), p["stiffness_N_m"], p["x_t_m"], seen)
    north_m, east_m = point_position(seen, (p["x_t_m"], 0.0))
    lib = library(north_m, east_m, p["slack_m"])
    taut = lib.fmax(1 - p["slack_m"] / lib.sqrt(north_m**2 + east_m**2 + 1e-12), 0.0)
    return taut * X, taut * Y, taut * N


TERM = Term(
    "tether",
    "F = stiffness max(d - slack, 0) towards the anchor, at x_t on the centreline; d: distance from there",
    (
        LoadParameter("north_m", "m", 0.0, -1000.0, 1000.0, "place of the anchor, site axes"),
        LoadParameter("east_m", "m", 0.0, -1000.0, 1000.0, "the same, east"),
        LoadParameter("slack_m", "m", 0.0, 0.0, 1000.0, "length up to which the tether hangs loose"),
        LoadParameter("stiffness_N_m", "N/m", 0.0, 0.0, 1000.0, "force per metre beyond that"),
        LoadParameter("x_t_m", "m", 0.0, -30.0, 30.0, "where on the centreline it is fastened, from the origin"),
    ),
    force=force,
)
