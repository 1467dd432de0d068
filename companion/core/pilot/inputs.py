"""Inputs that lead to no lease and that no monitor takes: sensor readings, the operator's commands, link states.

    sensors       -> estimator
    the operator  -> events of the mode table, a mission
    the interlock -> an event of the mode table
    links         -> alerts

One handler a message, (state, message, t) -> (state, outputs). Messages of the autopilot and of the sticks are heard
by monitors alone (`monitors.table`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from msgspec.structs import replace

from companion.core.estimation.estimator import Estimator
from companion.core.geometry.frames import ssa
from companion.core.guidance.missions.mission import Mission
from companion.core.guidance.path import Path, Waypoint
from companion.core.guidance.steerage import corner_problems
from companion.core.messages import (
    HELD_PORT,
    MEASUREMENTS,
    Alert,
    Attitude,
    InterlockTrip,
    LinkStatus,
    Message,
    NewMission,
    OperatorCommand,
)
from companion.core.pilot import transitions
from companion.core.pilot.modes import WANTED
from companion.core.pilot.state import Outputs, PilotSettings, PilotState

Handler = Callable[[PilotState, Any, int], tuple[PilotState, Outputs]]


class InputHandler:
    """Settings and estimator; all that changes is in PilotState."""

    def __init__(self, settings: PilotSettings, estimator: Estimator):
        self.settings, self._estimator = settings, estimator

    def handlers(self) -> Mapping[type[Message], Handler]:
        """The handler of each type of message."""
        return {
            **dict.fromkeys(MEASUREMENTS, self._sense),
            LinkStatus: self._link,
            OperatorCommand: self._operator,
            InterlockTrip: self._trip,
            NewMission: self._new_mission,
        }

    def _sense(self, state: PilotState, message: Any, t_ns: int) -> tuple[PilotState, Outputs]:
        if isinstance(message, Attitude):
            psi = ssa(message.psi_rad - math.radians(self.settings.site.rotation_deg))
            message = replace(message, psi_rad=psi)
        estimator, innovations = self._estimator.step(state.estimator, message)
        return replace(state, estimator=estimator), list(innovations)

    def _link(self, state: PilotState, message: LinkStatus, t_ns: int) -> tuple[PilotState, Outputs]:
        wrong = message.state in ("stale", "lost") or HELD_PORT in message.reason
        level = "warning" if wrong else "info"
        text = f"{message.link}: {message.state}: {message.reason}"
        return state, [Alert(t_ns=t_ns, level=level, text=text)]

    def _operator(self, state: PilotState, message: OperatorCommand, t_ns: int) -> tuple[PilotState, Outputs]:
        if message.command == "excite" and self.settings.excitation is None:
            return state, [Alert(t_ns=t_ns, level="warning", text="no excitation to fly: name one in the run file")]
        why = f"{'stopped' if message.command == 'stop' else message.command} by the operator"
        if message.command in WANTED:
            state = replace(state, ordered_ns=t_ns)
        return transitions.event(state, message.command, why, t_ns)

    def _trip(self, state: PilotState, message: InterlockTrip, t_ns: int) -> tuple[PilotState, Outputs]:
        return transitions.event(state, "interlock_trip", message.why, t_ns)

    def _new_mission(self, state: PilotState, message: NewMission, t_ns: int) -> tuple[PilotState, Outputs]:
        """A mission, to be driven from its first waypoint; not loaded while another is driven."""
        text = f"mission {message.name} with {len(message.waypoints)} waypoints"
        if state.helm.on_mission:
            return state, [Alert(t_ns=t_ns, level="warning", text=f"{text} not loaded: hold or stop first")]
        points = tuple(Waypoint(w.north_m, w.east_m, w.speed_m_s, w.acceptance_m) for w in message.waypoints)
        mission = Mission(message.name, Path(points), message.end_heading_rad)
        if problems := corner_problems(mission.path, self.settings.guidance):
            return state, [Alert(t_ns=t_ns, level="warning", text=f"{text} not loaded: {problems[0]}")]
        alert = Alert(t_ns=t_ns, level="info", text=f"{text} loaded: start begins it")
        return replace(state, mission=mission, passed=()), [alert]
