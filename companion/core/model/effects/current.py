"""Water that flows over ground, steadily or turning: nu_c = R(psi)^T V_c [cos beta, sin beta], beta = beta_c + turn t.

t counts from the beginning: of the log (the first of several), or of the simulation. The water's own acceleration is
left out, as of an irrotational current that is constant (Fossen 2011, section 8.3): a free boat in water of 0.3 m/s
that turns by 1 deg/s slips through it by 0.04 m/s.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from companion.core.geometry.frames import cos_sin, rotate
from companion.core.model.effects.term import LoadParameter, Term, Values


def turned(north_m_s: Any, east_m_s: Any, turn_deg_s: Any, since_s: Any) -> tuple[Any, Any]:
    """A flow `since_s` [s] later, north and east [m/s], that turns by `turn_deg_s`, clockwise from above."""
    return rotate(turn_deg_s * (np.pi / 180) * since_s, north_m_s, east_m_s)


def direction_deg(beta_c_deg: Any, turn_deg_s: Any, t_s: Any) -> Any:
    """beta [deg] at t_s."""
    return beta_c_deg + turn_deg_s * t_s


def water_velocity(p: Values, t_s: Any = None) -> tuple[Any, Any]:
    """Velocity of the water at t_s, north and east [m/s]; None, where no clock is known: as at the beginning."""
    beta = p["beta_c_deg"] if t_s is None else direction_deg(p["beta_c_deg"], p["turn_deg_s"], t_s)
    cos, sin = cos_sin(beta * (np.pi / 180))
    return p["V_c_m_s"] * cos, p["V_c_m_s"] * sin


TERM = Term(
    "current",
    "nu_c = R(psi)^T V_c [cos beta, sin beta], beta = beta_c + turn t; the hull feels nu_r = nu - nu_c",
    (
        LoadParameter("V_c_m_s", "m/s", 0.0, 0.0, 2.0, "speed of the water over ground"),
        LoadParameter("beta_c_deg", "deg", 0.0, -360.0, 360.0, "direction it flows towards at the beginning"),
        LoadParameter("turn_deg_s", "deg/s", 0.0, -10.0, 10.0, "rate at which that direction turns, clockwise"),
    ),
    water_velocity=water_velocity,
)
