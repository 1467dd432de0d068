"""Wind on the hull above water (Fossen 2011, section 8.1), with the boat's own way in the apparent wind.

X = -c_x cos(gamma) q A_F,  Y = c_y sin(gamma) q A_L,  N = c_n sin(2 gamma) q A_L L
q = rho V_rw^2 / 2,  gamma = -atan2(v_rw, u_rw)

A gusty wind is V_w (1 + gustiness g), g Gauss-Markov of unit size. The simulated world draws g; filter, NMPC and fits
take the steady wind of the same mean pressure, V_w sqrt(1 + gustiness^2).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from companion.core.geometry.frames import cos_sin
from companion.core.model.effects.elementwise import library
from companion.core.model.effects.term import LoadParameter, Term, Values

RHO_AIR = 1.225  # kg/m^3, ISA at sea level and 15 C


def steady_speed(p: Values) -> Any:
    """Speed [m/s] of the steady wind that pushes as this one does in the mean."""
    g = p.get("gustiness", 0.0)
    return p["V_w_m_s"] if isinstance(g, int | float) and not g else p["V_w_m_s"] * library(g).sqrt(1 + g**2)


def force(p: Values, vessel: Any, eta: Any, nu: Any) -> tuple[Any, Any, Any]:
    """Body force [N, N, N m]; areas and length from the hull table of `vessel`."""
    cos, sin = cos_sin(p["beta_w_deg"] * (np.pi / 180) - eta[2])
    speed = steady_speed(p)
    u_rw, v_rw = nu[0] + speed * cos, nu[1] + speed * sin
    speed2 = u_rw**2 + v_rw**2
    gamma = -library(u_rw, v_rw).atan2(v_rw, u_rw + 1e-9)
    q, hull = 0.5 * RHO_AIR * speed2, vessel.hull
    cos, sin = cos_sin(gamma)
    X = -p["c_x"] * cos * q * hull.frontal_area_m2
    Y = p["c_y"] * sin * q * hull.lateral_area_m2
    N = p["c_n"] * cos_sin(2 * gamma)[1] * q * hull.lateral_area_m2 * hull.length_m
    return X, Y, N


TERM = Term(
    "wind",
    "X = -c_x cos(gamma) q A_F, Y = c_y sin(gamma) q A_L, N = c_n sin(2 gamma) q A_L L, "
    "q = rho V_rw^2 / 2, gamma = -atan2(v_rw, u_rw)",
    (
        LoadParameter("V_w_m_s", "m/s", 0.0, 0.0, 25.0, "wind speed"),
        LoadParameter("beta_w_deg", "deg", 0.0, -360.0, 360.0, "direction it comes from, from north"),
        LoadParameter("c_x", "1", 0.7, 0.0, 2.0, "longitudinal coefficient; Fossen 0.5-0.9 for ships"),
        LoadParameter("c_y", "1", 0.9, 0.0, 2.0, "lateral coefficient; Fossen 0.7-0.95 for ships"),
        LoadParameter("c_n", "1", 0.1, -0.5, 0.5, "yaw coefficient; Fossen 0.05-0.2 for ships"),
        LoadParameter("gustiness", "1", 0.0, 0.0, 2.0, "sigma of its speed over the speed"),
        LoadParameter("gust_time_s", "s", 10.0, 0.1, 1000.0, "correlation time of the gusts"),
    ),
    force=force,
)
