"""Moments of the water on a hull that moves ahead: Munk moment, damping of turns by speed, a pull to one side."""

from __future__ import annotations

from typing import Any

from companion.core.model.effects.term import LoadParameter, Term, Values


def munk_moment(p: Values, vessel: Any, nu_r: Any) -> tuple[Any, Any, Any]:
    """N = k u_r v_r: (X_udot - Y_vdot) u v of potential flow (Fossen 2011, 6.5), as far as M does not hold it."""
    return 0.0, 0.0, p["k_kg"] * nu_r[0] * nu_r[1]


def speed_damping(p: Values, vessel: Any, nu_r: Any) -> tuple[Any, Any, Any]:
    """N = N_ur |u_r| r: second-order modulus (Fossen 2011, 7.1), lift of skeg and after-body against turning."""
    return 0.0, 0.0, p["N_ur_N_s2"] * abs(nu_r[0]) * nu_r[2]


def asymmetry(p: Values, vessel: Any, nu_r: Any) -> tuple[Any, Any, Any]:
    """N = N_uu |u_r| u_r: second-order modulus (Fossen 2011, 7.1) of what is not alike to port and to starboard."""
    return 0.0, 0.0, p["N_uu_N_s2_m"] * abs(nu_r[0]) * nu_r[0]


MUNK_MOMENT = Term(
    "munk_moment",
    "N = k u_r v_r: a slender hull turns across the flow",
    (LoadParameter("k_kg", "kg", 0.0, -500.0, 500.0, "yaw moment of u_r v_r", fitted=True),),
    hull_force=munk_moment,
)
SPEED_DAMPING = Term(
    "speed_damping",
    "N = N_ur |u_r| r: turning is damped the more the faster the boat goes ahead or astern",
    (LoadParameter("N_ur_N_s2", "N s2", 0.0, -1000.0, 0.0, "yaw moment of |u_r| r", fitted=True),),
    hull_force=speed_damping,
)
ASYMMETRY = Term(
    "asymmetry",
    "N = N_uu |u_r| u_r: a hull that is not quite straight turns to one side as it moves",
    (LoadParameter("N_uu_N_s2_m", "N s2/m", 0.0, -200.0, 200.0, "yaw moment of |u_r| u_r", fitted=True),),
    hull_force=asymmetry,
)
