"""Which thrusters and force maps of a vessel file have numbers that a fit estimates."""

from __future__ import annotations

from companion.core.configuration.vessel_file import ForceMap, PitchMap, VesselFile


def pitch_maps(vessel: VesselFile) -> tuple[str, ...]:
    """Names of the pitch maps that the thrusters use, sorted."""
    return tuple(sorted({vessel.thrusters[i].force_map for i in adjustable(vessel)}))


def astern_maps(vessel: VesselFile) -> tuple[str, ...]:
    """Names of the force maps that thrusters use and whose share astern is estimated: those that state one, sorted."""
    used = {t.force_map for t in vessel.thrusters}
    return tuple(sorted(name for name in used if astern_share(vessel.force_maps[name]) is not None))


def astern_share(force_map: ForceMap) -> float | None:
    """The map's share astern; None where it states none or can have none."""
    return None if isinstance(force_map, PitchMap) else force_map.astern_share


def adjustable(vessel: VesselFile) -> tuple[int, ...]:
    """Indices of the thrusters whose trim and azimuth a fit estimates: those with a pitch map."""
    maps = [vessel.force_maps[t.force_map] for t in vessel.thrusters]
    return tuple(i for i, m in enumerate(maps) if isinstance(m, PitchMap))
