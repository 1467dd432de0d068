"""What is watched, how far it is known at first, how it drifts, and which changes are told by name.

Every size that nobody has measured says so: assumed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from sim.commission.watch.mission_fit import MissionInformation
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.catalogue.hull import DAMPING
from sim.fitting.diagnose.vessel_edits.public_form import family

FIRST = 0.05
"""Sigma of a share at first: a file that was identified or commissioned is as near as this; assumed."""
DRIFT = 0.003
"""Sigma of a share's drift from one mission to the next: 3 % in a hundred missions, wear and growth; assumed."""
TIME_S = 0.15
"""Time that counts as much as a share of 1 of a force: thrust late by that is another thrust; assumed."""
LEAST = 0.01
"""Least share that a mission may feign: load, battery and water differ from day to day; assumed."""
LEAST_THRUST = 1e-3  # m/s^2, rad/s^2: a boat that hardly moved
STEADY = (2.0, 0.7, 0.7)
"""By axis, error of damping over rho: gusts that last as long as a leg; in surge, where the boat has its speed, also
speeds that are wrong by ranges without line of sight. Fitted to forty simulated missions.
"""
SUMS = ("hull_fouling", "payload")
AXES = (("X_", "M11"), ("Y_", "M22", "M23"), ("N_", "M33"))
SURGE = ("base:X_u_N_s_m", "base:X_uu_N_s2_m2")


@dataclass(frozen=True)
class Cause:
    """A change that can be told: `direction` (B,) of theta by size 1; `sigma` of its size; `smallest` worth a name.

    `kind`: thruster, drag, surge drag, mass or dead time; `name`: as in findings; `unit`: of the size, 1: a share.
    """

    name: str
    kind: str
    direction: np.ndarray
    sigma: float
    smallest: float
    unit: str


@dataclass(frozen=True)
class Watched:
    """The watched parameters of a boat: names (B,), scale (B,) [own units a share of 1], and causes."""

    names: tuple[str, ...]
    scale: np.ndarray
    causes: tuple[Cause, ...]


def watched(vessel: VesselFile, effects: Sequence[Effect]) -> Watched:
    """Of the watched entries of the catalogue, in the order of a mission's theta."""
    names = tuple(e.id for e in effects)
    scale = np.array([_scale(e, vessel) for e in effects])
    causes = [_cause(e, names) for e in effects if family(e.name) in KINDS]
    surge = np.array([1.0 if name in SURGE else 0.0 for name in names])
    fouling = next(c for c in causes if c.kind == "drag")
    causes.append(Cause("surge_drag", "surge drag", surge, fouling.sigma, fouling.smallest, "1"))
    return Watched(names, scale, tuple(causes))


KINDS = {"thruster_gain": "thruster", "hull_fouling": "drag", "payload": "mass", "dead_time": "dead time"}


def _cause(effect: Effect, names: tuple[str, ...]) -> Cause:
    (parameter,) = effect.parameters
    direction = np.array([1.0 if name == effect.id else 0.0 for name in names])
    kind = KINDS[family(effect.name)]
    return Cause(effect.name, kind, direction, parameter.prior, parameter.smallest, parameter.unit)


def _scale(effect: Effect, vessel: VesselFile) -> float:
    units = {"kg": vessel.inertia.mass_kg, "s": TIME_S, "1": 1.0}
    return units[effect.parameters[0].unit]


def unexplained(mission: MissionInformation) -> np.ndarray:
    """Share (B,) of each parameter that what the model does not explain in this mission may feign.

    With rho of an axis the latent acceleration over that by thrust:

        damping                STEADY rho      a steady disturbance is a drag: at speed, drag is what thrust balances
        gains, inertia, times  rho^2           the controller answers the disturbance, so that both hang together;
                                               of the parameter's axis or the mean over all, whichever is larger

    In forty simulated missions, calm, in gusts and in waves, errors were of these sizes. Effects that are sums of
    others (fouling, payload) have these others' errors.
    """
    rho = np.array(mission.latent) / np.maximum(np.array(mission.thrust), LEAST_THRUST)
    squared = np.maximum(rho**2, (rho**2).mean())
    return np.array([_share(name, rho, squared) for name in mission.names])


def _share(name: str, rho: np.ndarray, squared: np.ndarray) -> float:
    if name in SUMS:
        return LEAST
    own = name.removeprefix("base:")
    axis = next((axis for axis, keys in enumerate(AXES) if own.startswith(keys)), 0)
    steady = STEADY[axis] * rho[axis] if own in DAMPING else 0.0
    return float(max(LEAST, squared[axis], steady))
