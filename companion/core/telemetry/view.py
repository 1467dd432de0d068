"""From the stream of messages that a run's `watch` sees to what is published, and how often.

    view.see(message)  ->  [structs of `structs` and `status` that are due]

Topics with a rate are due at the end of a tick (its LoopTiming), alerts and changes of mode at once. A rate is kept on
average: a topic that was due a little before the tick is not put off to the next but one. Pure: time is the messages'.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from companion.core.messages import (
    Alert,
    Attitude,
    Battery,
    ExcitationStatus,
    GuidanceReference,
    Heartbeat,
    ImuSample,
    Innovation,
    LinkStatus,
    LoopTiming,
    Message,
    ModeStatus,
    NewMission,
    OverrideLease,
    ParamValue,
    PlanResult,
    ProcessStats,
    ServoOutput,
    SolveRequest,
    StateEstimate,
    UwbRanges,
)
from companion.core.pilot.monitors.sent_pulses import SentPulses, at_parameter, outputs_of
from companion.core.pilot.state import PilotSettings
from companion.core.preflight.rows import Row, worst
from companion.core.sensors.table import AIDING, sensors_of
from companion.core.telemetry import structs as shore
from companion.core.telemetry import topics
from companion.core.telemetry.rounding import cut, spread
from companion.core.telemetry.topics import Who

S = 1_000_000_000
EARLY = 0.3
"""A topic counts as due this share of its period early: ticks drift by 1 ms and are late by some (assumed)."""
RANGE = "range "
"""How innovations of ranges are called: this, and the anchor."""
ALERTS_S = 10
"""So many alerts a second, no more: a fault that speaks at every tick must not fill the radio (assumed)."""


def wants(message: Message) -> bool:
    """Whether the view would do anything with a message."""
    return type(message) in _SEE


class TelemetryView:
    """What is known of one run, and when each topic was last sent. `rate_hz`: of the fastest topics."""

    def __init__(self, settings: PilotSettings, who: Who, rate_hz: float) -> None:
        self.dropped = 0
        """Messages that the shell had no room for; sent with `timing`."""
        self.refused = 0
        """Orders from shore that were refused; sent likewise."""
        self._settings, self._who = settings, who
        self._channels = tuple(thruster.channel for thruster in settings.vessel.thrusters)
        self._wired = SentPulses()
        self._sensors = [sensor for sensor in sensors_of(settings.vessel.sensors, settings.site) if sensor.aids]
        self._periods_ns = {kind: round(share * S / rate_hz) for kind, share in _RATED.items()}
        self._periods_ns |= dict.fromkeys(_SLOW, S) | dict.fromkeys(_HALF_SECOND, S // 2)
        self._due_ns: dict[type, int] = {}
        self._last: dict[type[Message], Any] = {}
        self._ranges_ns: int | None = None
        self._attitude_ns: int | None = None
        self._links: dict[str, LinkStatus] = {}
        self._residuals: dict[str, Innovation] = {}
        self._sent = False
        self._loaded: NewMission | None = None
        self._request: SolveRequest | None = None
        self._horizon: tuple[PlanResult, SolveRequest] | None = None
        self._second = topics.SecondOfTiming()
        self._alerts: list[int] = []

    def begin(self, t_ns: int) -> list[shore.ShoreMessage]:
        """What is sent at the start: the boat, and its path."""
        return [topics.about(self._who, self._settings, t_ns), self._path_now(t_ns)]

    def checks(self, rows: Sequence[Row], t_ns: int) -> shore.ChecksNow:
        """The pre-flight rows, once they are known."""
        return shore.ChecksNow(**self._head(t_ns), level=worst(rows), rows=tuple(rows))

    def end(self, t_ns: int) -> list[shore.ShoreMessage]:
        """What is sent last: that the program has ended, so that shore need not take its silence for a lost link."""
        mode: ModeStatus | None = self._last.get(ModeStatus)
        if mode is None:
            return []
        last = topics.mode(self._who.run, mode, self._last.get(Heartbeat))
        return [msgspec.structs.replace(last, t_ns=max(t_ns, mode.t_ns + 1), driving=False, ended=True)]

    def see(self, message: Message) -> list[shore.ShoreMessage]:
        """Note one message; what is to be published now."""
        if note := _SEE.get(type(message)):
            return note(self, message) or []
        return []

    # --- what comes in -----------------------------------------------------------------------------

    def _keep(self, message: Message) -> None:
        self._last[type(message)] = message

    def _link(self, message: LinkStatus) -> None:
        self._links[message.link] = message

    def _note_ranges(self, message: UwbRanges) -> None:
        """What the filter makes of its ranges comes right after it."""
        self._keep(message)
        self._residuals.clear()

    def _innovated(self, message: Innovation) -> None:
        if message.sensor.startswith(RANGE):
            self._residuals[message.sensor.removeprefix(RANGE)] = message

    def _parameter(self, message: ParamValue) -> None:
        self._wired = at_parameter(self._wired, message, self._channels)

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

    def _alert(self, message: Alert) -> list[shore.ShoreMessage]:
        self._alerts = [t_ns for t_ns in self._alerts if message.t_ns - t_ns < S]
        if len(self._alerts) >= ALERTS_S:
            self.dropped += 1
            return []
        self._alerts.append(message.t_ns)
        return [shore.AlertTold(**self._head(message.t_ns), level=message.level, text=cut(message.text))]

    def _mode(self, message: ModeStatus) -> list[shore.ShoreMessage]:
        self._keep(message)
        return [topics.mode(self._who.run, message, self._last.get(Heartbeat))]

    def _tick_over(self, message: LoopTiming) -> list[shore.ShoreMessage]:
        """The lease has gone out: everything that is due."""
        now, second = message.t_ns, self._second
        self._sent = message.sent
        second.late_ms.append(message.lateness_ms)
        if message.imu_to_override_ms is not None:
            second.imu_ms.append(message.imu_to_override_ms)
        due: list[shore.ShoreMessage] = []
        for kind, make in _MAKE.items():
            if self._is_due(kind, now) and (made := make(self, now)) is not None:
                self._due_ns[kind] = max(self._due_ns.get(kind, now) + self._periods_ns[kind], now)
                due.append(made)
        return due

    def _is_due(self, kind: type, now_ns: int) -> bool:
        return now_ns >= self._due_ns.get(kind, now_ns) - EARLY * self._periods_ns[kind]

    # --- what goes out -----------------------------------------------------------------------------

    def _head(self, t_ns: int) -> dict[str, Any]:
        return {"run": self._who.run, "t_ns": t_ns}

    def _state(self, t_ns: int) -> shore.StateNow | None:
        e: StateEstimate | None = self._last.pop(StateEstimate, None)
        return topics.state(self._who.run, e) if e else None

    def _attitude(self, t_ns: int) -> shore.AttitudeNow | None:
        latest: Attitude | None = self._last.get(Attitude)
        if latest is None or latest.t_ns == self._attitude_ns:
            return None
        self._attitude_ns = latest.t_ns
        return topics.attitude(self._who.run, latest)

    def _thrusters(self, t_ns: int) -> shore.ThrustersNow | None:
        lease: OverrideLease | None = self._last.pop(OverrideLease, None)
        if lease is None:
            return None
        numbers = outputs_of(self._wired, len(self._channels))
        return topics.thrusters(self._who.run, lease, self._sent, self._last.get(ServoOutput), numbers)

    def _reference(self, t_ns: int) -> shore.ReferenceNow | None:
        g: GuidanceReference | None = self._last.pop(GuidanceReference, None)
        return topics.reference(self._who.run, g) if g else None

    def _horizon_now(self, t_ns: int) -> shore.HorizonNow | None:
        if self._horizon is None:
            return None
        (plan, request), self._horizon = self._horizon, None
        return topics.horizon(self._who.run, plan, request, self._settings.nmpc.step_s)

    def _ranges(self, t_ns: int) -> shore.RangesNow | None:
        latest: UwbRanges | None = self._last.get(UwbRanges)
        if latest is None or latest.t_ns == self._ranges_ns:
            return None
        self._ranges_ns = latest.t_ns
        return topics.ranges(self._who.run, latest, self._residuals)

    def _path(self, t_ns: int) -> shore.PathNow | None:
        return self._path_now(t_ns) if self._loaded and self._last.pop(NewMission, None) else None

    def _path_now(self, t_ns: int) -> shore.PathNow:
        return topics.path(self._who.run, self._loaded or self._settings.mission, t_ns)

    def _excitation(self, t_ns: int) -> shore.ExcitationNow | None:
        x: ExcitationStatus | None = self._last.pop(ExcitationStatus, None)
        return topics.excitation(self._who.run, x) if x else None

    def _timing(self, t_ns: int) -> shore.TimingNow:
        second, self._second = self._second, topics.SecondOfTiming()
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
        return topics.links(self._who.run, self._links.values(), self._sensors, self._last, t_ns)

    def _battery(self, t_ns: int) -> shore.BatteryNow | None:
        b: Battery | None = self._last.get(Battery)
        return topics.battery(self._who.run, b, t_ns) if b else None


_RATED: dict[type[shore.ShoreMessage], int] = {
    shore.StateNow: 1,
    shore.ThrustersNow: 1,
    shore.ReferenceNow: 2,
    shore.HorizonNow: 2,
    shore.PathNow: 1,
}
"""Topic -> how many times the shortest period lies between two of it."""
_HALF_SECOND = (shore.AttitudeNow, shore.ExcitationNow, shore.RangesNow)
_SLOW = (shore.TimingNow, shore.LinksNow, shore.BatteryNow)
_MAKE: dict[type[shore.ShoreMessage], Callable[[TelemetryView, int], shore.ShoreMessage | None]] = {
    shore.StateNow: TelemetryView._state,
    shore.AttitudeNow: TelemetryView._attitude,
    shore.ThrustersNow: TelemetryView._thrusters,
    shore.ReferenceNow: TelemetryView._reference,
    shore.HorizonNow: TelemetryView._horizon_now,
    shore.PathNow: TelemetryView._path,
    shore.ExcitationNow: TelemetryView._excitation,
    shore.RangesNow: TelemetryView._ranges,
    shore.TimingNow: TelemetryView._timing,
    shore.LinksNow: TelemetryView._links_now,
    shore.BatteryNow: TelemetryView._battery,
}
_SEE: dict[type[Message], Callable[[TelemetryView, Any], list[shore.ShoreMessage] | None]] = {
    **dict.fromkeys(
        (
            Attitude, Battery, ExcitationStatus, GuidanceReference, Heartbeat, ImuSample, ProcessStats,
            ServoOutput, StateEstimate, *AIDING,
        ),
        TelemetryView._keep,
    ),
    Alert: TelemetryView._alert,
    Innovation: TelemetryView._innovated,
    LinkStatus: TelemetryView._link,
    LoopTiming: TelemetryView._tick_over,
    ModeStatus: TelemetryView._mode,
    NewMission: TelemetryView._mission,
    OverrideLease: TelemetryView._leased,
    ParamValue: TelemetryView._parameter,
    PlanResult: TelemetryView._planned,
    SolveRequest: TelemetryView._asked,
    UwbRanges: TelemetryView._note_ranges,
}  # fmt: skip
