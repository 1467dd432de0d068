"""Optional model terms by name: effects that a boat may or may not have, usable wherever the model is.

A term is one entry of REGISTRY: its equation, its parameters with unit and bounds, and what it adds:

    water_velocity(p, eta)        -> (north, east) [m/s]    velocity of the water over ground
    force(p, vessel, eta, nu)     -> (X, Y, N) [N, N, N m]  body force
    hull_force(p, nu_r)           -> (X, Y, N) [N, N, N m]  force of the water on the hull at nu_r = nu - nu_c
    damping_factor(p, eta)        -> factor [1]             by which all damping of the hull is larger here

All are written with CasADi expressions, so the plant, the filter, the NMPC and the fits use the same line.
A vessel file switches one on with a table `[terms.NAME]`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from companion.core.geometry.frames import unrotate

RHO_AIR = 1.225  # kg/m^3, ISA at sea level and 15 C


@dataclass(frozen=True)
class LoadParameter:
    """One number of a term: its unit, default and the bounds within which it makes sense.

    `fitted`: a property of the boat, to be estimated from its logs where a vessel file has the term.
    """

    name: str
    unit: str
    default: float
    lower: float
    upper: float
    meaning: str
    fitted: bool = False


@dataclass(frozen=True)
class Term:
    """One effect. `equation`: what the callables compute, for people."""

    name: str
    equation: str
    parameters: tuple[LoadParameter, ...]
    water_velocity: Callable[[Mapping[str, Any], Any], tuple[Any, Any]] | None = None
    force: Callable[[Mapping[str, Any], Any, Any, Any], tuple[Any, Any, Any]] | None = None
    hull_force: Callable[[Mapping[str, Any], Any], tuple[Any, Any, Any]] | None = None
    damping_factor: Callable[[Mapping[str, Any], Any], Any] | None = None


def _current(p: Mapping[str, Any], eta: Any) -> tuple[Any, Any]:
    beta = p["beta_c_deg"] * (ca.pi / 180)
    return p["V_c_m_s"] * ca.cos(beta), p["V_c_m_s"] * ca.sin(beta)


def _wind(p: Mapping[str, Any], vessel: Any, eta: Any, nu: Any) -> tuple[Any, Any, Any]:
    """Fossen (2011), section 8.1: apparent wind in body axes, areas from the hull table."""
    beta = p["beta_w_deg"] * (ca.pi / 180)
    u_w = -p["V_w_m_s"] * ca.cos(beta - eta[2])
    v_w = -p["V_w_m_s"] * ca.sin(beta - eta[2])
    u_rw, v_rw = nu[0] - u_w, nu[1] - v_w
    speed2 = u_rw**2 + v_rw**2
    gamma = -ca.atan2(v_rw, u_rw + 1e-9)
    q = 0.5 * RHO_AIR * speed2
    hull = vessel.hull
    X = -p["c_x"] * ca.cos(gamma) * q * hull.frontal_area_m2
    Y = p["c_y"] * ca.sin(gamma) * q * hull.lateral_area_m2
    N = p["c_n"] * ca.sin(2 * gamma) * q * hull.lateral_area_m2 * hull.length_m
    return X, Y, N


def _speed_damping(p: Mapping[str, Any], nu_r: Any) -> tuple[Any, Any, Any]:
    """Fossen (2011), section 7.1: second-order modulus, |u| r in yaw: lift of skeg and after-body against turning."""
    return 0.0, 0.0, p["N_ur_N_s2"] * ca.fabs(nu_r[0]) * nu_r[2]


def _munk_moment(p: Mapping[str, Any], nu_r: Any) -> tuple[Any, Any, Any]:
    """Fossen (2011), section 6.5: the moment (X_udot - Y_vdot) u v of potential flow, as far as M does not hold it."""
    return 0.0, 0.0, p["k_kg"] * nu_r[0] * nu_r[1]


def _tether(p: Mapping[str, Any], vessel: Any, eta: Any, nu: Any) -> tuple[Any, Any, Any]:
    """A spring that does not push: F = k max(d - slack, 0) along the line of length d to the anchor."""
    north, east = p["north_m"] - eta[0], p["east_m"] - eta[1]
    d = ca.sqrt(north**2 + east**2 + 1e-12)
    pull = p["stiffness_N_m"] * ca.fmax(1 - p["slack_m"] / d, 0.0)
    ahead, starboard = unrotate(eta[2], north, east)
    return pull * ahead, pull * starboard, 0.0


EDGE_SHARE = 0.1
"""Width of a shallow zone's edge over its radius; assumed."""


def _shallow_zone(p: Mapping[str, Any], eta: Any) -> Any:
    """1 + share w, w from 1 inside to 0 outside over an edge of `EDGE_SHARE` of the radius."""
    d = ca.sqrt((eta[0] - p["north_m"]) ** 2 + (eta[1] - p["east_m"]) ** 2 + 1e-12)
    return 1 + p["share"] * (1 - ca.tanh((d / p["radius_m"] - 1) / EDGE_SHARE)) / 2


REGISTRY: dict[str, Term] = {
    term.name: term
    for term in (
        Term(
            "current",
            "nu_c = R(psi)^T V_c [cos beta_c, sin beta_c]; the hull feels nu_r = nu - nu_c",
            (
                LoadParameter("V_c_m_s", "m/s", 0.0, 0.0, 2.0, "speed of the water over ground"),
                LoadParameter("beta_c_deg", "deg", 0.0, -360.0, 360.0, "direction it flows towards, from north"),
            ),
            water_velocity=_current,
        ),
        Term(
            "wind",
            "X = -c_x cos(gamma) q A_F, Y = c_y sin(gamma) q A_L, N = c_n sin(2 gamma) q A_L L, "
            "q = rho V_rw^2 / 2, gamma = -atan2(v_rw, u_rw)",
            (
                LoadParameter("V_w_m_s", "m/s", 0.0, 0.0, 25.0, "wind speed"),
                LoadParameter("beta_w_deg", "deg", 0.0, -360.0, 360.0, "direction it comes from, from north"),
                LoadParameter("c_x", "1", 0.7, 0.0, 2.0, "longitudinal coefficient; Fossen 0.5-0.9 for ships"),
                LoadParameter("c_y", "1", 0.9, 0.0, 2.0, "lateral coefficient; Fossen 0.7-0.95 for ships"),
                LoadParameter("c_n", "1", 0.1, -0.5, 0.5, "yaw coefficient; Fossen 0.05-0.2 for ships"),
            ),
            force=_wind,
        ),
        Term(
            "speed_damping",
            "N = N_ur |u_r| r: turning is damped the more the faster the boat goes ahead or astern",
            (LoadParameter("N_ur_N_s2", "N s2", 0.0, -1000.0, 0.0, "yaw moment of |u_r| r", fitted=True),),
            hull_force=_speed_damping,
        ),
        Term(
            "munk_moment",
            "N = k u_r v_r: a slender hull turns across the flow",
            (LoadParameter("k_kg", "kg", 0.0, -500.0, 500.0, "yaw moment of u_r v_r", fitted=True),),
            hull_force=_munk_moment,
        ),
        Term(
            "tether",
            "F = stiffness max(d - slack, 0) towards the anchor, at the body origin; d: distance to the anchor",
            (
                LoadParameter("north_m", "m", 0.0, -1000.0, 1000.0, "place of the anchor, site axes"),
                LoadParameter("east_m", "m", 0.0, -1000.0, 1000.0, "the same, east"),
                LoadParameter("slack_m", "m", 0.0, 0.0, 1000.0, "length up to which the tether hangs loose"),
                LoadParameter("stiffness_N_m", "N/m", 0.0, 0.0, 1000.0, "force per metre beyond that"),
            ),
            force=_tether,
        ),
        Term(
            "shallow_zone",
            "D (1 + share w), w = (1 - tanh((d / radius - 1) / 0.1)) / 2; d: distance to the middle of the zone",
            (
                LoadParameter("north_m", "m", 0.0, -1000.0, 1000.0, "middle of the zone, site axes"),
                LoadParameter("east_m", "m", 0.0, -1000.0, 1000.0, "the same, east"),
                LoadParameter("radius_m", "m", 1.0, 0.01, 1000.0, "where half of it is felt"),
                LoadParameter("share", "1", 0.0, -0.9, 20.0, "extra damping inside over that outside"),
            ),
            damping_factor=_shallow_zone,
        ),
    )
}


def problems(chosen: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """What is wrong with the `[terms.*]` tables of a vessel file, as `terms.current.x: ...`."""
    for name, values in chosen.items():
        if name not in REGISTRY:
            yield f"terms.{name}: no such term; there are {sorted(REGISTRY)}"
            continue
        known = {p.name: p for p in REGISTRY[name].parameters}
        if not str(values.get("source", "")).strip():
            yield f"terms.{name}.source: missing key"
        for key, value in values.items():
            if key == "source":
                continue
            if key not in known:
                yield f"terms.{name}.{key}: unknown key; there are {sorted(known)}"
            elif not isinstance(value, (int, float)):
                yield f"terms.{name}.{key}: expected a number"
            elif not known[key].lower <= value <= known[key].upper:
                yield f"terms.{name}.{key}: expected {known[key].lower} to {known[key].upper}, found {value}"


def values(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters of a term: those given, else the defaults."""
    return {p.name: given.get(p.name, p.default) for p in REGISTRY[name].parameters}
