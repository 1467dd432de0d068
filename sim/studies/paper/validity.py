"""Where the paper's Taylor series, simulated, still is a model of a boat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.fitting.taylor.abkowitz import KGF_N


@dataclass(frozen=True)
class Range:
    """Interval of one quantity within which the model is valid, with the reason for its ends."""

    name: str
    low: float
    high: float
    why: str


VALIDITY = (
    Range("u_m_s", 0.43, 0.85, "here a small deviation from straight running shrinks; below 0.41 it grows"),
    Range("v_m_s", -0.22, 0.22, "sway damping dY/dv changes sign at -0.229 (and at 0.275)"),
    Range("r_rad_s", -0.57, 0.57, "there the cubic yaw term is as large as the linear one"),
    Range("X_N", -4 * KGF_N, 4 * KGF_N, "assumed: the thrust of the paper's closed loop on legs, doubled"),
    Range("Y_N", -0.5 * KGF_N, 0.5 * KGF_N, "no sway force was in the data: 0, and a margin assumed"),
    Range("N_N_m", -0.75 * KGF_N, 0.75 * KGF_N, "holds r = 0.57 rad/s"),
)
"""The validity box over [u v r X Y N]. Defended by tests/sim/studies/test_abkowitz.py; the data is not published."""


def outside(nu: Any, tau: Any) -> tuple[str, ...]:
    """A text for each quantity outside the validity box; empty inside. nu [m/s, m/s, rad/s], tau [N, N, N m]."""
    values = [*np.asarray(nu, dtype=float), *np.asarray(tau, dtype=float)]
    return tuple(
        f"{limit.name} = {value:.3g} is outside {limit.low:.3g} to {limit.high:.3g} ({limit.why})"
        for limit, value in zip(VALIDITY, values, strict=True)
        if not limit.low <= value <= limit.high
    )
