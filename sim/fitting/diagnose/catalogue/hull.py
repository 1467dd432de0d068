"""Effects of the hull: inertia, damping, coupling (Fossen 2011).

Hooks `hull` change coefficients of M nu_dot + C(nu_r) nu_r + D(nu_r) nu_r = tau by name; hooks `force` give a body
force (W, k, 3) [N, N, N m] along the motion, where the file's model has no coefficient for the effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.effects import cross_flow
from companion.core.model.effects.yaw_moments import MUNK_MOMENT
from companion.core.model.manoeuvring import inertial_force, mass_matrix
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter, Hook, Scene, Values
from sim.fitting.diagnose.catalogue.parts import (
    moving,
    scalar_parameter,
    share_parameter,
    stacked,
    vector_parameters,
    water_on_hull,
)
from sim.fitting.engine.parameters import HULL

BASE_SIGMA = 0.025  # relative sigma of each coefficient of the vessel file; assumed
COUPLED_SIGMA = {"M23_kg_m": 0.005, "Y_r_N_s": 0.01, "N_v_N_s": 0.01}
"""Sigma of a coupling over the root of its diagonals' product; assumed. Most of M23 is in the band of `cg_shift`."""
COUPLED = {
    "M23_kg_m": ("M22_kg", "M33_kg_m2"),
    "Y_r_N_s": ("Y_v_N_s_m", "N_r_N_m_s"),
    "N_v_N_s": ("Y_v_N_s_m", "N_r_N_m_s"),
}
DAMPING = ("X_u_N_s_m", "Y_v_N_s_m", "N_r_N_m_s", "X_uu_N_s2_m2", "Y_vv_N_s2_m2", "N_rr_N_m_s2")
Coefficients = dict[str, float]
HullHook = Callable[[Values, Coefficients], Coefficients]


def scaled(*names: str) -> HullHook:
    """Hook that multiplies the coefficients `names` by 1 + share."""
    return lambda p, c: c | {n: c[n] * (1 + p["share"]) for n in names}


def base(vessel: VesselFile) -> Iterator[Effect]:
    """One nuisance for each coefficient: free in every fit, never named."""
    i = vessel.inertia
    sums = {  # entries of M that are sums of two numbers of the file with independent errors
        "M11_kg": (i.mass_kg, -i.X_udot_kg),
        "M22_kg": (i.mass_kg, -i.Y_vdot_kg),
        "M33_kg_m2": (i.I_z_kg_m2 + i.mass_kg * (i.x_g_m**2 + i.y_g_m**2), -i.N_rdot_kg_m2),
    }
    for name in HULL:
        hook = _coupling(name, *COUPLED[name]) if name in COUPLED else scaled(name)
        sigma = COUPLED_SIGMA.get(name, BASE_SIGMA)
        if name in sums:
            sigma = float(BASE_SIGMA * np.hypot(*sums[name]) / abs(sum(sums[name])))
        parameter = EffectParameter("share", "1", sigma, sigma, sigma, -0.9, 10.0)
        yield Effect(f"base:{name}", "base", f"{name} (1 + share)", "", (parameter,), {"hull": hook})


def _coupling(name: str, one: str, other: str) -> HullHook:
    """Hook for a coupling, which may have any sign: c + share sqrt(|c_one c_other|) of its two diagonal entries."""
    return lambda p, c: c | {name: c[name] + p["share"] * float(np.sqrt(abs(c[one] * c[other])))}


def effects(vessel: VesselFile) -> Iterator[Effect]:
    """Entries of the hull that can be named."""
    inertia = vessel.inertia
    added = {"M11_kg": -inertia.X_udot_kg, "M22_kg": -inertia.Y_vdot_kg}
    M33 = mass_matrix(vessel)[2, 2]

    def entry(
        id: str, equation: str, signature: str, parameters: tuple[EffectParameter, ...], hook: HullHook
    ) -> Effect:
        return Effect(id, "hull", equation, signature, parameters, {"hull": hook})

    def moved(
        id: str, equation: str, signature: str, parameters: tuple[EffectParameter, ...], hooks: dict[str, Hook]
    ) -> Effect:
        return Effect(id, "hull", equation, signature, parameters, hooks, vector=len(parameters) > 1)

    yield entry(
        "hull_fouling",
        "all damping (1 + share)",
        "slower at the same thrust in every direction, stops sooner",
        share_parameter(0.5, 0.08),
        scaled(*DAMPING, "Y_r_N_s", "N_v_N_s"),
    )
    yield entry(
        "payload",
        "M + m at the centre of gravity",
        "slower to start and to stop, same top speed",
        scalar_parameter("mass_kg", "kg", 0.3 * inertia.mass_kg, 0.06 * inertia.mass_kg, -0.8 * inertia.mass_kg),
        lambda p, c: c | _payload(c, p["mass_kg"], inertia.x_g_m, inertia.y_g_m),
    )
    yield entry(
        "added_mass",
        "X_udot, Y_vdot (1 + share)",
        "slower to start and to stop, sideways above all",
        share_parameter(0.6, 0.12),
        lambda p, c: c | {k: c[k] + p["share"] * m for k, m in added.items()},
    )
    yield entry(
        "yaw_inertia",
        "I_z + I",
        "turns begin and end slower",
        scalar_parameter("I_z_kg_m2", "kg m2", 0.4 * M33, 0.08 * M33, -0.8 * M33),
        lambda p, c: c | {"M33_kg_m2": c["M33_kg_m2"] + p["I_z_kg_m2"]},
    )
    yield moved(
        "cg_shift",
        "x_g + x, y_g + y",
        "turns when it only ought to surge or sway, and the other way round",
        vector_parameters("x_g_m", "y_g_m", "m", 0.1, 0.02),
        {"force": lambda p, scene: _shifted(p, scene, vessel)},
    )
    yield moved(
        "cross_flow",
        "dY = -rho/2 C_d 1.5 T |v_r + x r| (v_r + x r) dx",
        "more drag in fast sway and fast turns only",
        scalar_parameter("C_d", "1", 0.6, 0.15),
        water_on_hull(vessel, cross_flow.TERM, C_d="C_d"),
    )
    yield Effect(
        "yaw_sway_coupling",
        "hull",
        "Y_r + a, N_v + b",
        "a turn pushes sideways, sideways motion turns",
        vector_parameters("Y_r_N_s", "N_v_N_s", "N s", 6.0, 1.5),
        {"hull": lambda p, c: c | {k: c[k] + p[k] for k in ("Y_r_N_s", "N_v_N_s")}},
        vector=True,
    )
    yield moved(
        "munk_moment",
        "N += k u_r v_r",
        "turns broadside while it drifts at speed",
        scalar_parameter("N_uv_kg", "kg", 20.0, 4.0),
        water_on_hull(vessel, MUNK_MOMENT, k_kg="N_uv_kg"),
    )


def _payload(c: Coefficients, m: float, x_g: float, y_g: float) -> Coefficients:
    return {
        "M11_kg": c["M11_kg"] + m,
        "M22_kg": c["M22_kg"] + m,
        "M23_kg_m": c["M23_kg_m"] + m * x_g,
        "M33_kg_m2": c["M33_kg_m2"] + m * (x_g**2 + y_g**2),
    }


def _shifted(p: Values, scene: Scene, vessel: VesselFile) -> np.ndarray:
    """Force of a shift (x, y) of the centre of gravity: what M nu_dot + C(nu) nu has more of it, negated."""
    i = vessel.inertia
    moved = replace(i, x_g_m=i.x_g_m + p["x_g_m"], y_g_m=i.y_g_m + p["y_g_m"])
    M = mass_matrix(replace(vessel, inertia=moved)) - mass_matrix(vessel)
    return -stacked(inertial_force(M, moving(scene)[2], np.moveaxis(scene.nu_r_dot, -1, 0)))
