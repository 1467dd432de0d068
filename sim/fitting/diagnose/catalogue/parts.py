"""Building blocks of catalogue entries: parameter constructors, rotations, wind and damping forces of the file."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import rotate, unrotate
from companion.core.model.loads import REGISTRY, values
from companion.core.model.manoeuvring import damping_force
from sim.fitting.diagnose.catalogue.effect import EffectParameter, Scene
from sim.fitting.engine.batched import Batch
from sim.fitting.engine.parameters import HULL

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


def zone_weight(north_m: np.ndarray, east_m: np.ndarray, centre: tuple[float, float], radius_m: float) -> np.ndarray:
    """Weight 1 inside a circle, 0 outside; logistic edge of half a metre (assumed)."""
    inside = radius_m - np.hypot(north_m - centre[0], east_m - centre[1])
    return 1 / (1 + np.exp(-np.clip(inside / 0.5, -50, 50)))


@lru_cache(maxsize=8)
def _wind(coefficients: tuple[tuple[str, Any], ...], hull: Any, count: int) -> Batch:
    V, beta, eta, nu = ca.SX.sym("V"), ca.SX.sym("beta"), ca.SX.sym("eta", 3), ca.SX.sym("nu", 3)
    p = values("wind", dict(coefficients)) | {"V_w_m_s": V, "beta_w_deg": beta}
    force = REGISTRY["wind"].force
    assert force is not None
    out = ca.vertcat(*force(p, _Hull(hull), eta, nu))
    return Batch(ca.Function("wind", [V, beta, eta, nu], [ca.densify(out)]), count)


class _Hull:
    """Stand-in for a vessel file where a load term reads its hull only."""

    def __init__(self, hull: Any):
        self.hull = hull


def wind_force(vessel: VesselFile, scene: Scene, V_w_m_s: float, beta_w_deg: float) -> np.ndarray:
    """Wind force (W, k, 3) [N, N, N m] of speed V_w from beta_w [deg], less that of still air on the moving boat."""
    return air_force(vessel, scene, V_w_m_s, beta_w_deg) - air_force(vessel, scene, 0.0, beta_w_deg)


def air_force(vessel: VesselFile, scene: Scene, V_w_m_s: float, beta_w_deg: float) -> np.ndarray:
    """Force (W, k, 3) [N, N, N m] of air with speed V_w from beta_w [deg] on the moving boat (Fossen 2011, 8.1)."""
    count, x = scene.t_s.size, scene.x.reshape(-1, 6)
    given = tuple(sorted((k, v) for k, v in vessel.terms.get("wind", {}).items() if k.startswith("c_")))
    function = _wind(given, vessel.hull, count)
    (out,) = function(np.full((count, 1), V_w_m_s), np.full((count, 1), beta_w_deg), x[:, :3], x[:, 3:])
    return out.reshape(*scene.t_s.shape, 3).copy()


@lru_cache(maxsize=4)
def _damping(count: int) -> Batch:
    c, nu = ca.SX.sym("c", len(HULL)), ca.SX.sym("nu", 3)
    out = damping_force(dict(zip(HULL, ca.vertsplit(c), strict=True)), nu)
    return Batch(ca.Function("damping", [c, nu], [ca.densify(out)]), count)


def hull_damping(vessel: VesselFile, scene: Scene) -> np.ndarray:
    """D(nu_r) nu_r of the vessel file along the motion, (W, k, 3) [N, N, N m]; the force is its negative."""
    count = scene.t_s.size
    coefficients = np.array([getattr(vessel.damping, name, 0.0) for name in HULL])
    (out,) = _damping(count)(np.tile(coefficients, (count, 1)), scene.nu_r.reshape(count, 3))
    return out.reshape(*scene.t_s.shape, 3).copy()
