"""What all actuators have in common: the force of each as components along directions that are fixed in the boat.

    tau = sum over actuators of D e(nu_r, f)        D (3, m): `directions`; e (m,) [N]: `components`

nu_r: velocity through the water; f: the states of its channels, thrust [N] first, then the angle [rad] of its servo.
A fixed thruster has one component, its thrust; one that turns, or has a rudder, has two. Controllers wish for
components, which are forces, and `controls` says what to command for them.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import casadi as ca
import numpy as np

from companion.core.model.actuators.channel import Channel


class Actuator(Protocol):
    """One actuator of a boat."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Its channels, in the order of its states."""
        ...

    @property
    def directions(self) -> np.ndarray:
        """D, shape (3, m): X [N], Y [N], N [N m] of one newton of each component."""
        ...

    @property
    def at_rest(self) -> tuple[bool, ...]:
        """Which components it can give at will, and apart from the others, to a boat that lies still."""
        ...

    def components(self, nu_r: Any, f: Any) -> list[Any]:
        """e, m values [N]: numbers or CasADi expressions."""
        ...

    def limits(self, nu_r: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest of each component [N], shapes (m,), at this velocity; None: at rest."""
        ...

    def controls(
        self, e: np.ndarray, nu_r: np.ndarray | None, now: np.ndarray, within_s: float = math.inf
    ) -> np.ndarray:
        """Commands for components e (m,) [N] as near as its limits let it; `nu_r` None: not known.

        `now`: what is commanded already; `within_s`: until the next command, in which a servo turns so far only.
        """
        ...


def direction(x_m: float, y_m: float, azimuth_rad: float) -> np.ndarray:
    """(3,): X, Y, N of one newton at (x, y) towards `azimuth_rad`; N = x sin(a) - y cos(a)."""
    c, s = np.cos(azimuth_rad), np.sin(azimuth_rad)
    return np.array([c, s, x_m * s - y_m * c])


def positive(value: Any, smooth: float) -> Any:
    """max(value, 0), rounded off below `smooth` so that it has a slope everywhere, and 0 at 0."""
    z = ca.fmax(value, 0.0)
    return z**2 / ca.sqrt(z**2 + smooth**2)
