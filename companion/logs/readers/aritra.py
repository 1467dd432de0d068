"""Reader of Aritra's own log (MCAP): commands, measurements, and the simulator's truth where there is one.

Commands are the override leases, delayed by the run file's `control.latency_s` until they reach the autopilot's
outputs. A lease that expires before the next one is followed by neutral, as on the boat. Where the autopilot's outputs
do not follow the leases (disarmed, HOLD, failsafe), a note states when.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from companion.core.configuration.imu_filters import late_by_filters
from companion.core.configuration.run_file import load_run
from companion.core.configuration.site_file import Site
from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from companion.core.geometry.frames import wrapped
from companion.core.messages import (
    MEASUREMENTS,
    Attitude,
    Battery,
    GroundTruth,
    ImuSample,
    Message,
    OverrideLease,
    ParamValue,
    ServoOutput,
    UwbPosition,
    UwbRanges,
)
from companion.core.model.load_vessel import load_vessel
from companion.core.sensors.table import sensors_of
from companion.logs.log_file import LogFile, open_truth
from companion.logs.metadata import channels_in, site_in
from companion.logs.readers.channels import channel_streams
from companion.logs.readers.join import Stream, join
from companion.logs.readers.outputs import carriers
from companion.logs.readers.uwb import uwb_streams
from companion.logs.runs.run import LogProblem, Run, RunError, RunMeta

OBEY_S = 0.6
"""An output follows a lease within this: 0.5 s of override timeout, and the latency of its telemetry (observed)."""
OBEY_US = 10.0  # assumed
_TRUTH = ("north_m", "east_m", "psi_rad", "u_m_s", "v_m_s", "r_rad_s")
Configuration = TypeVar("Configuration")
_WANTED = (*MEASUREMENTS, Battery, OverrideLease, ParamValue, ServoOutput, GroundTruth)


def read_mcap(path: Path, vessel: VesselFile | None, site: Site | None, truth: Path | None) -> Run:
    """Run of a log of `aritra run`. `vessel`, `site`: instead of those in the log; `truth`: the simulator's log.

    Raises LogError, RunError.
    """
    # 1. Messages by type, and damage of the file.
    log = LogFile(path)
    if vessel:
        _same_boat(log, vessel)
    notes: list[LogProblem] = []
    vessel = vessel or _own(log, "vessel.toml", load_vessel, notes, "thrusters are named by their RC channels")
    site = site or _site(log)
    late = "commands count from when they were given, not control.latency_s later"
    own_run = _own(log, "run.toml", load_run, notes, late)
    link_ns = round(own_run.control.latency_s * 1e9) if own_run else 0
    found: dict[type[Message], list[Any]] = defaultdict(list)
    for message in log.messages(*_WANTED):
        row = _ROWS.get(type(message))
        found[type(message)].append(row(message) if row else message)
    notes += [LogProblem(kind="damaged", text=text) for text in log.damage]
    forces_of = channels_in(log.metadata)
    if truth:
        simulator = open_truth(truth, log)
        forces_of = channels_in(simulator.metadata) or forces_of
        found[GroundTruth] = list(simulator.messages(GroundTruth))
        notes += [LogProblem(kind="damaged", text=text) for text in simulator.damage]
    if not found[OverrideLease]:
        raise RunError("; ".join([f"{path}: no thruster commands (/override_lease) in it", *log.damage]))
    # 2. A stream for each sensor, the commands and the truth.
    channels = channels_of(vessel, found[OverrideLease])
    aiding, places = _aiding(found, vessel, site, notes)
    streams = [_imu(found[ImuSample], notes), attitude_stream(found[Attitude], site)]
    streams.append(Stream.of("battery", ("battery_v",), found[Battery], held=True))
    last_ns = max((int(s.t_ns[-1]) for s in (*streams, *aiding) if len(s.t_ns)), default=0)
    streams += [
        _commands(found[OverrideLease], channels, last_ns, link_ns),
        *aiding,
        _truth(found[GroundTruth], tuple(channels), tuple(forces_of or channels)),
    ]
    # 3. Joined into one run.
    parameters = {m.name: m.value for m in found[ParamValue]}
    meta = RunMeta(
        vessel=vessel.name if vessel else log.metadata.get("vessel", "not stated"),
        source=str(path.name),
        clock="companion, monotonic",
        columns={
            "pwm": f"commanded: override leases {link_ns / 1e9:g} s later (control.latency_s)",
            "r_rad_s": "gyroscope",
            **places,
        },
        late_s=late_by_filters(parameters),
        notes=tuple(notes),
        **meta_fields(vessel, site),
    )
    run = join(streams, meta)
    carried = carriers(found[OverrideLease][0].channels[: len(channels)], parameters)
    return run.with_notes(_disobeyed(found[OverrideLease], found[ServoOutput], carried, run.meta.zero_ns))


def _aiding(
    found: Mapping[type[Message], list[Any]], vessel: VesselFile | None, site: Site | None, notes: list[LogProblem]
) -> tuple[list[Stream], dict[str, str]]:
    """Streams of what is not inertial, and the source of their columns as text.

    Positions by UWB are left out, with a note, where the vessel file's sensor of positions is another that gave some.
    """
    down_m = vessel.sensors.position.z_m if vessel else 0.0
    tag, places = uwb_streams([*found[UwbRanges], *found[UwbPosition]], site, down_m)
    others, sources = channel_streams(sensors_of(vessel.sensors, site) if vessel and site else (), found)
    if "north_m" in places and "north_m" in sources:
        tag = [s for s in tag if "north_m" not in s.columns]
        text = f"positions by UWB are left out: by the vessel file those of {sources['north_m']} count"
        notes.append(LogProblem(kind="left out", text=text))
    return [*tag, *others], places | sources


def meta_fields(vessel: VesselFile | None, site: Site | None) -> dict[str, Any]:
    """Fields of `RunMeta` that follow from the vessel file and the site file."""
    fields: dict[str, Any] = {}
    if vessel:
        tag = vessel.sensors.position
        fields["latency_s"], fields["tag_arm_m"] = tag.latency_s, (tag.x_m, tag.y_m)
        fields["pwm_limits_us"] = {c.name: (float(c.pwm_min_us), float(c.pwm_max_us)) for c in vessel.controls}
    if site:
        fields["site"] = site.name
        fields["anchors_m"] = {a.id: (a.north_m, a.east_m, a.down_m) for a in site.anchors}
    return fields


def _same_boat(log: LogFile, vessel: VesselFile) -> None:
    """Raise RunError where the vessel file in the log has other thrusters and servos, or the same on other channels."""
    own, given = channels_in(log.metadata), channels_of(vessel, [])
    if own and all(own.values()) and own != given:
        logged, said = (", ".join(f"{name} on channel {n}" for name, n in x.items()) for x in (own, given))
        raise RunError(
            f"{log.path}: the vessel file in it ({log.metadata.get('vessel', 'no name')}) has {logged}, that of "
            f"{vessel.name} {said}: another boat's log, or another boat's vessel file; without one the log's own counts"
        )


def channels_of(vessel: VesselFile | None, leases: list[OverrideLease]) -> dict[str, int]:
    """RC channel by name of thruster, then of servo, in the vessel file's order; without one by ch<channel>, as many as
    the leases have forces.
    """
    if vessel:
        return {control.name: control.channel for control in vessel.controls}
    widest = max(leases, key=lambda lease: len(lease.f_command_n))
    return {f"ch{channel}": channel for channel in widest.channels[: len(widest.f_command_n) or None]}


def attitude_row(a: Attitude) -> tuple[float, ...]:
    """Stamp [ns], heading from true north, roll, pitch [rad]."""
    return a.t_ns, a.psi_rad, a.phi_rad, a.theta_rad


def attitude_stream(rows: Sequence[tuple[float, ...]], site: Site | None) -> Stream:
    """Stream of rows as of `attitude_row`, headings from the site's first axis, as positions are, in [-pi, pi)."""
    stream = Stream.of("attitude", ("psi_rad", "phi_rad", "theta_rad"), rows, near="IMU")
    rotation_rad = math.radians(site.rotation_deg) if site else 0.0
    stream.columns["psi_rad"][:] = wrapped(stream.columns["psi_rad"] - rotation_rad)
    return stream


def imu_row(m: ImuSample) -> tuple[float, ...]:
    """Stamp [ns], yaw rate [rad/s], specific force along x and y [m/s^2]."""
    return m.t_ns, m.r_rad_s, m.ax_m_s2, m.ay_m_s2


def imu_stream(rows: Sequence[tuple[float, ...]]) -> Stream:
    """Stream of rows as of `imu_row`."""
    return Stream.of("IMU", ("r_rad_s", "ax_m_s2", "ay_m_s2"), rows)


def _imu(rows: list[tuple[Any, ...]], notes: list[LogProblem]) -> Stream:
    sources = sorted({row[-1] for row in rows})
    if len(sources) > 1:
        notes.append(LogProblem(kind="mixed", text=f"inertial samples of {', '.join(sources)} follow one another"))
    return imu_stream([row[:-1] for row in rows])


_ROWS: dict[type[Message], Callable[[Any], tuple[Any, ...]]] = {
    ImuSample: lambda m: (*imu_row(m), m.source),
    Attitude: attitude_row,
    Battery: lambda m: (m.t_ns, m.voltage_v),
}
"""Row kept of the most frequent messages: tuples of numbers, which the garbage collector does not track."""


def _commands(leases: list[OverrideLease], channels: Mapping[str, int], last_ns: int, link_ns: int) -> Stream:
    """Leases as they reach the output, `link_ns` later, and neutral from where one expired.

    `channels`: RC channel by name; `last_ns`: stamp of the last sample of the log.
    """
    rows: list[tuple[float, ...]] = []
    end_ns: int | None = None
    for lease in leases:
        t_ns = lease.t_ns + link_ns
        if end_ns is not None and t_ns > end_ns:
            rows.append((end_ns, *(float(NEUTRAL_US) for _ in channels)))
        pwm_us = dict(zip(lease.channels, lease.pwm_us, strict=False))
        rows.append((t_ns, *(pwm_us.get(channel, np.nan) for channel in channels.values())))
        end_ns = t_ns + round(lease.valid_for_s * 1e9)
    if end_ns is not None and end_ns <= last_ns:
        rows.append((end_ns, *(float(NEUTRAL_US) for _ in channels)))
    return Stream.of("commands", [f"pwm_{name}" for name in channels], rows, held=True)


def _truth(truths: list[GroundTruth], names: tuple[str, ...], forces_of: tuple[str, ...]) -> Stream:
    """Stream of the true motion and thruster forces, which the simulator logs in the order of `forces_of`."""
    rows = []
    for m in truths:
        forces = dict(zip(forces_of, m.f_n, strict=True)) if len(m.f_n) == len(forces_of) else {}
        motion = (m.north_m, m.east_m, wrapped(np.array(m.psi_rad)), m.u_m_s, m.v_m_s, m.r_rad_s)
        rows.append((m.t_ns, *motion, *(forces.get(name, np.nan) for name in names)))
    columns = [f"true_{name}" for name in _TRUTH] + [f"true_f_{name}_n" for name in names]
    return Stream.of("truth", columns, rows, outside=True)


def _disobeyed(
    leases: list[OverrideLease], outputs: list[ServoOutput], carried: Mapping[int, int], zero_ns: int
) -> list[LogProblem]:
    """Notes on intervals in which outputs match none of the leases of the last `OBEY_S`.

    `carried`: place in a lease (from 0) -> output (from 1).
    """
    if not carried:
        return []
    stamps = np.array([lease.t_ns for lease in leases])
    pwm = np.array([_at(lease.pwm_us, carried) for lease in leases])
    stretches: list[list[float]] = []
    commanded = [o for o in outputs if stamps[0] + OBEY_S * 1e9 <= o.t_ns <= stamps[-1]]
    odd = False
    for output in commanded:
        first, last = np.searchsorted(stamps, (output.t_ns - OBEY_S * 1e9, output.t_ns + 1))
        actual = _at(output.pwm_us, [number - 1 for number in carried.values()])
        near = last > first and (np.abs(pwm[first:last] - actual).max(axis=1) <= OBEY_US).any()
        t_s = (output.t_ns - zero_ns) / 1e9
        if not near and not odd:
            stretches.append([t_s, t_s])
        elif not near:
            stretches[-1][1] = t_s
        odd = not near
    text = "the autopilot's outputs are not what was commanded (disarmed, other mode, failsafe?)"
    return [LogProblem(kind="not obeyed", text=text, t_s=a, length_s=b - a) for a, b in stretches if b - a >= OBEY_S]


def _at(pwm_us: Sequence[int], places: Iterable[int]) -> np.ndarray:
    """Pulse widths [us] at these places, from 0; no pulse (0) beyond the end."""
    return np.array([pwm_us[place] if place < len(pwm_us) else 0 for place in places], dtype=float)


def _own(
    log: LogFile, name: str, load: Callable[..., Configuration], notes: list[LogProblem], effect: str
) -> Configuration | None:
    """A configuration file in the log; None without one, or with a note of the `effect` where refused."""
    try:
        return load(log.metadata[f"config/{name}"], name=f"{log.path}: {name}")
    except KeyError:
        return None
    except ConfigError as error:
        notes.append(LogProblem(kind="configuration", text=f"{error}; {effect}"))
        return None


def _site(log: LogFile) -> Site | None:
    """The site file in the log, if there is one. Raises RunError where this version refuses it."""
    try:
        return site_in(log.metadata, log.path)
    except ConfigError as error:
        raise RunError(f"{error}; give a site file that this version reads (--site)") from None
