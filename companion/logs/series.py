"""A log as arrays for plots and reports: every time in seconds since the log's first message (`zero_ns_of`).

Positions that the tag computed are in the site's ENU axes (x east, y north: see `core.site`). Where the tag
gives only ranges, and the log holds its site file, each set of three or more gives a least-squares fix.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.core.configuration.site_file import Site
from companion.core.configuration.tables import ConfigError
from companion.core.estimation.ranging.multilateration import multilaterate
from companion.core.geometry.frames import Origin, site_from_geodetic
from companion.core.messages import (
    GroundTruth,
    GuidanceReference,
    Innovation,
    LoopTiming,
    Message,
    OverrideLease,
    PlanResult,
    StateEstimate,
    Tick,
    UwbPosition,
    UwbRanges,
)
from companion.core.messages.sensors import GnssFix
from companion.core.sensors.gnss import GnssReceiver
from companion.core.sensors.table import origin_of
from companion.logs.configuration import zero_ns_of
from companion.logs.log_file import LogFile
from companion.logs.metadata import channels_in, site_in

MAX_FIXES = 600  # fixes from ranges in one picture: more would only cost time
FIX_SPREAD_M = 0.5  # residual of a good range in such a fix; assumed
KNOWN = ("healthy", "degraded")
"""Health of an estimate that says where the boat is."""
GAP_S = 1.0
"""Samples further apart are not joined by a line: ten are missing."""

_SCALARS: dict[type[Message], tuple[str, ...]] = {
    StateEstimate: ("north_m", "east_m", "psi_rad", "u_m_s", "v_m_s", "r_rad_s"),
    GroundTruth: ("north_m", "east_m", "psi_rad", "u_m_s", "v_m_s", "r_rad_s"),
    GuidanceReference: ("north_ref_m", "east_ref_m", "psi_ref_rad", "u_ref_m_s", "x_e_m", "y_e_m"),
    PlanResult: ("solve_time_s", "iterations"),
    Tick: ("index", "lateness_ns"),
    LoopTiming: ("lateness_ms", "imu_to_override_ms"),
}


@dataclass
class TopicColumns:
    """Arrays of one message class: `t_s` (n,) and one array (n,) per field, NaN where unknown."""

    t_s: np.ndarray
    values: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.t_s)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[name]

    def line(self, name: str) -> np.ndarray:
        """A field to draw as a line, which ends at gaps."""
        return broken(self.t_s, self.values[name])


@dataclass
class Series:
    """All that a plot needs. `pwm_us`: (n, thrusters), of the names `thrusters`.

    `innovations`: sensor -> (t_s, sqrt(d2), accepted).
    `uwb_ne_m`, `gnss_ne_m`: (n, 2) north, east of the tag by UWB alone, of the antenna by GNSS. `site` is None where
    the log does not hold it.
    """

    columns: dict[type[Message], TopicColumns]
    lease_t_s: np.ndarray
    pwm_us: np.ndarray
    thrusters: tuple[str, ...]
    sources: list[str]
    phases: list[str]
    innovations: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]
    uwb_ne_m: np.ndarray
    gnss_ne_m: np.ndarray
    site: Site | None
    duration_s: float

    def __getitem__(self, kind: type[Message]) -> TopicColumns:
        return self.columns[kind]


@dataclass
class _Rows:
    origin: Origin | None = None
    scalars: dict[type[Message], list[tuple[Any, ...]]] = field(default_factory=lambda: defaultdict(list))
    leases: list[OverrideLease] = field(default_factory=list)
    phases: list[str] = field(default_factory=list)
    innovations: dict[str, list[tuple[int, float, bool]]] = field(default_factory=lambda: defaultdict(list))
    positions: list[tuple[float, float]] = field(default_factory=list)
    ranges: list[UwbRanges] = field(default_factory=list)
    antenna: list[tuple[float, float]] = field(default_factory=list)


def collect(log: LogFile, truth: LogFile | None = None) -> Series:
    """One pass over `log`; ground truth also from `truth`, the simulator's log of the same run."""
    try:
        site = site_in(log.metadata, log.path)
    except ConfigError:  # nothing here is in the axes of a site: anchors and the fixes of GNSS are left out
        site = None
    rows, zero_ns, last_ns = _Rows(origin=origin_of(site) if site else None), zero_ns_of(log), 0
    for message in log.messages(*_SCALARS, OverrideLease, Innovation, UwbPosition, UwbRanges, GnssFix):
        last_ns = max(last_ns, message.t_ns)
        _add(rows, message)
    for message in truth.messages(GroundTruth) if truth else ():
        if zero_ns <= message.t_ns <= last_ns:
            _add(rows, message)
    return _arrays(rows, zero_ns, last_ns, site, tuple(channels_in(log.metadata)))


def broken(t_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """`values` (n, ...) with NaN for the last sample before each gap: lines and steps over `t_s` end there."""
    out = np.array(values, dtype=float)
    out[np.diff(t_s, append=t_s[-1:]) > GAP_S] = np.nan
    return out


def _add(rows: _Rows, message: Message) -> None:
    match message:
        case OverrideLease():
            rows.leases.append(message)
        case Innovation(sensor=sensor):
            rows.innovations[sensor].append((message.t_ns, max(message.d2, 0.0) ** 0.5, message.accepted))
        case UwbPosition():
            rows.positions.append((message.y_m, message.x_m))
        case UwbRanges():
            rows.ranges.append(message)
        case GnssFix():
            if rows.origin and GnssReceiver.screen(message)[0]:
                rows.antenna.append(site_from_geodetic(rows.origin, message.lat_deg, message.lon_deg))
        case _:
            names = _SCALARS[type(message)]
            values = tuple(getattr(message, name) for name in names)
            if isinstance(message, StateEstimate) and message.health not in KNOWN:
                values = (np.nan,) * len(names)  # the filter's first guess, or one that it has lost faith in
            rows.scalars[type(message)].append((message.t_ns, *values))
            if isinstance(message, GuidanceReference):
                rows.phases.append(message.phase)


def _arrays(rows: _Rows, zero_ns: int, last_ns: int, site: Site | None, thrusters: tuple[str, ...]) -> Series:
    channels = max((lease.channels for lease in rows.leases), key=len, default=())

    def seconds(t_ns: Any) -> np.ndarray:
        return (np.asarray(t_ns, dtype=float) - zero_ns) / 1e9

    columns = {}
    for kind, names in _SCALARS.items():
        table = np.array(rows.scalars[kind], dtype=float).reshape(-1, len(names) + 1)
        columns[kind] = TopicColumns(seconds(table[:, 0]), dict(zip(names, table[:, 1:].T, strict=True)))
    innovations = {}
    for sensor, points in sorted(rows.innovations.items()):
        t_ns, sigma, accepted = zip(*points, strict=True)
        innovations[sensor] = (seconds(t_ns), np.array(sigma), np.array(accepted, dtype=bool))
    return Series(
        columns=columns,
        lease_t_s=seconds([lease.t_ns for lease in rows.leases]),
        pwm_us=_thruster_pwm(rows.leases),
        thrusters=thrusters or tuple(f"thruster on channel {n}" for n in channels),
        sources=[lease.source for lease in rows.leases],
        phases=rows.phases,
        innovations=innovations,
        uwb_ne_m=np.array([*rows.positions, *_fixes(rows.ranges, site)]).reshape(-1, 2),
        gnss_ne_m=np.array(rows.antenna).reshape(-1, 2),
        site=site,
        duration_s=max((last_ns - zero_ns) / 1e9, 0.0),
    )


def _thruster_pwm(leases: list[OverrideLease]) -> np.ndarray:
    """Pulse widths (n, thrusters) [us]: thrusters come first, channels held at neutral after them."""
    width = max((len(lease.f_command_n) for lease in leases), default=0)
    width = width or max((len(lease.pwm_us) for lease in leases), default=0)
    pwm_us = np.full((len(leases), width), np.nan)
    for row, lease in zip(pwm_us, leases, strict=True):
        given = lease.pwm_us[:width]
        row[: len(given)] = given
    return pwm_us


def _fixes(cycles: list[UwbRanges], site: Site | None) -> list[tuple[float, float]]:
    """Least-squares places of the tag (north, east) [m] at the height of the water, at most MAX_FIXES."""
    place = {a.id: (a.north_m, a.east_m, a.down_m) for a in site.anchors} if site else {}
    fixes = []
    for cycle in cycles[:: max(len(cycles) // MAX_FIXES, 1)]:
        seen = [(place[r.anchor], r.range_m) for r in cycle.ranges if r.anchor in place]
        if len(seen) >= 3:
            anchors_m, ranges_m = (np.array(column) for column in zip(*seen, strict=True))
            fixes += [(fix.north_m, fix.east_m) for fix in multilaterate(anchors_m, ranges_m, 0.0, FIX_SPREAD_M)[:1]]
    return fixes
