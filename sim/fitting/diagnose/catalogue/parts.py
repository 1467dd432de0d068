"""Building blocks of catalogue entries: parameter constructors, rotations, wind and damping forces of the file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import rotate, unrotate
from companion.core.model.effects import wind
from companion.core.model.effects.term import Term
from companion.core.model.loads import values
from companion.core.model.manoeuvring import coefficients, hull_drag
from sim.fitting.diagnose.catalogue.effect import EffectParameter, Hook, Scene, Values

REACH = 0.3  # step of a secant over the smallest size worth a name


def scalar_parameter(
    name: str, unit: str, prior: float, smallest: float, lower: float = -np.inf, upper: float = np.inf
) -> tuple[EffectParameter, ...]:
    """One parameter with prior sigma, smallest size and limits; secant step `REACH` times the smallest size."""
    return (EffectParameter(name, unit, prior, smallest, REACH * smallest, lower, upper),)


def share_parameter(prior: float, smallest: float) -> tuple[EffectParameter, ...]:
    """One relative change, `share`: the quantity becomes (1 + share) times that of the file."""
    return scalar_parameter("share", "1", prior, smallest, lower=-0.95, upper=10.0)


def vector_parameters(one: str, other: str, unit: str, prior: float, smallest: float) -> tuple[EffectParameter, ...]:
    """Two parameters that are components of one vector."""
    return (*scalar_parameter(one, unit, prior, smallest), *scalar_parameter(other, unit, prior, smallest))


def ned_to_body(psi_rad: np.ndarray, north: Any, east: Any) -> tuple[np.ndarray, np.ndarray]:
    """Components in body axes of a vector given by north and east."""
    return unrotate(psi_rad, north, east)


def body_to_ned(psi_rad: np.ndarray, ahead: Any, starboard: Any) -> tuple[np.ndarray, np.ndarray]:
    """The other way round."""
    return rotate(psi_rad, ahead, starboard)


def moving(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """eta, nu and nu_r of a scene, components first, (3, W, k) each, as equations of `companion.core.model` take."""
    eta, nu, nu_r = (np.moveaxis(a, -1, 0) for a in (scene.x[..., :3], scene.x[..., 3:], scene.nu_r))
    return eta, nu, nu_r


def stacked(force: Sequence[Any]) -> np.ndarray:
    """Components [N, N, N m] of a force, arrays or numbers, as (W, k, 3)."""
    return np.stack(np.broadcast_arrays(*force), axis=-1)


def water_on_hull(vessel: VesselFile, term: Term, **keys: str) -> dict[str, Hook]:
    """Hook of a term's force of the water on the hull; `keys`: parameter of the term = parameter of the effect."""
    force = term.hull_force
    assert force is not None

    def hook(p: Values, scene: Scene) -> np.ndarray:
        return stacked(force({key: p[own] for key, own in keys.items()}, vessel, moving(scene)[2]))

    return {"force": hook}


def air_force(vessel: VesselFile, scene: Scene, V_w_m_s: float, beta_w_deg: float) -> np.ndarray:
    """Force (W, k, 3) [N, N, N m] of air with speed V_w from beta_w [deg] on the moving boat (Fossen 2011, 8.1)."""
    eta, nu, _ = moving(scene)
    own = values("wind", vessel.terms.get("wind", {}))
    p = own | {"V_w_m_s": V_w_m_s, "beta_w_deg": beta_w_deg, "gustiness": 0.0}
    return stacked(wind.force(p, vessel, eta, nu))


def hull_damping(vessel: VesselFile, scene: Scene) -> np.ndarray:
    """D(nu_r) nu_r by the scene's coefficients, (W, k, 3) [N, N, N m]; the force is its negative."""
    return -stacked(hull_drag(scene.hull or coefficients(vessel), moving(scene)[2]))
