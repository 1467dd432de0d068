"""Optional model terms by name: effects that a boat may or may not have, usable wherever the model is.

A term is one entry of REGISTRY: its equation, its parameters with unit and bounds, and what it adds:

    water_velocity(p, eta)        -> (north, east) [m/s]    velocity of the water over ground
    force(p, vessel, eta, nu)     -> (X, Y, N) [N, N, N m]  body force

Both are written with CasADi expressions, so the plant, the filter, the NMPC and the fits use the same line.
A vessel file switches one on with a table `[terms.NAME]`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

RHO_AIR = 1.225  # kg/m^3, ISA at sea level and 15 C


@dataclass(frozen=True)
class Parameter:
    """One number of a term: its unit, default and the bounds within which it makes sense."""

    name: str
    unit: str
    default: float
    lower: float
    upper: float
    meaning: str


@dataclass(frozen=True)
class Term:
    """One effect. `equation` is for people and says what the callables compute."""

    name: str
    equation: str
    parameters: tuple[Parameter, ...]
    water_velocity: Callable[[Mapping[str, Any], Any], tuple[Any, Any]] | None = None
    force: Callable[[Mapping[str, Any], Any, Any, Any], tuple[Any, Any, Any]] | None = None


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


REGISTRY: dict[str, Term] = {
    term.name: term
    for term in (
        Term(
            "current",
            "nu_c = R(psi)^T V_c [cos beta_c, sin beta_c]; the hull feels nu_r = nu - nu_c",
            (
                Parameter("V_c_m_s", "m/s", 0.0, 0.0, 2.0, "speed of the water over ground"),
                Parameter("beta_c_deg", "deg", 0.0, -360.0, 360.0, "direction it flows towards, from north"),
            ),
            water_velocity=_current,
        ),
        Term(
            "wind",
            "X = -c_x cos(gamma) q A_F, Y = c_y sin(gamma) q A_L, N = c_n sin(2 gamma) q A_L L, "
            "q = rho V_rw^2 / 2, gamma = -atan2(v_rw, u_rw)",
            (
                Parameter("V_w_m_s", "m/s", 0.0, 0.0, 25.0, "wind speed"),
                Parameter("beta_w_deg", "deg", 0.0, -360.0, 360.0, "direction it comes from, from north"),
                Parameter("c_x", "1", 0.7, 0.0, 2.0, "longitudinal coefficient; Fossen 0.5-0.9 for ships"),
                Parameter("c_y", "1", 0.9, 0.0, 2.0, "lateral coefficient; Fossen 0.7-0.95 for ships"),
                Parameter("c_n", "1", 0.1, -0.5, 0.5, "yaw coefficient; Fossen 0.05-0.2 for ships"),
            ),
            force=_wind,
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
