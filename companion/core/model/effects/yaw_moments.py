"""Moments of the water on a hull that moves ahead: Munk moment, and damping of turns by speed."""

from __future__ import annotations

from typing import Any

from companion.core.model.effects.term import LoadParameter, Term, Values


def munk_moment(p: Values, vessel: Any, nu_r: Any) -> tuple[Any, Any, Any]:
    """N = k u_r v_r: (X_udot - Y_vdot) u v of potential flow (Fossen 2011, 6.5), as far as M does not hold it."""
    return 0.0, 0.0, p["k_kg"] * nu_r[0] * nu_r[1]


def speed_damping(p: Values, vessel: Any, nu_r: Any) -> tuple[Any, Any, Any]:
    """N = N_ur |u_r| r: second-order modulus (Fossen 2011, 7.1), lift of skeg and after-body against turning."""
    return 0.0, 0.0, p["N_ur_N_s2"] * abs(nu_r[0]) * nu_r[2]


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
