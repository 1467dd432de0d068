"""Cross-flow drag by strips (Fossen 2011, section 6.4.3), beyond the damping of the file.

Y = -rho/2 C_d 1.5 T sum |w_i| w_i dx,   N = -rho/2 C_d 1.5 T sum x_i |w_i| w_i dx,   w_i = v_r + x_i r
"""

from __future__ import annotations

from typing import Any

import numpy as np

from companion.core.model.effects.term import LoadParameter, Term, Values

RHO_WATER = 1000.0  # kg/m^3, fresh water
HULLS = 1.5  # two hulls, half shielded; assumed
STRIPS = 12


def force(p: Values, vessel: Any, nu_r: Any) -> tuple[Any, Any, Any]:
    """Body force [N, N, N m] at nu_r; length and draft from the hull table of `vessel`, origin amidships."""
    hull = vessel.hull
    scale = -0.5 * RHO_WATER * HULLS * hull.draft_m * hull.length_m / STRIPS
    places_m = ((np.arange(STRIPS) + 0.5) / STRIPS - 0.5) * hull.length_m
    Y, N = 0.0, 0.0
    for x in places_m.tolist():
        across = nu_r[1] + x * nu_r[2]
        drag = scale * p["C_d"] * (abs(across) * across)
        Y, N = Y + drag, N + x * drag
    return 0.0, Y, N


def most_negative_C_d(vessel: Any) -> float:
    """Lowest C_d that feeds nothing at any v, r: there the file's quadratic damping takes as much as the strips give.

    Both powers go with the cube of speed, so their ratio over the angle of (v, r L / 2) is all there is to look at.
    """
    d = vessel.damping
    angle = np.linspace(0, np.pi, 721)
    v, r = np.cos(angle), 2 / vessel.hull.length_m * np.sin(angle)
    _, Y, N = force({"C_d": 1.0}, vessel, (0.0, v, r))
    taken = -(d.Y_vv_N_s2_m2 * np.abs(v) ** 3 + d.N_rr_N_m_s2 * np.abs(r) ** 3)
    return float((taken / (Y * v + N * r)).max())


TERM = Term(
    "cross_flow",
    "dY = -rho/2 C_d 1.5 T |v_r + x r| (v_r + x r) dx, N with arm x",
    (LoadParameter("C_d", "1", 0.0, -10.0, 10.0, "drag coefficient of the strips, beyond the file's damping"),),
    hull_force=force,
)
