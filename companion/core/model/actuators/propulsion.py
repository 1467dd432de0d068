"""All actuators of a boat: the one place that says which object a table of the vessel file is.

    f = [thrusts of all thrusters, in the order of the file; angles of all servos, in the order of their thrusters]
    tau = D e(nu_r, f)                D (3, m), e (m,): those of the actuators side by side

A boat of fixed thrusters has e = f and D = B; for it nothing here is evaluated while it drives.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.actuators.actuator import Actuator
from companion.core.model.actuators.azimuth_thruster import AzimuthThruster
from companion.core.model.actuators.channel import Channel
from companion.core.model.actuators.fixed_thruster import FixedThruster
from companion.core.model.actuators.rudder_propeller import RudderPropeller


def is_steered(vessel: VesselFile) -> bool:
    """Whether anything of it turns: a thruster, a rudder."""
    return bool(vessel.servos)


@dataclass(frozen=True)
class ActuatorSet:
    """Actuators in the order of the vessel file's thrusters, and where in f the channels of each are."""

    actuators: tuple[Actuator, ...]
    places: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, vessel: VesselFile) -> ActuatorSet:
        """The actuators of a vessel file."""
        servo, actuators, places = len(vessel.thrusters), list[Actuator](), list[tuple[int, ...]]()
        for i, t in enumerate(vessel.thrusters):
            fmap, p = vessel.force_maps[t.force_map], vessel.propulsion
            if t.steering:
                actuators.append(AzimuthThruster(t, t.steering, fmap, p))
            elif t.rudder:
                actuators.append(RudderPropeller(t, t.rudder, fmap, p))
            else:
                actuators.append(FixedThruster(t, fmap, p))
            places.append((i, servo) if t.servos else (i,))
            servo += len(t.servos)
        return cls(tuple(actuators), tuple(places))

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """All channels, in the order of f."""
        at = {i: c for a, place in self._each() for i, c in zip(place, a.channels, strict=True)}
        return tuple(at[i] for i in range(len(at)))

    @cached_property
    def directions(self) -> np.ndarray:
        """D, shape (3, m)."""
        return np.hstack([a.directions for a in self.actuators])

    @property
    def thrust_places(self) -> list[int]:
        """Where in f the thrust of each component's actuator is, (m,)."""
        return [place[0] for a, place in self._each() for _ in range(a.directions.shape[1])]

    @property
    def at_rest(self) -> np.ndarray:
        """Columns of D that a boat that lies still can have at will, shape (3, k)."""
        return self.directions[:, [yes for a in self.actuators for yes in a.at_rest]]

    def components(self, nu_r: Any, f: Any) -> Any:
        """e (m,) [N]; CasADi expressions."""
        return ca.vertcat(*(e for a, place in self._each() for e in a.components(nu_r, [f[i] for i in place])))

    def limits(self, nu_r: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest of each component [N], shapes (m,)."""
        lower, upper = zip(*(a.limits(nu_r) for a in self.actuators), strict=True)
        return np.concatenate(lower), np.concatenate(upper)

    def controls(
        self, e: np.ndarray, nu_r: np.ndarray | None, now: np.ndarray, within_s: float = math.inf
    ) -> np.ndarray:
        """Commands (n,) for components e (m,), see `Actuator.controls`."""
        f, first = np.zeros(len(self.channels)), 0
        for a, place in self._each():
            m = a.directions.shape[1]
            f[list(place)] = a.controls(e[first : first + m], nu_r, now[list(place)], within_s)
            first += m
        return f

    def _each(self) -> Iterator[tuple[Actuator, tuple[int, ...]]]:
        return zip(self.actuators, self.places, strict=True)


def channels_of(vessel: VesselFile) -> tuple[Channel, ...]:
    """All channels of a boat, in the order of f."""
    return ActuatorSet.of(vessel).channels


def control_limits(vessel: VesselFile) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest command of each channel [N or rad], shapes (n,)."""
    lower, upper = zip(*((c.lower, c.upper) for c in channels_of(vessel)), strict=True)
    return np.array(lower), np.array(upper)


def only_fixed(vessel: VesselFile, name: str, what: str) -> None:
    """Raise ConfigError naming the file where `what` (in words, plural) cannot deal with the boat's actuators yet."""
    if is_steered(vessel):
        servos = ", ".join(servo.name for servo in vessel.servos)
        raise ConfigError(
            f"{name}: {what} are for boats of fixed thrusters so far; {vessel.name} has servos ({servos})"
        )
    for i, t in enumerate(vessel.thrusters):
        if t.lag_s is not None or t.dead_time_s is not None:
            raise ConfigError(
                f"{name}: thrusters[{i}]: {what} know one lag and one dead time so far, those of propulsion; "
                "leave lag_s and dead_time_s of thrusters out"
            )


def common(values: list[float]) -> float | np.ndarray:
    """One number where all are equal, else all of them."""
    return values[0] if len(set(values)) == 1 else np.array(values)
