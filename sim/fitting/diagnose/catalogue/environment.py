"""Effects of the environment: current, wind, tether, shallow water (Fossen 2011, chapter 8). Vectors in NED."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.effects import shallow_zone
from companion.core.model.effects.current import turned
from companion.core.model.effects.shallow_zone import EDGE_M
from companion.core.model.effects.tether import spring
from companion.core.model.effects.wind import RHO_AIR, steady_speed
from companion.core.model.loads import values
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter, Scene, Values
from sim.fitting.diagnose.catalogue.parts import (
    air_force,
    hull_damping,
    moving,
    scalar_parameter,
    stacked,
    vector_parameters,
)

FASTEST_DEG_S = 1.2  # largest turn rate of a current from which the search starts; assumed
PHASE_RAD = 1.0  # difference of neighbouring starts at the ends of the logs
PRESSURE = RHO_AIR / 2  # dynamic pressure of a wind of 1 m/s [Pa]
PULL_N = 0.75  # smallest pull worth a name at the middle of the positions: the smallest stiffness at 15 m; assumed
ZONE_RADIUS_M = 4.0  # radius from which the search for a shallow zone starts; assumed
LEAST_RADIUS_M = 1.0  # of a zone; assumed


def effects(vessel: VesselFile, centres_m: tuple[tuple[float, float], ...], span_s: float) -> Iterator[Effect]:
    """Entries; `centres_m`: starts of the search for a zone (north, east); `span_s`: of all logs on one clock."""
    yield Effect(
        "current",
        "environment",
        "nu_r = nu - R^T V_c",
        "drifts the same way over ground whatever the heading, also with thrusters at rest",
        vector_parameters("north_m_s", "east_m_s", "m/s", 0.15, 0.02),
        {"water": lambda p, scene: np.broadcast_to([p["north_m_s"], p["east_m_s"]], (*scene.t_s.shape, 2))},
        vector=True,
    )
    step = 2 * np.degrees(PHASE_RAD) / span_s
    for turn in np.arange(step, FASTEST_DEG_S + step, 2 * step):
        yield from (_turning(float(turn), step), _turning(-float(turn), step))
    if vessel.hull.frontal_area_m2 > 0 or vessel.hull.lateral_area_m2 > 0:
        yield Effect(
            "wind",
            "environment",
            "tau += c q(V_rw) A (Fossen 2011, 8.1)",
            "pushed the same way over ground, most of all broadside on, even at rest",
            vector_parameters("north_Pa", "east_Pa", "Pa", 16 * PRESSURE, PRESSURE),
            {"force": lambda p, scene: _wind(vessel, scene, p)},
            vector=True,
        )
    for share in (-0.4, 0.0, 0.4):
        yield _tether(share * vessel.hull.length_m, 0.2 * vessel.hull.length_m)
    for i, centre in enumerate(centres_m):
        yield _shallow(vessel, i, centre)


def _turning(start_deg_s: float, around_deg_s: float) -> Effect:
    """A current that turns at start_deg_s + turn_deg_s about the middle of the clock, its direction there."""

    def water(p: Values, scene: Scene) -> np.ndarray:
        turn_deg_s, since_s = start_deg_s + p["turn_deg_s"], scene.clock_s - scene.middle_s
        return np.stack(turned(p["north_m_s"], p["east_m_s"], turn_deg_s, since_s), axis=-1)

    return Effect(
        f"turning_current@{start_deg_s:.3f}",
        "environment",
        "nu_r = nu - R^T V_c,  V_c turns steadily",
        "drifts as in a current whose direction changes over minutes",
        (
            *vector_parameters("north_m_s", "east_m_s", "m/s", 0.15, 0.02),
            EffectParameter("turn_deg_s", "deg/s", around_deg_s, np.inf, 0.02),
        ),
        {"water": water},
        vector=True,
        variant_of="turning_current",
        origin={"turn_deg_s": start_deg_s},
        contains="current",
    )


def _wind(vessel: VesselFile, scene: Scene, p: Values) -> np.ndarray:
    """Wind force (W, k, 3) by the dynamic pressure vector q = rho/2 V^2 [cos, sin](direction it blows towards) [Pa].

    It is that of the term of the vessel file, with q added to the wind of the file. On a boat at rest the force is
    linear in q, whereas V = sqrt(2 q / rho) has an infinite slope at zero. On a moving boat light air is not linear in
    q either, so below `PRESSURE` the force is blended into

        q_N / PRESSURE (F(1 m/s from S) - F(1 m/s from N)) / 2, and the same for east,

    the central difference of 1 m/s along each axis: smooth through zero, without the drag of the boat's own speed.
    """
    north, east = p["north_Pa"], p["east_Pa"]
    whole = float(np.clip(2 * np.hypot(north, east) / PRESSURE - 1, 0.0, 1.0)) ** 2
    force = np.zeros((*scene.t_s.shape, 3))
    if whole > 0:
        force += whole * (air_force(vessel, scene, *beside_file(vessel, north, east)) - _air_of_file(vessel, scene))
    if whole < 1:
        for along, beta in ((north, 180.0), (east, 270.0)):
            if along:
                both = air_force(vessel, scene, 1.0, beta) - air_force(vessel, scene, 1.0, beta - 180.0)
                force += (1 - whole) * along / PRESSURE * both / 2
    return force


def _air_of_file(vessel: VesselFile, scene: Scene) -> Any:
    """Force of the air that the model of the file has already: none without the term."""
    now = vessel.terms.get("wind")
    return 0.0 if now is None else air_force(vessel, scene, *beside_file(vessel, 0.0, 0.0))


def beside_file(vessel: VesselFile, north_Pa: float, east_Pa: float) -> tuple[float, float]:
    """Speed [m/s] and direction [deg] of the file's steady wind with a dynamic pressure vector added to its own."""
    now = values("wind", vessel.terms.get("wind", {}))
    own, angle = RHO_AIR / 2 * steady_speed(now) ** 2, np.radians(now["beta_w_deg"])
    north, east = north_Pa - own * np.cos(angle), east_Pa - own * np.sin(angle)
    speed = float(np.sqrt(2 * np.hypot(north, east) / RHO_AIR))
    return speed, float(np.degrees(np.arctan2(-east, -north))) if speed else now["beta_w_deg"]


def _tether(arm_m: float, around_m: float) -> Effect:
    """A linear spring f_0 - k p at `arm_m` on the centreline, p from the centre of the positions.

    Without stiffness f_0 is a constant force, and its anchor nowhere.
    """

    def force(p: Values, scene: Scene) -> np.ndarray:
        seen = (scene.north_m - scene.centre_m[0], scene.east_m - scene.centre_m[1], scene.psi_rad)
        return stacked(spring((p["north_N"], p["east_N"]), p["k_N_m"], arm_m + p["arm_m"], seen))

    return Effect(
        f"tether@{arm_m:+.1f}",
        "environment",
        "tau += (f_0 - k p) at a place on the centreline",
        "pulled towards one place, harder the further away",
        (
            *scalar_parameter("k_N_m", "N/m", 0.5, 0.05, 0.0, 100.0),
            EffectParameter("north_N", "N", 5.0, PULL_N, 0.5),
            EffectParameter("east_N", "N", 5.0, PULL_N, 0.5),
            EffectParameter("arm_m", "m", around_m, np.inf, 0.05),
        ),
        {"force": force},
        variant_of="tether",
        origin={"arm_m": arm_m},
        essential="k_N_m",
    )


def _shallow(vessel: VesselFile, i: int, centre: tuple[float, float]) -> Effect:
    """A circle round `centre` in which all damping is (1 + share) times that of the hull."""

    def force(p: Values, scene: Scene) -> np.ndarray:
        zone = {"north_m": centre[0] + p["north_m"], "east_m": centre[1] + p["east_m"], "share": p["share"],
                "radius_m": max(ZONE_RADIUS_M + p["radius_m"], LEAST_RADIUS_M), "edge_m": EDGE_M}  # fmt: skip
        more = shallow_zone.damping_factor(zone, moving(scene)[0]) - 1
        return -more[..., None] * hull_damping(vessel, scene)

    where = (EffectParameter(name, "m", 2.0, np.inf, 0.5) for name in ("north_m", "east_m", "radius_m"))
    return Effect(
        f"shallow_zone@{i}",
        "environment",
        "D (1 + share) within a circle",
        "sluggish in one part of the basin",
        (*scalar_parameter("share", "1", 0.8, 0.15, 0.0, 10.0), *where),
        {"force": force},
        variant_of="shallow_zone",
        origin={"north_m": centre[0], "east_m": centre[1], "radius_m": ZONE_RADIUS_M},
    )
