"""The table of monitors, and the loops of the pilot over it: every monitor is named here and nowhere else.

link_lost                       `autopilot_state.AutopilotMonitor`   link_late       `link_latency`
unfit, degraded                 `annunciator.Annunciator`            fence_breached  `fence_distance`
battery_low, battery_critical   `battery`                            solver_failing  `plan_gap`
override_ignored, rc_takeover   `override_monitor`                   loop_lag        `loop_lag`
outputs_cut, outputs_still      `output_monitor`
sticks                          `manual_control.StickMonitor`
untrusted                       `trust.sensors`: `heading_check`, `motion_check`, `path_check`
crippled                        `trust.thrusters.thruster_monitor`
what the autopilot has against arming is kept by `arming_refusals`, readings that repeat themselves are left out by
`stuck_sensor` and `trust.sensors.repeated_ranges`, those that had queued up by `stall`, ranges that come late are said
by `path_check`, those that gates reject too often by `trust.sensors.rejected_ranges`, a battery that is not told by
`battery.BatteryWatch`: no conditions
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from msgspec.structs import replace

from companion.core.messages import Alert, Message
from companion.core.pilot import transitions
from companion.core.pilot.annunciator import Annunciator
from companion.core.pilot.autopilot_state import AutopilotMonitor
from companion.core.pilot.manual_control import StickMonitor
from companion.core.pilot.modes import Event
from companion.core.pilot.monitors.arming_refusals import ArmingMonitor
from companion.core.pilot.monitors.battery import BatteryMonitor, BatteryWatch
from companion.core.pilot.monitors.fence_distance import FenceMonitor
from companion.core.pilot.monitors.link_latency import LinkLatencyMonitor
from companion.core.pilot.monitors.loop_lag import LoopLagMonitor
from companion.core.pilot.monitors.monitor import Monitor, TickView
from companion.core.pilot.monitors.output_monitor import OutputMonitor
from companion.core.pilot.monitors.override_monitor import OverrideMonitor
from companion.core.pilot.monitors.plan_gap import PlanGapMonitor
from companion.core.pilot.monitors.stall import StallMonitor
from companion.core.pilot.monitors.stuck_sensor import StuckSensorMonitor
from companion.core.pilot.state import Outputs, PilotSettings, PilotState
from companion.core.pilot.trust.progress_check import ProgressMonitor
from companion.core.pilot.trust.sensors.accelerometer_check import AccelerometerMonitor
from companion.core.pilot.trust.sensors.heading_check import HeadingMonitor
from companion.core.pilot.trust.sensors.motion_check import MotionMonitor
from companion.core.pilot.trust.sensors.path_check import PathMonitor
from companion.core.pilot.trust.sensors.rejected_ranges import RejectedRangesMonitor
from companion.core.pilot.trust.sensors.repeated_ranges import RepeatedRangesMonitor
from companion.core.pilot.trust.thrusters.thruster_monitor import ThrusterMonitor


def monitors_of(settings: PilotSettings, channels: tuple[int, ...], anchors: tuple[str, ...]) -> MonitorTable:
    """The monitors of one run, in the order in which they report.

    `channels`: RC channels of thrusters and servos, then those held still; `anchors`: names that the estimator knows.
    """
    vessel, control = settings.vessel, settings.control
    return MonitorTable(
        (
            StallMonitor(),
            StuckSensorMonitor(),
            RepeatedRangesMonitor(),
            AccelerometerMonitor(vessel.sensors.imu),
            HeadingMonitor(vessel, math.radians(settings.site.rotation_deg)),
            AutopilotMonitor(),
            ArmingMonitor(),
            Annunciator(anchors, control.blind_s),
            FenceMonitor(settings.fence),
            BatteryMonitor(vessel.propulsion.nominal_voltage_V, settings.battery),
            BatteryWatch(vessel.propulsion.nominal_voltage_V, settings.battery),
            PlanGapMonitor(),
            LoopLagMonitor(control.period_s),
            OverrideMonitor(channels, len(vessel.controls), settings.system_id),
            OutputMonitor(channels[: len(vessel.controls)], len(vessel.thrusters)),
            LinkLatencyMonitor(),
            StickMonitor(control.manual_timeout_s),
            MotionMonitor(vessel),
            PathMonitor(vessel.sensors, settings.site),
            RejectedRangesMonitor(vessel),
            ThrusterMonitor(vessel),
            ProgressMonitor(),
        )
    )


class MonitorTable:
    """`monitors` in order. All that changes is in `PilotState.monitors`, by the type of the state."""

    def __init__(self, monitors: Iterable[Monitor[Any]]):
        self.monitors = tuple(monitors)
        kinds = {kind for monitor in self.monitors for kind in monitor.hears}
        self._screens, self._listeners = (
            {kind: [m for m in self.monitors if kind in m.hears and m.screens is screens] for kind in kinds}
            for screens in (True, False)
        )

    def initial(self) -> Mapping[type, Any]:
        """All states at switch-on."""
        return {type(monitor.initial): monitor.initial for monitor in self.monitors}

    def screen(self, state: PilotState, message: Message, t_ns: int) -> tuple[PilotState, Outputs, Message | None]:
        """Monitors that come before the estimator; the last value: what they let through, None: one withholds it."""
        return _hear(self._screens.get(type(message), []), state, message, t_ns)

    def hear(self, state: PilotState, message: Message, t_ns: int) -> tuple[PilotState, Outputs]:
        """All other monitors of the message: their alerts, and their events through the mode table."""
        return _hear(self._listeners.get(type(message), []), state, message, t_ns)[:2]

    def on_tick(self, state: PilotState, view: TickView) -> tuple[PilotState, dict[Event, str], list[Alert]]:
        """All monitors at a tick: conditions that hold, and alerts."""
        own, conditions, alerts = dict(state.monitors), dict[Event, str](), list[Alert]()
        for monitor in self.monitors:
            kind = type(monitor.initial)
            own[kind], report = monitor.on_tick(own[kind], view)
            conditions.update(report.events)
            alerts += report.alerts
        return replace(state, monitors=own), conditions, alerts


def _hear(
    monitors: Iterable[Monitor[Any]], state: PilotState, message: Message, t_ns: int
) -> tuple[PilotState, Outputs, Message | None]:
    outputs: Outputs = []
    withhold = False
    changed: list[object] = []
    for monitor in monitors:
        before = state.monitor(type(monitor.initial))
        own, report = monitor.on_message(before, message, t_ns)
        if own is not before:
            changed.append(own)
        outputs += report.alerts
        if report.events:
            # The mode table sees what monitors know by now; a new mode may change their states.
            state, changes = transitions.events(state.with_monitors(*changed), report.events, t_ns)
            outputs += changes
            changed.clear()
        withhold = withhold or report.withhold
        message = report.instead or message
    state = state.with_monitors(*changed) if changed else state
    return state, outputs, None if withhold else message
