"""Fixes of a GPS receiver in logs of ArduPilot, as positions of its antenna."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from companion.core.configuration.sensors import FIX_TYPES
from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.sensors.gnss import FIX_3D, FIX_NAMES
from companion.logs.readers.join import Stream
from companion.logs.readers.positions import geodetic_to_site, together
from companion.logs.runs.outliers import FEW
from companion.logs.runs.run import LogProblem

Fix = tuple[int, float, float, int]
"""Stamp [ns], latitude and longitude [deg], type of fix (GPS_FIX_TYPE of MAVLink, Status of a dataflash log)."""
NO_FIX = "no good fix"
"""Kind of a note: why there is no position by GPS, and what to do."""
NEARLY = 0.9
"""Of the most good fixes of any receiver; the first that has as many is read. Assumed: the second's antenna is not that
of the vessel file, so that a few fixes more are not worth it."""


def good_fixes(receivers: Mapping[int, Sequence[Fix]], vessel: VesselFile | None, notes: list[LogProblem]) -> list[Fix]:
    """Those of three dimensions, and at least as good as the vessel file's GNSS says: the boat's filter takes no other.

    `receivers`: fixes by number of the receiver, of which one is read. How many are lesser than that, which receiver is
    read if not the first, and why there is no fix at all, goes to `notes`.
    """
    gnss = vessel.sensors.gnss if vessel else None
    least = FIX_TYPES[gnss.fix] if gnss else FIX_3D
    good = {n: [fix for fix in fixes if fix[3] >= least] for n, fixes in sorted(receivers.items())}
    most = max(map(len, good.values()), default=0)
    if not most:
        everything = [fix for fixes in receivers.values() for fix in fixes]
        if gnss or everything:
            notes.append(LogProblem(kind=NO_FIX, text=_no_fix(everything, gnss.fix if gnss else "")))
        return []
    read = next(n for n, fixes in good.items() if len(fixes) >= NEARLY * most)
    if read:
        others = ", ".join(f"receiver {n} has {len(fixes)}" for n, fixes in good.items() if n != read)
        text = f"GPS receiver {read} (from 0) is read, with {len(good[read])} good fixes{others and f'; {others}'}"
        notes.append(LogProblem(kind="left out", text=text))
    lesser = sum(FIX_3D <= fix[3] < least for fix in receivers[read])
    if gnss and lesser:
        text = f'{lesser} GPS positions of a lesser fix than "{gnss.fix}" (sensors.gnss.fix of the vessel file)'
        notes.append(LogProblem(kind="left out", text=text))
    return good[read]


def _no_fix(fixes: Sequence[Fix], wanted: str) -> str:
    """Why none of `fixes` is a position, and what to do. `wanted`: `fix` of the vessel file's GNSS, if it has one."""
    if not fixes:
        return "no fix of a GPS receiver in it (GPS of a .BIN, GPS_RAW_INT of a .tlog): log them"
    kinds = Counter(fix[3] for fix in fixes)
    seen = ", ".join(f"{count} {FIX_NAMES.get(kind, f'of type {kind}')}" for kind, count in sorted(kinds.items()))
    if wanted and max(kinds) >= FIX_3D:
        return (
            f'none of {len(fixes)} GPS fixes is as good as "{wanted}", which sensors.gnss.fix of the vessel file '
            f"asks for: {seen}; write a lesser fix there, with position_sigma_m and position_wander_sigma_m of such a "
            "fix"
        )
    return (
        f"none of {len(fixes)} GPS fixes has three dimensions: {seen}; take a log from where the receiver sees the sky"
    )


def gps_known(vessel: VesselFile | None) -> dict[str, float | tuple[float, float] | None]:
    """Latency and place of the antenna by the vessel file's GNSS; unknown where it has none."""
    gnss = vessel.sensors.gnss if vessel else None
    return {"latency_s": gnss.latency_s if gnss else None, "tag_arm_m": (gnss.x_m, gnss.y_m) if gnss else None}


def gps_stream(fixes: Sequence[Fix], site: Site | None, notes: list[LogProblem]) -> tuple[Stream, str]:
    """Fixes as a stream of positions, and a text that states their origin. A few far from all others are left out, and
    noted: a flipped bit, or 0, 0 before the receiver knew its place.
    """
    t_ns = np.array([fix[0] for fix in fixes], dtype=np.int64)
    latitude, longitude = np.array([fix[1:3] for fix in fixes], dtype=float).T
    near = together(latitude, longitude)
    far = int((~near).sum())
    if 0 < far <= FEW * len(fixes):
        at = int(near.argmin())
        text = (
            f"GPS positions: {far} of {len(fixes)} lie kilometres from all others, the first at {latitude[at]:.7f} "
            f"{longitude[at]:.7f}; left out"
        )
        notes.append(LogProblem(kind="impossible", text=text))
        t_ns, latitude, longitude = t_ns[near], latitude[near], longitude[near]
    north, east, origin_text = geodetic_to_site(latitude, longitude, site)
    return Stream("GPS positions", t_ns, {"north_m": north, "east_m": east}), origin_text
