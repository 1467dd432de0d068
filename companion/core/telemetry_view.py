"""From the stream of messages that a run's `watch` sees to what is published, and how often.

    view.see(message)  ->  [structs of shore_messages that are due]

Topics with a rate are due at the end of a tick (its LoopTiming), alerts and changes of mode at once. A rate is kept on
average: a topic that was due a little before the tick is not put off to the next but one. Pure: time is the messages'.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from companion.core import shore_messages as shore
from companion.core.checks import Row, worst
from companion.core.messages import (
    Alert,
    Attitude,
    Battery,
    ExcitationStatus,
    GuidanceReference,
    Heartbeat,
    ImuSample,
    LinkStatus,
    LoopTiming,
    Message,
    MissionPoint,
    ModeStatus,
    NewMission,
    OverrideLease,
    PlanResult,
    ProcessStats,
    ServoOutput,
    SolveRequest,
    StateEstimate,
    UwbPosition,
    UwbRanges,
)
from companion.core.mission import Mission
from companion.core.pilot_state import PilotSettings
from companion.core.telemetry_figures import age_s, angle, centimetres, cut, metres, spread, triangle

S = 1_000_000_000
EARLY = 0.3
"""A topic counts as due this share of its period early: ticks drift by 1 ms and are late by some (assumed)."""
ALERTS_S = 10
"""So many alerts a second, no more: a fault that speaks at every tick must not fill the radio (assumed)."""


class Who(NamedTuple):
    """Which run this is. `run`: its name in every struct."""

    run: str
    configuration: str
    software: str
    unix_minus_t_ns: int
    commands: bool


def wants(message: Message) -> bool:
    """Whether the view would do anything with a message."""
    return type(message) in _SEE


class View:
    """What is known of one run, and when each topic was last told. `rate_hz`: of the fastest topics."""

    def __init__(self, settings: PilotSettings, who: Who, rate_hz: float) -> None:
        self.dropped = 0
        """Messages that the shell had no room for; told with `timing`."""
        self.refused = 0
        """Orders from shore that were refused; told likewise."""
        self._settings, self._who = settings, who
        self._n = len(settings.vessel.thrusters)
        self._periods_ns = {kind: round(share * S / rate_hz) for kind, share in _RATED.items()}
        self._periods_ns |= dict.fromkeys(_SLOW, S) | {shore.ExcitationNow: S // 2}
        self._due_ns: dict[type, int] = {}
        self._last: dict[type[Message], Any] = {}
        self._links: dict[str, LinkStatus] = {}
        self._loaded: NewMission | None = None
        self._request: SolveRequest | None = None
        self._horizon: tuple[PlanResult, SolveRequest] | None = None
        self._second = _Second()
        self._alerts: list[int] = []

    def begin(self, t_ns: int) -> list[shore.Told]:
        """What is told at the start: the boat, and its path."""
        return [self._about(t_ns), self._path_now(t_ns)]

    def checks(self, rows: Sequence[Row], t_ns: int) -> shore.ChecksNow:
        """The pre-flight rows, once they are known."""
        return shore.ChecksNow(**self._head(t_ns), level=worst(rows), rows=tuple(rows))

    def see(self, message: Message) -> list[shore.Told]:
        """Note one message; what is to be published now."""
        if note := _SEE.get(type(message)):
            return note(self, message) or []
        return []

    # --- what comes in -----------------------------------------------------------------------------

    def _keep(self, message: Message) -> None:
        self._last[type(message)] = message

    def _link(self, message: LinkStatus) -> None:
        self._links[message.link] = message

    def _asked(self, message: SolveRequest) -> None:
        self._request = message

    def _planned(self, message: PlanResult) -> None:
        self._second.solves[message.status] += 1
        self._second.solve_ms.append(message.solve_time_s * 1e3)
        if message.x and self._request and self._request.index == message.index:
            self._horizon = message, self._request

    def _leased(self, message: OverrideLease) -> None:
        self._second.leases[message.source] += 1
        self._keep(message)

    def _mission(self, message: NewMission) -> None:
        self._keep(message)
        self._loaded = message

    def _alert(self, message: Alert) -> list[shore.Told]:
        self._alerts = [t_ns for t_ns in self._alerts if message.t_ns - t_ns < S]
        if len(self._alerts) >= ALERTS_S:
            self.dropped += 1
            return []
        self._alerts.append(message.t_ns)
        return [shore.AlertTold(**self._head(message.t_ns), level=message.level, text=cut(message.text))]

    def _mode(self, message: ModeStatus) -> list[shore.Told]:
        beat: Heartbeat | None = self._last.get(Heartbeat)
        return [
            shore.ModeNow(
                **self._head(message.t_ns),
                mode=message.mode,
                why=cut(message.why),
                driving=message.driving,
                armed=beat.armed if beat else None,
                autopilot_mode=beat.custom_mode if beat else None,
            )
        ]

    def _tick_over(self, message: LoopTiming) -> list[shore.Told]:
        """The lease has gone out: everything that is due."""
        now, second = message.t_ns, self._second
        second.late_ms.append(message.lateness_ms)
        if message.imu_to_override_ms is not None:
            second.imu_ms.append(message.imu_to_override_ms)
        told: list[shore.Told] = []
        for kind, make in _MAKE.items():
            if self._is_due(kind, now) and (made := make(self, now)) is not None:
                self._due_ns[kind] = max(self._due_ns.get(kind, now) + self._periods_ns[kind], now)
                told.append(made)
        return told

    def _is_due(self, kind: type, now_ns: int) -> bool:
        return now_ns >= self._due_ns.get(kind, now_ns) - EARLY * self._periods_ns[kind]

    # --- what goes out -----------------------------------------------------------------------------

    def _head(self, t_ns: int) -> dict[str, Any]:
        return {"run": self._who.run, "t_ns": t_ns}

    def _about(self, t_ns: int) -> shore.About:
        told, site, fence = self._settings, self._settings.site, self._settings.fence
        return shore.About(
            **self._head(t_ns),
            vessel=told.vessel.name,
            site=site.name,
            configuration=self._who.configuration,
            software=self._who.software,
            unix_minus_t_ns=self._who.unix_minus_t_ns,
            period_s=told.control.period_s,
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
                for t in told.vessel.thrusters
            ),
            anchors=tuple(shore.AnchorAbout(id=a.id, north_m=a.north_m, east_m=a.east_m) for a in site.anchors),
            within=tuple(tuple((n, e) for n, e in polygon) for polygon in fence.within),
            without=tuple(tuple((n, e) for n, e in polygon) for polygon in fence.without),
            commands=self._who.commands,
        )

    def _state(self, t_ns: int) -> shore.StateNow | None:
        e: StateEstimate | None = self._last.pop(StateEstimate, None)
        if e is None:
            return None
        return shore.StateNow(
            **self._head(e.t_ns),
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

    def _thrusters(self, t_ns: int) -> shore.ThrustersNow | None:
        lease: OverrideLease | None = self._last.pop(OverrideLease, None)
        if lease is None:
            return None
        output: ServoOutput | None = self._last.get(ServoOutput)
        return shore.ThrustersNow(
            **self._head(lease.t_ns),
            pwm_us=lease.pwm_us[: self._n],
            force_n=tuple(map(metres, lease.f_command_n)),
            source=lease.source,
            reason=cut(lease.reason),
            output_us=output.pwm_us[: self._n] if output else None,
        )

    def _reference(self, t_ns: int) -> shore.ReferenceNow | None:
        g: GuidanceReference | None = self._last.pop(GuidanceReference, None)
        if g is None:
            return None
        return shore.ReferenceNow(
            **self._head(g.t_ns),
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

    def _horizon_now(self, t_ns: int) -> shore.HorizonNow | None:
        if self._horizon is None:
            return None
        (plan, request), self._horizon = self._horizon, None
        return shore.HorizonNow(
            **self._head(request.t_ns),
            status=plan.status,
            step_s=self._settings.nmpc.step_s,
            poses=tuple((centimetres(x[0]), centimetres(x[1]), centimetres(x[2])) for x in plan.x),
            reference=tuple((centimetres(row[0]), centimetres(row[1])) for row in request.reference),
        )

    def _path(self, t_ns: int) -> shore.PathNow | None:
        return self._path_now(t_ns) if self._loaded and self._last.pop(NewMission, None) else None

    def _path_now(self, t_ns: int) -> shore.PathNow:
        told = self._loaded or self._settings.mission
        return shore.PathNow(
            **self._head(t_ns),
            name=told.name,
            waypoints=told.waypoints if isinstance(told, NewMission) else points_of(told),
            end_heading_rad=told.end_heading_rad,
            origin="shore" if self._loaded else "run file",
        )

    def _excitation(self, t_ns: int) -> shore.ExcitationNow | None:
        x: ExcitationStatus | None = self._last.pop(ExcitationStatus, None)
        if x is None:
            return None
        return shore.ExcitationNow(
            **self._head(x.t_ns),
            phase=x.phase,
            segment=x.segment,
            segments=x.segments,
            name=x.name,
            elapsed_s=round(x.elapsed_s, 1),
        )

    def _timing(self, t_ns: int) -> shore.TimingNow:
        second, self._second = self._second, _Second()
        stats: ProcessStats | None = self._last.get(ProcessStats)
        return shore.TimingNow(
            **self._head(t_ns),
            lateness=spread(second.late_ms),
            imu_to_override=spread(second.imu_ms),
            solve=spread(second.solve_ms),
            solves=dict(second.solves),
            leases=dict(second.leases),
            cpu_percent=round(stats.cpu_percent, 1) if stats else None,
            rss_mb=round(stats.rss_mb, 1) if stats else None,
            dropped=self.dropped,
            refused=self.refused,
        )

    def _links_now(self, t_ns: int) -> shore.LinksNow:
        links = tuple(shore.LinkNow(link=m.link, state=m.state, reason=cut(m.reason)) for m in self._links.values())
        ages = {name: age_s(t_ns, [self._last.get(kind) for kind in kinds]) for name, kinds in _AGED.items()}
        return shore.LinksNow(**self._head(t_ns), links=links, ages_s=ages)

    def _battery(self, t_ns: int) -> shore.BatteryNow | None:
        b: Battery | None = self._last.get(Battery)
        if b is None:
            return None
        current = None if b.current_a is None else round(b.current_a, 2)
        return shore.BatteryNow(
            **self._head(t_ns),
            voltage_v=round(b.voltage_v, 2),
            current_a=current,
            remaining_percent=b.remaining_percent,
            age_s=round((t_ns - b.t_ns) * 1e-9, 1),
        )


class _Second:
    """Figures since the last `timing`."""

    def __init__(self) -> None:
        self.late_ms: list[float] = []
        self.imu_ms: list[float] = []
        self.solve_ms: list[float] = []
        self.solves: Counter[str] = Counter()
        self.leases: Counter[str] = Counter()


def points_of(mission: Mission) -> tuple[MissionPoint, ...]:
    """Waypoints of a mission as messages carry them."""
    return tuple(
        MissionPoint(north_m=w.north_m, east_m=w.east_m, speed_m_s=w.speed_m_s, acceptance_m=w.acceptance_m)
        for w in mission.path.waypoints
    )


_AGED: dict[str, tuple[type[Message], ...]] = {
    "heartbeat": (Heartbeat,),
    "imu": (ImuSample,),
    "attitude": (Attitude,),
    "uwb": (UwbRanges, UwbPosition),
}
_RATED: dict[type[shore.Told], int] = {
    shore.StateNow: 1,
    shore.ThrustersNow: 1,
    shore.ReferenceNow: 2,
    shore.HorizonNow: 2,
    shore.PathNow: 1,
}
"""Topic -> how many times the shortest period lies between two of it."""
_SLOW = (shore.TimingNow, shore.LinksNow, shore.BatteryNow)
_MAKE: dict[type[shore.Told], Callable[[View, int], shore.Told | None]] = {
    shore.StateNow: View._state,
    shore.ThrustersNow: View._thrusters,
    shore.ReferenceNow: View._reference,
    shore.HorizonNow: View._horizon_now,
    shore.PathNow: View._path,
    shore.ExcitationNow: View._excitation,
    shore.TimingNow: View._timing,
    shore.LinksNow: View._links_now,
    shore.BatteryNow: View._battery,
}
_SEE: dict[type[Message], Callable[[View, Any], list[shore.Told] | None]] = {
    **dict.fromkeys(
        (
            Attitude, Battery, ExcitationStatus, GuidanceReference, Heartbeat, ImuSample, ProcessStats,
            ServoOutput, StateEstimate, UwbPosition, UwbRanges,
        ),
        View._keep,
    ),
    Alert: View._alert,
    LinkStatus: View._link,
    LoopTiming: View._tick_over,
    ModeStatus: View._mode,
    NewMission: View._mission,
    OverrideLease: View._leased,
    PlanResult: View._planned,
    SolveRequest: View._asked,
}  # fmt: skip
