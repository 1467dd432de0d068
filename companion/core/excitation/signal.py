"""From a segment to thruster forces over time, for one vessel.

    steps, zigzag, multisine   tau(t) = share(t) x what the thrusters can do along each axis alone; f by allocation
    pulses, opposed            f(t) itself; opposed: along the directions f with B f = 0
    multisine                  s(t) = c sum_k cos(2 pi k t / T - pi j (j - 1) / J), j-th of the axis' J harmonics k

c makes the largest |s| of a period 1. Harmonics 1, 2, 3 ... are dealt to the excited axes in turn, so that no two
axes share one.   Schroeder (1970), IEEE Trans. Inf. Theory 16, 85-89.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import linprog

from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.allocation import allocate, force_limits
from companion.core.excitation.file import (
    Excitation,
    Idle,
    Multisine,
    Opposed,
    Pulses,
    Segment,
    Steps,
    Zigzag,
    axes_count,
    harmonics_count,
)
from companion.core.model.actuators.propulsion import only_fixed
from companion.core.model.thrusters import configuration_matrix

GRID = 2048
"""Instants of a period at which a multisine's peak is looked for."""
NEAR = 1e-2
"""A body force is within reach where allocation comes so near to it, as a share; it spares effort a little."""
AXES = ("X", "Y", "N")


@dataclass(frozen=True)
class Signal:
    """What a segment commands: `force(t_s, side)` gives thruster forces [N], (n,), for t_s in 0..duration_s.

    `switch_rad`: by how much the heading may turn before `side` (1 or -1) changes; None where side plays no part.
    """

    duration_s: float
    force: Callable[[float, float], np.ndarray]
    switch_rad: float | None = None


def reach(direction: np.ndarray, vessel: VesselFile) -> float:
    """Largest s >= 0 with B f = s direction within the thrusters' limits; 0 where there is none."""
    B, (lower, upper) = configuration_matrix(vessel), force_limits(vessel)
    n = B.shape[1]
    A = np.column_stack([B, -np.asarray(direction, dtype=float)])
    bounds = [*zip(lower, upper, strict=True), (0.0, 1e9)]
    found = linprog(np.eye(n + 1)[-1] * -1.0, A_eq=A, b_eq=np.zeros(3), bounds=bounds, method="highs")
    return float(found.x[-1]) if found.status == 0 else 0.0


def axis_reach(vessel: VesselFile) -> np.ndarray:
    """Force along each axis alone [N, N, N m], shape (3, 2): ahead (to +), astern (to -), both positive."""
    return np.array([[_solid(reach(sign * axis, vessel)) for sign in (1.0, -1.0)] for axis in np.eye(3)])


def _solid(value: float) -> float:
    return value if value > 1e-3 else 0.0  # rounding of the linear programme, not a force


def cancelling(vessel: VesselFile) -> np.ndarray:
    """Directions f with B f = 0, shape (k, n), each as large as the limits allow both ways."""
    lower, upper = force_limits(vessel)
    found = []
    for direction in null_space(configuration_matrix(vessel)).T:
        with np.errstate(divide="ignore"):
            room = np.minimum(np.minimum(upper, -lower) / np.abs(direction), np.inf)
        found.append(direction * room[np.abs(direction) > 1e-9].min() * np.sign(direction[np.abs(direction).argmax()]))
    return np.array(found).reshape(-1, len(lower))


def signals(excitation: Excitation, vessel: VesselFile, *, name: str) -> tuple[Signal, ...]:
    """Every segment for this vessel. Raises ConfigError naming file and key where it asks for what it cannot give."""
    only_fixed(vessel, f"vessel {vessel.name}", "excitations")
    return tuple(signal(s, vessel, where=f"{name}: segments[{i}]") for i, s in enumerate(excitation.segments))


def signal(segment: Segment, vessel: VesselFile, *, where: str) -> Signal:
    """One segment for this vessel. Raises ConfigError that begins with `where`."""
    match segment:
        case Steps():
            return _steps(segment, vessel, where)
        case Zigzag():
            return _zigzag(segment, vessel, where)
        case Multisine():
            return _multisine(segment, vessel, where)
        case Pulses():
            return _pulses(segment, vessel, where)
        case Opposed():
            return _opposed(segment, vessel, where)
        case Idle():
            return Signal(segment.duration_s, lambda t_s, side: np.zeros(len(vessel.thrusters)))


def _steps(s: Steps, vessel: VesselFile, where: str) -> Signal:
    wanted = np.outer(s.levels, (s.X, s.Y, s.N))
    forces = np.array([allocate(tau, vessel) for tau in _body(wanted, vessel, where)])
    return Signal(len(forces) * s.hold_s, _held(forces, s.hold_s))


def _held(forces: np.ndarray, hold_s: float) -> Callable[[float, float], np.ndarray]:
    """Rows of `forces` one after the other."""
    return lambda t_s, side: forces[min(max(int(t_s / hold_s), 0), len(forces) - 1)]


def _zigzag(s: Zigzag, vessel: VesselFile, where: str) -> Signal:
    tau = _body(np.array([[s.X, 0.0, s.N], [s.X, 0.0, -s.N]]), vessel, where)
    to_starboard, to_port = (allocate(row, vessel) for row in tau)
    return Signal(s.duration_s, lambda t_s, side: to_starboard if side > 0 else to_port, math.radians(s.switch_deg))


def _multisine(s: Multisine, vessel: VesselFile, where: str) -> Signal:
    share = np.array([s.X, s.Y, s.N])
    waves = [multisine(k) if len(k) else None for k in harmonics(s)]

    def at(phase: np.ndarray) -> np.ndarray:
        """Shares (len(phase), 3) at phases of the period in 0..1."""
        return share * np.stack([np.zeros_like(phase) if w is None else w(phase) for w in waves], axis=-1)

    _body(at(np.arange(GRID) / GRID), vessel, where, every=16)
    limits = axis_reach(vessel)

    def force(t_s: float, side: float) -> np.ndarray:
        wanted = at(np.array([t_s / s.period_s]))
        return allocate(_scaled(wanted, limits)[0], vessel)

    return Signal(s.periods * s.period_s, force)


def harmonics(s: Multisine) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Harmonics of each axis; empty where it is not excited."""
    every, turns = np.arange(1, harmonics_count(s) + 1), axes_count(s)
    turn = iter(range(turns))
    x, y, n = (every[next(turn) :: turns] if share > 0 else every[:0] for share in (s.X, s.Y, s.N))
    return x, y, n


def multisine(k: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Sum of cosines at harmonics `k` with Schroeder's phases and a peak of 1, over phases of the period."""
    j = np.arange(1, len(k) + 1)
    phi = -np.pi * j * (j - 1) / len(k)

    def raw(phase: np.ndarray) -> np.ndarray:
        return np.cos(2 * np.pi * np.multiply.outer(phase, k) + phi).sum(axis=-1)

    peak = np.abs(raw(np.arange(GRID) / GRID)).max()
    return lambda phase: raw(phase) / peak


def _pulses(s: Pulses, vessel: VesselFile, where: str) -> Signal:
    names = [t.name for t in vessel.thrusters]
    if strangers := [name for name in s.thrusters if name not in names]:
        raise ConfigError(f"{where}.thrusters: no thruster {strangers[0]!r}; {vessel.name} has {', '.join(names)}")
    lower, upper = force_limits(vessel)
    levels = np.array(s.levels)
    sizes = np.where(levels[:, None] > 0, levels[:, None] * upper, -levels[:, None] * lower)
    which = [names.index(name) for name in s.thrusters or names]
    forces = np.concatenate([sizes[:, [i]] * np.eye(len(names))[i] for i in which])
    cycle_s = s.on_s + s.off_s

    def force(t_s: float, side: float) -> np.ndarray:
        turn = min(int(t_s / cycle_s), len(forces) - 1)
        return forces[turn] if t_s - turn * cycle_s < s.on_s else np.zeros(len(names))

    return Signal(len(forces) * cycle_s, force)


def _opposed(s: Opposed, vessel: VesselFile, where: str) -> Signal:
    ways = cancelling(vessel)
    if not len(ways):
        raise ConfigError(f"{where}.kind: no two thrusters of {vessel.name} can cancel each other: leave it out")
    forces = np.concatenate([np.outer(s.levels, way) for way in ways])
    return Signal(len(forces) * s.hold_s, _held(forces, s.hold_s))


def _scaled(shares: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Shares of what an axis can do (m, 3) -> tau (m, 3); `limits` as `axis_reach`."""
    return shares * np.where(shares >= 0, limits[:, 0], limits[:, 1])


def _body(shares: np.ndarray, vessel: VesselFile, where: str, *, every: int = 1) -> np.ndarray:
    """tau (m, 3) of shares (m, 3), after a look whether each `every`-th is within reach. Raises ConfigError."""
    limits = axis_reach(vessel)
    for i, axis in enumerate(AXES):
        if np.any(shares[:, i]) and not limits[i].all():
            raise ConfigError(f"{where}.{axis}: the thrusters of {vessel.name} give no such force by itself")
    tau, B = _scaled(shares, limits), configuration_matrix(vessel)
    for row in tau[::every]:
        if np.abs(B @ allocate(row, vessel) - row).max() > NEAR * (1 + np.abs(row).max()):
            raise ConfigError(
                f"{where}: X, Y and N together ask for more than the thrusters of {vessel.name} can do; "
                f"all shares times {reach(row, vessel):.2f} would be within reach"
            )
    return tau
