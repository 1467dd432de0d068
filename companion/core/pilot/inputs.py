"""What comes in and asks for no lease: readings, the autopilot's words, the operator's, the sticks'.

    sensors            -> estimator, unless the sensor is stuck (`frozen`)
    the autopilot      -> vehicle, echo, round trips, pack
    the operator       -> events of the mode table, a mission
    sticks, link       -> what the next lease is made of

One handler a message, (state, message, t) -> (state, outputs); nothing here moves a thruster.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from msgspec.structs import replace as struct_replace

from companion.core.estimation.estimator import Estimator
from companion.core.geometry.frames import ssa
from companion.core.guidance.missions.mission import Mission
from companion.core.guidance.path import Path, Waypoint
from companion.core.messages import (
    Alert,
    Attitude,
    Battery,
    Heartbeat,
    ImuSample,
    LinkStatus,
    ManualInput,
    Message,
    NewMission,
    OperatorCommand,
    ParamValue,
    RcChannels,
    ServoOutput,
    TimeSync,
    UwbPosition,
    UwbRanges,
)
from companion.core.pilot import annunciator, autopilot_state, manual_control, transitions
from companion.core.pilot.monitors import battery, link_latency, override_monitor, stuck_sensor
from companion.core.pilot.state import Outputs, PilotSettings, PilotState

Handler = Callable[[PilotState, Any, int], tuple[PilotState, Outputs]]


class InputHandler:
    """Settings and estimator; all that changes is in PilotState.

    `channels`: of the thrusters, then those held still.
    """

    def __init__(self, settings: PilotSettings, estimator: Estimator, channels: tuple[int, ...]):
        self.settings, self._estimator, self._channels = settings, estimator, channels
        self._n = len(settings.vessel.thrusters)

    def handlers(self) -> Mapping[type[Message], Handler]:
        """What hears each kind of message."""
        return {
            ImuSample: self._inertial,
            Attitude: self._inertial,
            UwbRanges: self._sense,
            UwbPosition: self._sense,
            Battery: self._battery,
            Heartbeat: self._heartbeat,
            LinkStatus: self._link,
            OperatorCommand: self._operator,
            ManualInput: self._sticks_moved,
            NewMission: self._new_mission,
            RcChannels: self._rc,
            ParamValue: self._parameter,
            ServoOutput: self._servo,
            TimeSync: self._timesync,
        }

    def _inertial(self, state: PilotState, message: ImuSample | Attitude, t_ns: int) -> tuple[PilotState, Outputs]:
        """A reading that is not one of a sensor that is stuck."""
        kind = type(message).__name__
        heard, alerts = stuck_sensor.hear(state.inertial.get(kind, stuck_sensor.NOTHING_HEARD), message, t_ns)
        state = replace(state, inertial={**state.inertial, kind: heard})
        if heard.stuck:
            return state, list(alerts)
        state, outputs = self._sense(state, message, t_ns)
        return state, [*alerts, *outputs]

    def _sense(self, state: PilotState, message: Any, t_ns: int) -> tuple[PilotState, Outputs]:
        if isinstance(message, Attitude):
            psi = ssa(message.psi_rad - math.radians(self.settings.site.rotation_deg))
            message = struct_replace(message, psi_rad=psi)
        estimator, innovations = self._estimator.step(state.estimator, message)
        outputs: Outputs = list(innovations)
        if isinstance(message, UwbRanges):
            seen, alerts = annunciator.at_ranges(state.lookout, message, self._estimator.anchors)
            state, outputs = replace(state, lookout=seen), [*outputs, *alerts]
        return replace(state, estimator=estimator), outputs

    def _battery(self, state: PilotState, message: Battery, t_ns: int) -> tuple[PilotState, Outputs]:
        nominal_v = self.settings.vessel.propulsion.nominal_voltage_V
        return replace(state, pack=battery.read(state.pack, message, nominal_v, self.settings.battery)), []

    def _heartbeat(self, state: PilotState, message: Heartbeat, t_ns: int) -> tuple[PilotState, Outputs]:
        known, events = autopilot_state.hear(state.vehicle, message)
        return transitions.events(replace(state, vehicle=known), events, t_ns)

    def _rc(self, state: PilotState, message: RcChannels, t_ns: int) -> tuple[PilotState, Outputs]:
        heard, events = override_monitor.at_rc(state.echo, message, self._channels, self.settings.system_id)
        return transitions.events(replace(state, echo=heard), events, t_ns)

    def _servo(self, state: PilotState, message: ServoOutput, t_ns: int) -> tuple[PilotState, Outputs]:
        heard, alerts = override_monitor.at_servo(state.echo, message, self._n)
        return replace(state, echo=heard), list(alerts)

    def _parameter(self, state: PilotState, message: ParamValue, t_ns: int) -> tuple[PilotState, Outputs]:
        return replace(state, echo=override_monitor.at_parameter(state.echo, message, self._channels[: self._n])), []

    def _timesync(self, state: PilotState, message: TimeSync, t_ns: int) -> tuple[PilotState, Outputs]:
        return replace(state, round_trips=link_latency.hear(state.round_trips, message)), []

    def _link(self, state: PilotState, message: LinkStatus, t_ns: int) -> tuple[PilotState, Outputs]:
        level = "warning" if message.state in ("stale", "lost") else "info"
        text = f"{message.link}: {message.state}: {message.reason}"
        return state, [Alert(t_ns=t_ns, level=level, text=text)]

    def _operator(self, state: PilotState, message: OperatorCommand, t_ns: int) -> tuple[PilotState, Outputs]:
        if message.command == "excite" and self.settings.excitation is None:
            return state, [Alert(t_ns=t_ns, level="warning", text="no excitation to fly: name one in the run file")]
        why = f"{'stopped' if message.command == 'stop' else message.command} by the operator"
        return transitions.event(state, message.command, why, t_ns)

    def _new_mission(self, state: PilotState, message: NewMission, t_ns: int) -> tuple[PilotState, Outputs]:
        """From its first waypoint; not while another is driven."""
        text = f"mission {message.name} with {len(message.waypoints)} waypoints"
        if state.helm.on_mission:
            return state, [Alert(t_ns=t_ns, level="warning", text=f"{text} not loaded: hold or stop first")]
        points = tuple(Waypoint(w.north_m, w.east_m, w.speed_m_s, w.acceptance_m) for w in message.waypoints)
        mission = Mission(message.name, Path(points), message.end_heading_rad)
        told = Alert(t_ns=t_ns, level="info", text=f"{text} loaded: start begins it")
        return replace(state, mission=mission, passed=()), [told]

    def _sticks_moved(self, state: PilotState, message: ManualInput, t_ns: int) -> tuple[PilotState, Outputs]:
        timeout_s = self.settings.control.manual_timeout_s
        return replace(state, sticks=manual_control.hear(state.sticks, message, t_ns, timeout_s)), []
