"""What an optional load is: its equation, its parameters with unit, default and bounds, and what it adds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

Values = Mapping[str, Any]
"""Parameters of a load by name."""


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
    """One effect. `equation`: what the callables compute, for people. eta = [x y psi], nu = [u v r].

    water_velocity    (p, t_s) -> (north, east) [m/s]           velocity of the water over ground; t_s None: not known
    force             (p, vessel, eta, nu) -> (X, Y, N)         body force [N, N, N m]
    hull_force        (p, vessel, nu_r) -> (X, Y, N)            of the water on the hull at nu_r = nu - nu_c
    damping_factor    (p, eta) -> factor [1]                    by which all damping of the hull is larger here
    """

    name: str
    equation: str
    parameters: tuple[LoadParameter, ...]
    water_velocity: Callable[[Values, Any], tuple[Any, Any]] | None = None
    force: Callable[[Values, Any, Any, Any], tuple[Any, Any, Any]] | None = None
    hull_force: Callable[[Values, Any, Any], tuple[Any, Any, Any]] | None = None
    damping_factor: Callable[[Values, Any], Any] | None = None
