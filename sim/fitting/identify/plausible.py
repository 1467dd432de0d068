"""What a hull of the file's mass and length can have: bands for inertia and damping, and the same without dimensions.

    0.9 m <= M11 <= 2 m,   0.9 m <= M22 <= 5 m,   0.1 L <= sqrt(M33 / m) <= L
    X_u, Y_v, N_r:  M / T,  T = (35, 12, 11) sqrt(L / g)                          to a factor of 4 either way
    X_uu = rho/2 C S,  Y_vv = rho/2 C_D T L,  N_rr = rho/2 C_D T L^4 / 32          to a factor of 5 either way

m: mass of the file, L: length, T: draft, S = 2 T L + m / (rho T) about the wetted area; times and drag are those of
`companion.core.model.first_vessel`. Added mass in surge is 5 to 20 % of a slender hull's mass, in sway 0.5 to 2
times (Fossen 2021, chapter 6); the bounds leave room for hulls that are not slender and masses that were guessed. The
factors are assumed.

SNAME (1950) divides by rho/2, powers of L, and the speed U where a coefficient belongs to a speed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import sqrt

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.first_vessel import RHO_KG_M3, cross_flow, surge_drag, time_constants_s
from sim.fitting.identify.result import FitResult

SURGE, SWAY = (0.9, 2.0), (0.9, 5.0)
GYRATION = (0.1, 1.0)
LINEAR_FACTOR, QUADRATIC_FACTOR = 4.0, 5.0
U_M_S = 1.0
"""For derivatives of a model in which they do not depend on speed."""
Band = tuple[float, float]
POWERS: Mapping[str, tuple[int, int]] = {
    "M11_kg": (3, 0), "M22_kg": (3, 0), "M33_kg_m2": (5, 0), "M23_kg_m": (4, 0),
    "X_u_N_s_m": (2, 1), "Y_v_N_s_m": (2, 1), "N_r_N_m_s": (4, 1), "Y_r_N_s": (3, 1), "N_v_N_s": (3, 1),
    "X_uu_N_s2_m2": (2, 0), "Y_vv_N_s2_m2": (2, 0), "N_rr_N_m_s2": (5, 0),
}  # fmt: skip
"""Powers of L and U by which a parameter is divided."""
LINEAR = ("X_u_N_s_m", "Y_v_N_s_m", "N_r_N_m_s")
QUADRATIC = ("X_uu_N_s2_m2", "Y_vv_N_s2_m2", "N_rr_N_m_s2")
JUDGED = ("M11_kg", "M22_kg", "M33_kg_m2")
"""Of these a value outside is said beside the verdict; damping follows the water and the hull's form too much."""


def bands(vessel: VesselFile) -> dict[str, Band]:
    """Least and largest value that such a hull may have, by parameter."""
    m, L, T = vessel.inertia.mass_kg, vessel.hull.length_m, vessel.hull.draft_m
    inertia: dict[str, Band] = {
        "M11_kg": (SURGE[0] * m, SURGE[1] * m),
        "M22_kg": (SWAY[0] * m, SWAY[1] * m),
        "M33_kg_m2": (m * (GYRATION[0] * L) ** 2, m * (GYRATION[1] * L) ** 2),
    }
    middles = [sqrt(low * high) for low, high in inertia.values()]
    linear = [M / T_s for M, T_s in zip(middles, time_constants_s(L), strict=True)]
    quadratic = (surge_drag(2 * T * L + m / (RHO_KG_M3 * T)), *cross_flow(L, T))
    sizes = dict(zip(LINEAR + QUADRATIC, (*linear, *quadratic), strict=True))
    factors = dict.fromkeys(LINEAR, LINEAR_FACTOR) | dict.fromkeys(QUADRATIC, QUADRATIC_FACTOR)
    return inertia | {name: (-factors[name] * size, -size / factors[name]) for name, size in sizes.items()}


def without_dimension(name: str, value: float, vessel: VesselFile) -> float | None:
    """A parameter in SNAME's prime system; None where it has none."""
    if name not in POWERS:
        return None
    of_length, of_speed = POWERS[name]
    return value / (RHO_KG_M3 / 2 * vessel.hull.length_m**of_length * U_M_S**of_speed)


def implausible(vessel: VesselFile, result: FitResult) -> Iterator[str]:
    """Sentences on inertias outside their bands."""
    m, L, allowed = vessel.inertia.mass_kg, vessel.hull.length_m, bands(vessel)
    for name in JUDGED:
        (low, high), value = allowed[name], result[name].value
        if not low <= value <= high:
            yield (
                f"{name} = {value:.4g} is not that of a boat of {m:g} kg and {L:g} m ({low:.3g} to {high:.3g}): the "
                "logs hold too little of this motion, signs or sides are wrong, or the mass in the vessel file is."
            )
