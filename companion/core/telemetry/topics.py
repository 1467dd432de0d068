"""One struct a topic, from the messages that it speaks of; numbers as fine as a plot can use (`rounding`).

`run`: the name of this run, in every struct. When each is sent is decided in `view`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from companion.core.guidance.missions.mission import Mission
from companion.core.messages import (
    AnchorRange,
    Attitude,
    Battery,
    ExcitationStatus,
    GuidanceReference,
    Heartbeat,
    ImuSample,
    Innovation,
    LinkStatus,
    Message,
    MissionPoint,
    ModeStatus,
    NewMission,
    OverrideLease,
    PlanResult,
    ServoOutput,
    SolveRequest,
    StateEstimate,
    UwbRanges,
)
from companion.core.pilot.autopilot_state import is_alive
from companion.core.pilot.state import PilotSettings
from companion.core.sensors.sensor import Sensor
from companion.core.telemetry import structs as shore
from companion.core.telemetry.rounding import age_s, angle, centimetres, cut, metres, triangle
from companion.core.telemetry.status import LinkNow

AGED: dict[str, tuple[type[Message], ...]] = {
    "heartbeat": (Heartbeat,),
    "imu": (ImuSample,),
    "attitude": (Attitude,),
}
"""Whose age is told beside that of the other sensors."""
OUTPUT_FRESH_NS = 1_000_000_000
"""A report of the outputs is of now for so long: ten periods of its stream (assumed)."""

SENSOR_FRESH_NS = 3_000_000_000
"""What a sensor said of its quality is of now for so long: some periods of a slow one (assumed)."""


class Who(NamedTuple):
    """Which run this is. `run`: its name in every struct."""

    run: str
    configuration: str
    software: str
    unix_minus_t_ns: int
    commands: bool


class SecondOfTiming:
    """What `timing` tells of a second: times [ms], solves by status, leases by source."""

    def __init__(self) -> None:
        self.late_ms: list[float] = []
        self.imu_ms: list[float] = []
        self.solve_ms: list[float] = []
        self.solves: Counter[str] = Counter()
        self.leases: Counter[str] = Counter()


def about(who: Who, settings: PilotSettings, t_ns: int) -> shore.About:
    """What does not change in a run."""
    site, fence, vessel = settings.site, settings.fence, settings.vessel
    return shore.About(
        run=who.run,
        t_ns=t_ns,
        vessel=vessel.name,
        site=site.name,
        configuration=who.configuration,
        software=who.software,
        unix_minus_t_ns=who.unix_minus_t_ns,
        period_s=settings.control.period_s,
        lat_deg=site.lat_deg,
        lon_deg=site.lon_deg,
        rotation_deg=site.rotation_deg,
        thrusters=tuple(
            shore.ThrusterAbout(
                name=t.name,
                channel=t.channel,
                x_m=t.x_m,
                y_m=t.y_m,
                azimuth_deg=t.azimuth_deg,
                force_min_n=t.force_min_N,
                force_max_n=t.force_max_N,
            )
            for t in vessel.thrusters
        ),
        anchors=tuple(shore.AnchorAbout(id=a.id, north_m=a.north_m, east_m=a.east_m) for a in site.anchors),
        within=tuple(tuple((n, e) for n, e in polygon) for polygon in fence.within),
        without=tuple(tuple((n, e) for n, e in polygon) for polygon in fence.without),
        commands=who.commands,
        length_m=vessel.hull.length_m,
        beam_m=vessel.hull.beam_m,
        guidance=shore.GuidanceAbout(**msgspec.structs.asdict(settings.guidance.limits), end=settings.guidance.end),
    )


def state(run: str, e: StateEstimate) -> shore.StateNow:
    """The estimate."""
    return shore.StateNow(
        run=run,
        t_ns=e.t_ns,
        north_m=metres(e.north_m),
        east_m=metres(e.east_m),
        psi_rad=angle(e.psi_rad),
        u_m_s=metres(e.u_m_s),
        v_m_s=metres(e.v_m_s),
        r_rad_s=angle(e.r_rad_s),
        covariance=triangle(e.covariance),
        disturbance_n=tuple(map(metres, e.disturbance_n)),
        health=e.health,
        reason=cut(e.reason),
    )


def attitude(run: str, a: Attitude) -> shore.AttitudeNow:
    """How the boat lies on the water."""
    heading = None if math.isnan(a.psi_rad) else angle(a.psi_rad)
    return shore.AttitudeNow(
        run=run, t_ns=a.t_ns, roll_rad=angle(a.phi_rad), pitch_rad=angle(a.theta_rad), heading_rad=heading
    )


def thrusters(
    run: str, lease: OverrideLease, sent: bool, output: ServoOutput | None, numbers: Sequence[int]
) -> shore.ThrustersNow:
    """The lease, whether it was `sent`, and the thrusters' outputs (`numbers`, from 1) as just reported."""
    n, pwm_us = len(numbers), ()
    if output and lease.t_ns - output.t_ns <= OUTPUT_FRESH_NS:
        pwm_us = output.pwm_us
    return shore.ThrustersNow(
        run=run,
        t_ns=lease.t_ns,
        pwm_us=lease.pwm_us[:n],
        force_n=tuple(map(metres, lease.f_command_n[:n])),
        source=lease.source,
        reason=cut(lease.reason),
        output_us=tuple(pwm_us[k - 1] for k in numbers) if len(pwm_us) >= max(numbers) else None,
        sent=sent,
    )


def reference(run: str, g: GuidanceReference) -> shore.ReferenceNow:
    """What guidance asks for."""
    return shore.ReferenceNow(
        run=run,
        t_ns=g.t_ns,
        phase=g.phase,
        leg=g.leg,
        waypoints_passed=g.waypoints_passed,
        x_e_m=metres(g.x_e_m),
        y_e_m=metres(g.y_e_m),
        psi_ref_rad=angle(g.psi_ref_rad),
        u_ref_m_s=metres(g.u_ref_m_s),
        north_ref_m=metres(g.north_ref_m),
        east_ref_m=metres(g.east_ref_m),
    )


def horizon(run: str, plan: PlanResult, request: SolveRequest, step_s: float) -> shore.HorizonNow:
    """A plan, and the places of the path that belong to it."""
    return shore.HorizonNow(
        run=run,
        t_ns=request.t_ns,
        status=plan.status,
        step_s=step_s,
        poses=tuple((centimetres(x[0]), centimetres(x[1]), centimetres(x[2])) for x in plan.x),
        reference=tuple((centimetres(row[0]), centimetres(row[1])) for row in request.reference),
    )


def ranges(run: str, measured: UwbRanges, residuals: Mapping[str, Innovation]) -> shore.RangesNow:
    """A tag's cycle. `residuals`: what the filter made of it, by anchor."""
    return shore.RangesNow(
        run=run, t_ns=measured.t_ns, ranges=tuple(_range(each, residuals.get(each.anchor)) for each in measured.ranges)
    )


def _range(measured: AnchorRange, judged: Innovation | None) -> shore.RangeNow:
    return shore.RangeNow(
        anchor=measured.anchor,
        range_m=metres(measured.range_m),
        residual_m=metres(judged.innovation[0]) if judged else None,
        accepted=judged.accepted if judged else None,
    )


def path(run: str, message: NewMission | Mission, t_ns: int) -> shore.PathNow:
    """The reference path: of an order from shore, or the run file's."""
    loaded = isinstance(message, NewMission)
    return shore.PathNow(
        run=run,
        t_ns=t_ns,
        name=message.name,
        waypoints=message.waypoints if loaded else points_of(message),
        end_heading_rad=message.end_heading_rad,
        origin="shore" if loaded else "run file",
    )


def points_of(mission: Mission) -> tuple[MissionPoint, ...]:
    """Waypoints of a mission as messages carry them."""
    return tuple(
        MissionPoint(north_m=w.north_m, east_m=w.east_m, speed_m_s=w.speed_m_s, acceptance_m=w.acceptance_m)
        for w in mission.path.waypoints
    )


def excitation(run: str, x: ExcitationStatus) -> shore.ExcitationNow:
    """How far an excitation is."""
    return shore.ExcitationNow(
        run=run,
        t_ns=x.t_ns,
        phase=x.phase,
        segment=x.segment,
        segments=x.segments,
        name=x.name,
        elapsed_s=round(x.elapsed_s, 1),
    )


def mode(run: str, message: ModeStatus, beat: Heartbeat | None) -> shore.ModeNow:
    """The pilot's mode, and the autopilot's with it while it is alive."""
    alive = beat if beat and is_alive(beat.t_ns, message.t_ns) else None
    return shore.ModeNow(
        run=run,
        t_ns=message.t_ns,
        mode=message.mode,
        why=cut(message.why),
        driving=message.driving,
        armed=alive.armed if alive else None,
        autopilot_mode=alive.custom_mode if alive else None,
    )


def links(
    run: str, statuses: Iterable[LinkStatus], sensors: Sequence[Sensor], last: Mapping[type[Message], Any], t_ns: int
) -> shore.LinksNow:
    """Devices, how old the `last` message of each kind is, and what `sensors` (not inertial) say of their quality."""
    aged = {**AGED, **{sensor.key: sensor.messages for sensor in sensors}}
    ages_s = {name: age_s(t_ns, [last.get(kind) for kind in kinds]) for name, kinds in aged.items()}
    latest = [(sensor, m) for sensor in sensors for kind in sensor.messages if (m := last.get(kind))]
    fresh = [(sensor, m) for sensor, m in latest if t_ns - m.t_ns <= SENSOR_FRESH_NS]
    figures = {sensor.label: text for sensor, m in fresh if (text := sensor.figure(m))}
    each = tuple(LinkNow(link=m.link, state=m.state, reason=cut(m.reason)) for m in statuses)
    return shore.LinksNow(run=run, t_ns=t_ns, links=each, ages_s=ages_s, figures=figures)


def battery(run: str, b: Battery, t_ns: int) -> shore.BatteryNow:
    """The pack, as the autopilot last reported."""
    return shore.BatteryNow(
        run=run,
        t_ns=t_ns,
        voltage_v=round(b.voltage_v, 2),
        current_a=None if b.current_a is None else round(b.current_a, 2),
        remaining_percent=b.remaining_percent,
        age_s=round((t_ns - b.t_ns) * 1e-9, 1),
    )
