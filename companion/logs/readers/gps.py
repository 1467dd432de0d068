"""Fixes of a GPS receiver in logs of ArduPilot, as positions of its antenna."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.core.configuration.sensors import FIX_TYPES
from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.sensors.gnss import FIX_3D
from companion.logs.readers.join import Stream
from companion.logs.readers.positions import geodetic_to_site
from companion.logs.runs.run import LogProblem

Fix = tuple[int, float, float, int]
"""Stamp [ns], latitude and longitude [deg], type of fix (GPS_FIX_TYPE of MAVLink, Status of a dataflash log)."""


def good_fixes(fixes: Sequence[Fix], vessel: VesselFile | None, notes: list[LogProblem]) -> list[Fix]:
    """Those of three dimensions, and at least as good as the vessel file's GNSS says: the boat's filter takes no other.

    How many are lesser than that goes to `notes`.
    """
    gnss = vessel.sensors.gnss if vessel else None
    least = FIX_TYPES[gnss.fix] if gnss else FIX_3D
    good = [fix for fix in fixes if fix[3] >= least]
    lesser = sum(FIX_3D <= fix[3] < least for fix in fixes)
    if gnss and lesser:
        text = f'{lesser} GPS positions of a lesser fix than "{gnss.fix}" (sensors.gnss.fix of the vessel file)'
        notes.append(LogProblem(kind="left out", text=text))
    return good


def gps_known(vessel: VesselFile | None) -> dict[str, float | tuple[float, float] | None]:
    """Latency and place of the antenna by the vessel file's GNSS; unknown where it has none."""
    gnss = vessel.sensors.gnss if vessel else None
    return {"latency_s": gnss.latency_s if gnss else None, "tag_arm_m": (gnss.x_m, gnss.y_m) if gnss else None}


def gps_stream(fixes: Sequence[Fix], site: Site | None) -> tuple[Stream, str]:
    """Fixes as a stream of positions, and a text that states their origin."""
    table = np.array([fix[1:3] for fix in fixes], dtype=float)
    north, east, origin_text = geodetic_to_site(table[:, 0], table[:, 1], site)
    t_ns = np.array([fix[0] for fix in fixes], dtype=np.int64)
    return Stream("GPS positions", t_ns, {"north_m": north, "east_m": east}), origin_text
