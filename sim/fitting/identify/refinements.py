"""Refinements of the model that many boats need and few vessel files have; `chosen_fit` tries them.

compass         the heading errs by a cos psi + b sin psi, as `wiring.compass` finds it
unmeasured boat  gains of single thrusters, places of tag and IMU, the compass: as open as those of a boat that nobody
                has measured; current and wind of the day are fitted beside it
speed_damping   N = N_ur |u| r      prior of the size that slender-wing theory gives a single hull of this length and
                                    draft, N_ur = -(pi / 8) rho T^2 L^2 (Jones 1946; Clarke et al. 1983, for B = 0)
munk_moment     N = k u v           either sign: what M lacks of the Munk moment, less the lift of the after-body
asymmetry       N = k |u| u         either sign: a keel, a thruster, a sensor's mast that is not quite straight
astern          F_astern times a share: the map is of open water, behind or before a hull a propeller gives less
wind            the air pushes, as the log measured the wind, by the file's areas and usual coefficients of ships
advance_loss    f - k |f| u_a: force maps are measured at rest, and a propeller that water comes towards gives less
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import ForceMap, PitchMap, VesselFile
from companion.core.constants import WATER_KG_M3
from companion.logs.runs.run import Run
from sim.fitting.engine.wind import is_measured
from sim.fitting.identify.result import FitResult

COMPASS, UNMEASURED_BOAT = "compass", "unmeasured boat"
"""Refinements of the heading, and of how little is taken for known."""
WIND = "wind"
"""Air on the hull, moved by the wind that a log measured; without that, or without areas, nothing is tried."""
SIZE_UNKNOWN = 1.5
"""Sigma of the logarithm of N_ur: a factor of 4.5 either way, for skegs and several hulls add to it; assumed."""
SOURCE = "tried by identify"
LOSS_S_M = 0.1
"""First guess of the advance loss: a tenth of the thrust at a metre per second; assumed."""


@dataclass(frozen=True)
class Refinement:
    """One refinement.

    `text`: for people; `applied`: the vessel with it, at its first guess, or as it is where it has it; `priors`:
    as `Parameters.overrides`; `absent`: how names of its parameters begin, and their value on a boat that has nothing
    of it, None where a prior keeps them from that.
    """

    name: str
    text: str
    applied: Callable[[VesselFile], VesselFile]
    priors: Mapping[str, tuple[float | None, float]] = field(default_factory=dict)
    absent: tuple[str, float] | None = None


def with_refinements(vessel: VesselFile, names: Collection[str]) -> VesselFile:
    """`vessel` with the refinements of these names."""
    for refinement in REFINEMENTS:
        vessel = refinement.applied(vessel) if refinement.name in names else vessel
    return vessel


def nothing_of(result: FitResult, names: Collection[str]) -> frozenset[str]:
    """Those of the refinements `names` of which the boat may have nothing, by the intervals of a fit that has them."""
    return frozenset(r.name for r in REFINEMENTS if r.name in names and r.absent and result.holds(*r.absent))


def missing(vessel: VesselFile, runs: Iterable[Run]) -> list[Refinement]:
    """Those that the vessel file does not have, and the logs can tell of."""
    hull = vessel.hull
    windy = bool(hull.frontal_area_m2 and hull.lateral_area_m2) and any(map(is_measured, runs))
    return [r for r in REFINEMENTS if r.applied(vessel) != vessel and (windy or r.name != WIND)]


def _astern(vessel: VesselFile) -> VesselFile:
    return replace(vessel, force_maps={name: _with_share(m) for name, m in vessel.force_maps.items()})


def _with_share(force_map: ForceMap) -> ForceMap:
    if isinstance(force_map, PitchMap) or force_map.astern_share is not None:
        return force_map
    return replace(force_map, astern_share=1.0)


def _speed_damping(vessel: VesselFile) -> VesselFile:
    wing = -np.pi / 8 * WATER_KG_M3 * (vessel.hull.draft_m * vessel.hull.length_m) ** 2
    return _with_term(vessel, "speed_damping", N_ur_N_s2=float(wing))


def _munk_moment(vessel: VesselFile) -> VesselFile:
    return _with_term(vessel, "munk_moment", k_kg=0.0)


def _asymmetry(vessel: VesselFile) -> VesselFile:
    return _with_term(vessel, "asymmetry", N_uu_N_s2_m=0.0)


def _wind(vessel: VesselFile) -> VesselFile:
    air = {"source": "air on the hull by its areas, usual coefficients of ships; no wind: it is the day's"}
    return replace(vessel, terms=vessel.terms | {WIND: vessel.terms.get(WIND, air)})


def with_advance_loss(vessel: VesselFile) -> VesselFile:
    """The vessel with a first guess of its thrusters' loss by advance, or as it is where it states one."""
    if vessel.propulsion.advance_loss_s_m:
        return vessel
    return replace(vessel, propulsion=replace(vessel.propulsion, advance_loss_s_m=LOSS_S_M))


def _with_term(vessel: VesselFile, name: str, **first: float) -> VesselFile:
    return replace(vessel, terms=vessel.terms | {name: vessel.terms.get(name, {**first, "source": SOURCE})})


REFINEMENTS = (
    Refinement(
        "astern",
        "propellers that give another share of their map's thrust astern than ahead",
        _astern,
        absent=("astern_", 1.0),
    ),
    Refinement(
        "speed_damping", "yaw damping that grows with speed", _speed_damping, {"N_ur_N_s2": (None, SIZE_UNKNOWN)}
    ),
    Refinement("munk_moment", "a yaw moment of u v", _munk_moment, absent=("k_kg", 0.0)),
    Refinement("asymmetry", "a pull to one side that grows with speed", _asymmetry, absent=("N_uu_", 0.0)),
    Refinement(
        "advance_loss",
        "thrust that changes with the boat's speed",
        with_advance_loss,
        absent=("advance_loss_s_m", 0.0),
    ),
    Refinement(WIND, "air on the hull, moved by the wind that was measured, and of which the file says nothing", _wind),
)
TEXTS = {
    COMPASS: "an error of the heading by how the boat is turned",
    **{r.name: r.text for r in REFINEMENTS},
    UNMEASURED_BOAT: "gains, sensors' places, compass: nobody had measured them (current and wind are not written)",
}
"""All of them in words, by name."""
