"""Effects of the hull: inertia, damping, coupling (Fossen 2011).

Hooks `hull` change coefficients of M nu_dot + C(nu_r) nu_r + D(nu_r) nu_r = tau by name; hooks `force` give a body
force (W, k, 3) [N, N, N m] along the motion, where the file's model has no coefficient for the effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.manoeuvring import mass_matrix
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter, Hook, Scene, Values
from sim.fitting.diagnose.catalogue.parts import scalar_parameter, share_parameter, vector_parameters
from sim.fitting.engine.parameters import HULL

BASE_SIGMA = 0.025  # relative sigma of each coefficient of the vessel file; assumed
COUPLED_SIGMA = {"M23_kg_m": 0.005, "Y_r_N_s": 0.01, "N_v_N_s": 0.01}
"""Sigma of a coupling over the root of its diagonals' product; assumed. Most of M23 is in the band of `cg_shift`."""
COUPLED = {
    "M23_kg_m": ("M22_kg", "M33_kg_m2"),
    "Y_r_N_s": ("Y_v_N_s_m", "N_r_N_m_s"),
    "N_v_N_s": ("Y_v_N_s_m", "N_r_N_m_s"),
}
RHO_WATER = 1000.0  # kg/m^3, fresh water
STRIPS = 12
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

    def moved(id: str, equation: str, signature: str, parameters: tuple[EffectParameter, ...], hook: Hook) -> Effect:
        return Effect(id, "hull", equation, signature, parameters, {"force": hook}, vector=len(parameters) > 1)

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
        lambda p, c: c | _payload(c, p["mass_kg"], inertia.x_g_m),
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
        lambda p, scene: _shifted(p, scene, inertia.mass_kg),
    )
    yield moved(
        "cross_flow",
        "dY = -rho/2 C_d 1.5 T |v_r + x r| (v_r + x r) dx",
        "more drag in fast sway and fast turns only",
        scalar_parameter("C_d", "1", 0.6, 0.15),
        lambda p, scene: _cross_flow(p, scene, vessel),
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
        _munk,
    )


def _payload(c: Coefficients, m: float, x_g: float) -> Coefficients:
    return {
        "M11_kg": c["M11_kg"] + m,
        "M22_kg": c["M22_kg"] + m,
        "M23_kg_m": c["M23_kg_m"] + m * x_g,
        "M33_kg_m2": c["M33_kg_m2"] + m * x_g**2,
    }


def _shifted(p: Values, scene: Scene, mass_kg: float) -> np.ndarray:
    """Force of a shift (x, y) of the centre of gravity: its terms of M nu_dot + C nu (Fossen 2011, 3.3), negated."""
    u, v, r = scene.u_m_s, scene.v_m_s, scene.r_rad_s
    u_dot, v_dot, r_dot = (scene.nu_dot[..., i] for i in range(3))
    x, y = p["x_g_m"], p["y_g_m"]
    X, Y = x * r**2 + y * r_dot, y * r**2 - x * r_dot
    return mass_kg * np.stack([X, Y, y * (u_dot - v * r) - x * (v_dot + u * r)], axis=-1)


def _cross_flow(p: Values, scene: Scene, vessel: VesselFile) -> np.ndarray:
    """Cross-flow drag summed over `STRIPS` strips along the hull; two hulls count 1.5 (assumed)."""
    x = (np.arange(STRIPS) + 0.5) / STRIPS * vessel.hull.length_m - vessel.hull.length_m / 2
    nu_r = scene.nu_r
    across = nu_r[..., 1:2] + x * nu_r[..., 2:]
    scale = -0.5 * RHO_WATER * p["C_d"] * 1.5 * vessel.hull.draft_m * vessel.hull.length_m / STRIPS
    strips = scale * np.abs(across) * across
    out = np.zeros((*scene.t_s.shape, 3))
    out[..., 1], out[..., 2] = strips.sum(axis=-1), strips @ x
    return out


def _munk(p: Values, scene: Scene) -> np.ndarray:
    out = np.zeros((*scene.t_s.shape, 3))
    nu_r = scene.nu_r
    out[..., 2] = p["N_uv_kg"] * nu_r[..., 0] * nu_r[..., 1]
    return out
