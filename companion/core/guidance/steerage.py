"""How a boat is guided that is steered only while it makes way: by arcs that it can do, and with thrust off at the end.

    R_min = SPARE |[u v]| / r       of the steady turn at `RUDDER_SHARE` of the largest angle, with the thrust that
                                    drives the boat straight ahead at cruising speed

Boats that turn on the spot are guided as ever.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import ssa
from companion.core.guidance.course import LEG_SHARE, STRAIGHT_RAD
from companion.core.guidance.path import Path
from companion.core.guidance.reference import GuidanceSettings
from companion.core.model.actuators.propulsion import ActuatorSet, is_steered
from companion.core.model.integrate import FORCES, step_function
from companion.core.model.manoeuvring import StructuredModel

RUDDER_SHARE = 0.6
"""Of the largest angle: the rest is for current, wind and what the model does not know; assumed."""
SPARE = 1.25
"""Of the radius, for the time that a turn takes to begin; assumed."""
STEERAGE_SHARE = 0.5
"""Of cruising speed: slower a boat that needs way is not asked to be; assumed."""
STEP_S, TURN_S = 0.1, 60.0
"""Of the integration until the turn is steady; assumed: many times the time constants of such boats."""


def needs_way(vessel: VesselFile) -> bool:
    """Whether the boat is steered only while water flows past it: it cannot turn on the spot, nor keep station."""
    return is_steered(vessel) and bool(np.linalg.matrix_rank(ActuatorSet.of(vessel).at_rest[[0, 2]]) < 2)


def guidance_for(vessel: VesselFile, base: GuidanceSettings | None = None) -> GuidanceSettings:
    """`base` as this boat can do it."""
    base = base or GuidanceSettings()
    if not needs_way(vessel):
        return base
    limits, steerage = base.limits, STEERAGE_SHARE * base.limits.cruise_m_s
    radius = turning_radius_m(vessel, limits.cruise_m_s)
    rate = min(limits.yaw_rate_rad_s, limits.cruise_m_s / radius)
    limits = replace(limits, turning_radius_m=radius, yaw_rate_rad_s=rate, crawl_m_s=steerage)
    return replace(base, steerage_m_s=steerage, end="drift", limits=limits)


def turning_radius_m(vessel: VesselFile, speed_m_s: float) -> float:
    """R_min above [m] of a boat with rudders, in still water. ConfigError where the model runs away."""
    model, channels = StructuredModel.of(vessel), ActuatorSet.of(vessel).channels
    step = step_function(model, STEP_S)
    # 1. the thrust that holds the speed straight ahead, shared by all thrusters
    drag_n = float(model.damping(np.zeros(3), np.array([speed_m_s, 0.0, 0.0]))[0])
    thrust_n = drag_n / max(float(model.B[0].sum()), 1e-6)
    # 2. the steady turn with the rudders over
    f = np.array([thrust_n if c.unit == "N" else RUDDER_SHARE * c.upper for c in channels])
    x = np.zeros(6 + len(f))
    x[3], x[FORCES] = speed_m_s, f
    for _ in range(round(TURN_S / STEP_S)):
        x = np.array(step(x, f, np.zeros(3))).ravel()
    if not np.isfinite(x).all():
        raise ConfigError(f"{vessel.name}: its model runs away in a turn: look at damping and rudder")
    return float(SPARE * math.hypot(x[3], x[4]) / max(abs(x[5]), 1e-3))


def corner_problems(path: Path, settings: GuidanceSettings, first: int = 0) -> list[str]:
    """Corners of a path that this boat cannot round, in words; none for one that turns on the spot.

    `first`: index in the mission of the path's first point; people count from 1, as the map does.
    """
    return [f"waypoint {first + i + 1} {what}" for i, what in corner_faults(path, settings)]


def corner_faults(path: Path, settings: GuidanceSettings) -> list[tuple[int, str]]:
    """The same, each with the index of its point in the path."""
    radius = settings.limits.turning_radius_m
    if not radius:
        return []
    faults = []
    for i in range(1, len(path.lengths_m)):
        turn = abs(ssa(path.angles_rad[i] - path.angles_rad[i - 1]))
        if turn < STRAIGHT_RAD:
            continue
        needed = radius * math.tan(turn / 2)
        room = LEG_SHARE * min(path.lengths_m[i - 1], path.lengths_m[i])
        if needed > room:
            what = (
                f"cannot be rounded: the turn of {math.degrees(turn):.0f} deg needs {needed:.1f} m of either leg, "
                f"there is room for {room:.1f} m: this boat turns with a radius of {radius:.1f} m and "
                "cannot turn on the spot"
            )
            faults.append((i, what))
    return faults
