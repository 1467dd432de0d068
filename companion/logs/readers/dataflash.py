"""Reader of ArduPilot dataflash logs (.BIN): RCOU to RCO3, PARM, IMU, ATT, BAT, BCN, GPS, or a UWB log beside.

The clock is the autopilot's, since boot. A UWB log is stamped by its host; the two clocks are related by the Unix time
in GPS messages (GPS week and ms; the median over those with a fix), or by an offset from the caller. Which output
drives which thruster: `outputs`.
Source: https://ardupilot.org/rover/docs/logmessages.html
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import radians
from pathlib import Path
from statistics import median_low
from typing import Any

import numpy as np
from pymavlink import DFReader

from companion.core.configuration.imu_filters import late_by_filters
from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import unrotate
from companion.core.sensors.gnss import FIX_3D
from companion.logs.readers.aritra import attitude_stream, imu_stream, meta_fields
from companion.logs.readers.dataflash_records import MAGIC, whole_records
from companion.logs.readers.gps import Fix, good_fixes, gps_known, gps_stream
from companion.logs.readers.join import Stream, join
from companion.logs.readers.outputs import output_stream
from companion.logs.readers.uwb import UwbLog
from companion.logs.runs.run import LogProblem, Run, RunError, RunMeta

_OUTPUTS = {1: "RCOU", 15: "RCO2", 19: "RCO3"}
"""Records of outputs, by the first output in them."""
_KINDS = (*_OUTPUTS.values(), "IMU", "ATT", "BAT", "BCN", "GPS", "PARM")
_GPS_EPOCH_S = 315_964_800  # 1980-01-06 in Unix seconds
LEAP_S = 18
"""GPS time minus UTC since 2017 (IERS Bulletin C)."""
_WEEK_S = 604_800
LATEST_US = 10 * 365 * 86_400 * 1_000_000
"""Latest plausible stamp: ten years after boot; assumed."""

Joined = Callable[[int], UwbLog]
"""Function from an offset [ns], added to Unix stamps, to the UWB log on the run's clock."""


def read_dataflash_run(
    path: Path, vessel: VesselFile | None, site: Site | None, uwb: Joined | None, offset_s: float | None
) -> Run:
    """Run of a dataflash log. Raises RunError naming the file, OSError."""
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise RunError(f"{path}: not a dataflash log: it does not begin with the bytes A3 95")
    notes: list[LogProblem] = []
    try:
        rows, unix_ns = _messages(path, notes)
    except OSError:
        raise
    except Exception as error:  # pymavlink raises a plain Exception, struct's and index errors on damaged formats
        raise RunError(f"{path}: cannot be read as a dataflash log, its format records are damaged: {error}") from None
    outputs = {first: rows[kind] for first, kind in _OUTPUTS.items()}
    if not any(outputs.values()):
        raise RunError(f"{path}: no servo outputs (RCOU) in it")
    parameters = {name: value for _, name, value in rows["PARM"]}
    commands, which = output_stream(outputs, vessel, parameters, notes, path)
    streams = [
        commands,
        imu_stream(rows["IMU"]),
        attitude_stream(rows["ATT"], site),
        Stream.of("battery", ("battery_v",), rows["BAT"], held=True),
    ]
    columns = {"pwm": f"RCOU: what left the autopilot, {which}", "r_rad_s": "gyroscope of IMU 0"}
    known = meta_fields(vessel, site)
    known["late_s"] = late_by_filters(parameters)
    if uwb:
        if offset_s is None and unix_ns is None:
            raise RunError(f"{path}: no GPS time in it: state the offset from the UWB log's clock to this log's")
        log = uwb(round(offset_s * 1e9) if offset_s is not None else -(unix_ns or 0))
        streams, columns, notes = streams + log.streams, columns | log.columns, notes + list(log.notes)
    elif rows["BCN"] and not (vessel and vessel.sensors.gnss):
        streams.append(_beacon(rows["BCN"], site))
        columns["north_m"] = columns["east_m"] = "BCN: the autopilot's beacon position, from the beacons' origin"
        known["latency_s"] = None
    elif fixes := good_fixes(_receivers(rows["GPS"]), vessel, notes):
        stream, origin_text = gps_stream(fixes, site, notes)
        streams.append(stream)
        columns["north_m"] = columns["east_m"] = f"GPS antenna, {origin_text}"
        known |= gps_known(vessel)
    clock = "autopilot, since boot"
    name = vessel.name if vessel else "not stated"
    meta = RunMeta(vessel=name, source=path.name, clock=clock, columns=columns, notes=tuple(notes), **known)
    return join(streams, meta)


def _messages(path: Path, notes: list[LogProblem]) -> tuple[dict[str, list[tuple[Any, ...]]], int | None]:
    """Rows (t_ns, values) by message type, SI units; and Unix time minus the log's clock [ns], None without GPS time.

    A record without the columns of its type, or stamped after `LATEST_US`, is damaged: it is left out and counted in
    `notes`, as are bytes that are no record.
    """
    rows: dict[str, list[tuple[Any, ...]]] = {kind: [] for kind in _KINDS}
    clocks: dict[bool, list[int]] = {True: [], False: []}  # with a fix, and without: the week may be a guess then
    damaged = 0
    with whole_records(path, notes) as whole, _opened(whole) as log:
        while (m := log.recv_match(type=list(_KINDS))) is not None:
            kind = m.get_type()
            try:
                row, t_us = _DECODE[kind](m), m.TimeUS
                week, ms, status = (m.GWk, m.GMS, m.Status) if kind == "GPS" else (0, 0, 0)
            except (AttributeError, TypeError):  # a damaged format record gives its type other columns
                damaged += 1
                continue
            if not 0 <= t_us <= LATEST_US:
                damaged += 1
                continue
            if row is not None:
                rows[kind].append((t_us * 1000, *row))
            if week:
                week_ns = (_GPS_EPOCH_S - LEAP_S + week * _WEEK_S) * 1_000_000_000
                clocks[status >= FIX_3D].append(week_ns + ms * 1_000_000 - t_us * 1000)
    if damaged:
        notes.append(LogProblem(kind="damaged", text=f"{damaged} damaged records are left out"))
    known = clocks[True] or clocks[False]
    return rows, median_low(known) if known else None


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """pymavlink's reader of a log."""
    log = DFReader.DFReader_binary(str(path))
    try:
        yield log
    finally:
        try:
            log.close()
        except BufferError:  # its index sometimes keeps a view of the file: that goes with the reader itself
            log.filehandle.close()


def _receivers(rows: list[tuple[Any, ...]]) -> dict[int, list[Fix]]:
    """Fixes by number of the receiver (from 0)."""
    receivers: dict[int, list[Fix]] = defaultdict(list)
    for *fix, number in rows:
        receivers[number].append((fix[0], fix[1], fix[2], fix[3]))
    return receivers


def _beacon(rows: list[tuple[float, ...]], site: Site | None) -> Stream:
    """Stream of rows as of `_bcn`, its true north and east turned into the site's axes, as headings are."""
    stream = Stream.of("beacon", ("north_m", "east_m", *(f"range_{i}_m" for i in range(4))), rows)
    turn_rad = radians(site.rotation_deg) if site else 0.0
    north_m, east_m = unrotate(turn_rad, stream.columns["north_m"], stream.columns["east_m"])
    return replace(stream, columns={**stream.columns, "north_m": north_m, "east_m": east_m})


def _bcn(m: Any) -> tuple[float, ...] | None:
    ranges = (d if d > 0 else np.nan for d in (m.D0, m.D1, m.D2, m.D3))
    return (m.PosX, m.PosY, *ranges) if m.Health else None


_DECODE: dict[str, Callable[[Any], tuple[Any, ...] | None]] = {
    **dict.fromkeys(
        _OUTPUTS.values(), lambda m: tuple(getattr(m, name) for name in m.get_fieldnames() if name.startswith("C"))
    ),
    "IMU": lambda m: (m.GyrZ, m.AccX, m.AccY) if getattr(m, "I", 0) == 0 else None,
    "ATT": lambda m: (radians(m.Yaw), radians(m.Roll), radians(m.Pitch)),
    "BAT": lambda m: (m.Volt,) if getattr(m, "Instance", getattr(m, "Inst", 0)) == 0 else None,
    "BCN": _bcn,
    "PARM": lambda m: (m.Name, m.Value),
    "GPS": lambda m: (m.Lat, m.Lng, m.Status, getattr(m, "I", 0)),
}
