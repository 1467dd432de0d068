"""Reader of telemetry logs of a ground station (.tlog): SERVO_OUTPUT_RAW, IMU, ATTITUDE, SYS_STATUS, GPS or a UWB log.

Every record has the host's Unix stamp of its arrival; those with a stamp of the autopilot are moved to the host's clock
(`host_clock`).
"""

from __future__ import annotations

import re
import struct
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.core.configuration.imu_filters import late_by_filters
from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.messages import Attitude, Battery, ImuSample, Message
from companion.core.sensors.gnss import FIX_3D
from companion.logs.readers.aritra import attitude_row, attitude_stream, imu_row, imu_stream, meta_fields
from companion.logs.readers.dataflash import Joined
from companion.logs.readers.gps import Fix, good_fixes, gps_known, gps_stream
from companion.logs.readers.host_clock import Arrival, host_stamps, longest_boot
from companion.logs.readers.join import Stream, join
from companion.logs.readers.outputs import output_stream
from companion.logs.runs.run import LogProblem, Run, RunError, RunMeta
from drivers.mavlink.decode import DECODERS, STAMPS, is_autopilot, pulses
from drivers.mavlink.imu_source import IMU_PREFERENCE

_MARKER = re.compile(rb"[\xfd\xfe]")
_GPS, _FILTERED = ("GPS_RAW_INT", "GPS2_RAW"), "GLOBAL_POSITION_INT"
_WANTED = frozenset(
    getattr(dialect, f"MAVLINK_MSG_ID_{name}")
    for name in ("ATTITUDE", "SYS_STATUS", "SERVO_OUTPUT_RAW", *_GPS, _FILTERED, "PARAM_VALUE", *IMU_PREFERENCE)
)
_HEARTBEAT, _SERVOS = dialect.MAVLINK_MSG_ID_HEARTBEAT, dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW
_V2, _STAMP_LEN = 0xFD, 8
_OUTPUTS = 16  # in one SERVO_OUTPUT_RAW; `port` 1 has those from 17 on
_YEAR_US = 31_557_600_000_000
_LAST_US = 2**63 // 1000 - 1  # what fits into int64 nanoseconds
_FILTERED_NOTE = LogProblem(
    kind="filtered positions",
    text=f"positions are those of the autopilot's own filter ({_FILTERED}), for there is no GPS_RAW_INT: smoother and "
    "later than a receiver's, and of another place on the boat; log GPS_RAW_INT, or take the .BIN",
)
_SLOW_S = 0.125  # outputs slower than 8 Hz hide what happened between them; assumed


def read_tlog(path: Path, vessel: VesselFile | None, site: Site | None, uwb: Joined | None, offset_s: float) -> Run:
    """Run of a telemetry log. Raises RunError naming the file, OSError."""
    log = _Records(path)
    notes: list[LogProblem] = []
    arrivals = longest_boot([Arrival(t_ns, _device_ns(m), m) for t_ns, m in log.of_autopilot()], notes)
    notes = log.notes() + notes
    rows: dict[str, list[tuple[int, int, Any]]] = defaultdict(list)
    if not any(one.message.get_type() == "SERVO_OUTPUT_RAW" for one in arrivals):
        raise RunError(f"{path}: no servo outputs (SERVO_OUTPUT_RAW) in it")
    for t_ns, (t_rx_ns, _, m) in zip(host_stamps(arrivals, notes), arrivals, strict=True):
        rows[m.get_type()].append((t_ns, t_rx_ns, m))
    outputs: dict[int, list[tuple[float, ...]]] = defaultdict(list)  # by the first output in them
    for t_ns, _, m in rows["SERVO_OUTPUT_RAW"]:
        outputs[_OUTPUTS * m.port + 1].append((t_ns, *pulses(m, "servo{}_raw", _OUTPUTS)))
    stamps_ns = [row[0] for row in max(outputs.values(), key=len)]
    period_s = float(np.median(np.diff(stamps_ns))) / 1e9 if len(stamps_ns) > 1 else np.inf
    if period_s > _SLOW_S:
        text = f"servo outputs every {period_s:.2f} s only: what was commanded between them is not known"
        notes.append(LogProblem(kind="coarse commands", text=text))
    source = next((name for name in IMU_PREFERENCE if any(_decoded(name, rows, ImuSample))), "IMU")
    voltages = [(m.t_ns, m.voltage_v) for m in _decoded("SYS_STATUS", rows, Battery)]
    parameters = {m.param_id: m.param_value for *_, m in rows["PARAM_VALUE"]}
    commands, which = output_stream(outputs, vessel, parameters, notes, path)
    streams = [
        commands,
        imu_stream([imu_row(m) for m in _decoded(source, rows, ImuSample)]),
        attitude_stream([attitude_row(m) for m in _decoded("ATTITUDE", rows, Attitude)], site),
        Stream.of("battery", ("battery_v",), voltages, held=True),
    ]
    columns = {"pwm": f"SERVO_OUTPUT_RAW: what left the autopilot, {which}", "r_rad_s": f"gyroscope, {source}"}
    known = meta_fields(vessel, site)
    known["late_s"] = late_by_filters(parameters)
    if uwb:
        joined = uwb(round(offset_s * 1e9))
        streams, columns, notes = streams + joined.streams, columns | joined.columns, notes + list(joined.notes)
    else:
        placed, its_columns, its_known = _gps(rows, vessel, site, notes)
        streams, columns, known = streams + placed, columns | its_columns, known | its_known
    clock = "ground station, Unix; records of the autopilot by its own clock, moved by the least delay"
    name = vessel.name if vessel else "not stated"
    meta = RunMeta(vessel=name, source=path.name, clock=clock, columns=columns, notes=tuple(notes), **known)
    return join(streams, meta)


def _gps(
    rows: dict[str, list[tuple[int, int, Any]]], vessel: VesselFile | None, site: Site | None, notes: list[LogProblem]
) -> tuple[list[Stream], dict[str, str], dict[str, Any]]:
    """Positions by GPS as a stream, if there are any, their source as text, and what is known of them.

    By the autopilot's filter where the log has no receiver's: better than none, and said in `notes`.
    """
    receivers = {k: [_fix(t, m, m.fix_type) for t, _, m in rows[name]] for k, name in enumerate(_GPS) if rows[name]}
    filtered = [_fix(t, m, FIX_3D) for t, _, m in rows[_FILTERED] if m.lat or m.lon]  # 0, 0: it does not know yet
    if filtered and not receivers:
        stream, origin_text = gps_stream(filtered, site, notes)
        notes.append(_FILTERED_NOTE)
        source = f"the autopilot's filter, at the arrival of {_FILTERED}"
        known: dict[str, Any] = {"latency_s": None, "tag_arm_m": None}
    elif good := good_fixes(receivers, vessel, notes):
        stream, origin_text = gps_stream(good, site, notes)
        source, known = "GPS antenna at the arrival of GPS_RAW_INT", dict(gps_known(vessel))
    else:
        return [], {}, {}
    return [stream], dict.fromkeys(("north_m", "east_m"), f"{source}, {origin_text}"), known


class _Records:
    """Records of a tlog: big-endian u64 stamp [us] and a raw frame. Only wanted ones are decoded."""

    def __init__(self, path: Path):
        self._path, self._data = path, path.read_bytes()
        self._mav = dialect.MAVLink(None)
        self.skipped, self.broken = 0, Counter[str]()
        self.autopilots: list[bytes] = []
        self.silent: list[bytes] = []

    def of_autopilot(self) -> Iterator[tuple[int, Any]]:
        """Arrival [ns] and message, from the first autopilot that sends a heartbeat."""
        heartbeats = self._decoded(frozenset({_HEARTBEAT}))
        self.autopilots = list(dict.fromkeys(sender for _, sender, m in heartbeats if is_autopilot(m)))
        target = next(iter(self.autopilots), None) or self._only_sender()
        self.skipped = 0
        self.broken.clear()
        for t_us, sender, m in self._decoded(_WANTED):
            if sender == target:
                yield t_us * 1000, m

    def _only_sender(self) -> bytes | None:
        """The one system that sends servo outputs, where no autopilot says that it is one; None where none does."""
        senders = list(dict.fromkeys(sender for _, sender, _ in self._decoded(frozenset({_SERVOS}))))
        if len(senders) > 1:
            raise RunError(
                f"{self._path}: no heartbeat of an autopilot in it, and servo outputs of several, "
                f"{', '.join(map(_system, senders))}: which is the boat? Keep the records of one, with its heartbeats"
            )
        self.silent = senders
        return senders[0] if senders else None

    def _decoded(self, wanted: frozenset[int]) -> Iterator[tuple[int, bytes, Any]]:
        """Stamp [us], system and component, and message of each sound frame with a wanted id."""
        for t_us, at, end in self._frames():
            v2 = self._data[at] == _V2
            ident = int.from_bytes(self._data[at + 7 : at + 10], "little") if v2 else self._data[at + 5]
            if ident not in wanted:
                continue
            first = at + (5 if v2 else 3)
            try:
                yield t_us, self._data[first : first + 2], self._mav.decode(bytearray(self._data[at:end]))
            except dialect.MAVError:
                self.broken[f"message {ident}"] += 1

    def notes(self) -> list[LogProblem]:
        """Notes on bytes that were skipped, on damaged frames, and on autopilots that were left out."""
        notes = []
        if len(self.autopilots) > 1:
            first, *others = map(_system, self.autopilots)
            text = f"{self._path.name}: of several autopilots the first is read, {first}; left out: {', '.join(others)}"
            notes.append(LogProblem(kind="another boat", text=text))
        for sender in self.silent:
            text = (
                f"{self._path.name}: no heartbeat of an autopilot: {_system(sender)} is read, which sends servo outputs"
            )
            notes.append(LogProblem(kind="missing", text=text))
        if self.skipped:
            notes.append(LogProblem(kind="damaged", text=f"{self._path.name}: {self.skipped} bytes passed over"))
        if self.broken:
            which = ", ".join(f"{name} {count}" for name, count in sorted(self.broken.items()))
            notes.append(LogProblem(kind="damaged", text=f"{self._path.name}: frames with a bad checksum: {which}"))
        return notes

    def _frames(self) -> Iterator[tuple[int, int, int]]:
        """Stamp [us], begin and end of every frame; after damage it continues at the next plausible record."""
        data, at, last_us = self._data, 0, None
        if len(data) < _STAMP_LEN + 1 or not _MARKER.match(data, _STAMP_LEN):
            raise RunError(f"{self._path}: not a telemetry log: no MAVLink frame after the first stamp")
        while at + _STAMP_LEN + 8 <= len(data):
            (t_us,) = struct.unpack_from(">Q", data, at)
            begin = at + _STAMP_LEN
            end = begin + _frame_length(data, begin)
            if end > begin and end <= len(data) and self._is_stamp(t_us, last_us, end):
                yield t_us, begin, end
                at, last_us = end, t_us
                continue
            marker = _MARKER.search(data, begin + 1)
            following = marker.start() - _STAMP_LEN if marker else len(data)
            self.skipped += following - at
            at = following
        self.skipped += max(len(data) - at, 0)

    def _is_stamp(self, t_us: int, last_us: int | None, end: int) -> bool:
        """Whether a stamp is within a year of the record before or of the one at `end`.

        A clock that was set from 1970 to now agrees with what follows, a flipped bit with neither.
        """
        beside_us = [last_us] if last_us is not None else []
        if _MARKER.match(self._data, end + _STAMP_LEN):
            beside_us += struct.unpack_from(">Q", self._data, end)
        return t_us <= _LAST_US and (not beside_us or min(abs(t_us - other) for other in beside_us) < _YEAR_US)


def _system(sender: bytes) -> str:
    system, component = sender
    return f"system {system} component {component}"


def _fix(t_ns: int, m: Any, kind: int) -> Fix:
    return t_ns, m.lat / 1e7, m.lon / 1e7, kind


def _frame_length(data: bytes, at: int) -> int:
    """Length of the frame at `at` by its header; 0 where there is no marker."""
    if data[at] == _V2:
        return data[at + 1] + 12 + (dialect.MAVLINK_SIGNATURE_BLOCK_LEN if data[at + 2] & 1 else 0)
    return data[at + 1] + 8 if data[at] == 0xFE else 0


def _device_ns(m: Any) -> int:
    """The autopilot's own stamp [ns since boot, may have wrapped]; -1 where the message has none."""
    if (stamp := STAMPS.get(m.get_type())) is None:
        return -1
    return getattr(m, stamp[0]) * stamp[1]


def _decoded(name: str, rows: dict[str, list[tuple[int, int, Any]]], kind: type[Message]) -> Iterator[Any]:
    """Messages of type `name` in SI units, with the host's stamps."""
    for t_ns, t_rx_ns, m in rows[name]:
        message = DECODERS[name](m, t_ns, t_rx_ns)
        if isinstance(message, kind):
            yield message
