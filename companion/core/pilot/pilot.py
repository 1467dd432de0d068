"""The boat's pilot, pure: `step(state, inputs, t) -> (state, outputs)`. It composes the other modules of this folder.

    every message -> monitors (`monitors.table`), then its handler here, in `inputs` or in `thrust_command`
    Tick          -> estimate, conditions, mode table (`modes`); then what the mode's thrusters do (`thrust_command`)
    plans         -> the lease of the open tick (`thrust_command`)

Every tick ends in exactly one OverrideLease, neutral in every mode that does not drive.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msgspec.structs import replace

from companion.core.estimation.estimator import Estimator
from companion.core.estimation.filter_state import FilterState
from companion.core.messages import Innovation, Message, PlanDeadline, PlanResult, StateEstimate, Tick
from companion.core.pilot import autopilot_state, manual_control, modes, transitions
from companion.core.pilot.autopilot_state import AutopilotState
from companion.core.pilot.inputs import Handler, InputHandler
from companion.core.pilot.manual_control import Sticks
from companion.core.pilot.modes import Event
from companion.core.pilot.monitors.arming_refusals import ArmingRefusals, explain
from companion.core.pilot.monitors.monitor import LegAhead, TickView
from companion.core.pilot.monitors.table import monitors_of
from companion.core.pilot.order_expiry import expiry
from companion.core.pilot.state import Outputs, PilotSettings, PilotState
from companion.core.pilot.thrust_command import ThrustCommander
from companion.core.pilot.trust.contradictions import findings, is_suspect
from companion.core.pilot.trust.model_motion import ModelMotion
from companion.core.pilot.trust.thrusters.thruster_verdict import ThrusterState
from companion.core.pilot.trust.verdict import vet
from companion.core.sensors.table import SensorTable

__all__ = ["Pilot", "PilotSettings", "PilotState"]


class Pilot:
    """Compiled functions and settings; all that changes is in PilotState."""

    def __init__(self, settings: PilotSettings):
        self.settings = settings
        vessel = settings.vessel
        self.channels = (*(control.channel for control in vessel.controls), *settings.control.neutral_channels)
        self._estimator = Estimator(vessel, settings.site)
        self._monitors = monitors_of(settings, self.channels, self._estimator.anchors)
        self._motion = ModelMotion(vessel, settings.control.period_s)
        self._hearing = InputHandler(settings, self._estimator)
        self._driving = ThrustCommander(settings, self._estimator, self.channels, self._monitors)
        self._handlers: Mapping[type[Message], Handler] = {
            **self._hearing.handlers(),
            Tick: self._tick,
            PlanResult: self._driving.planned,
            PlanDeadline: self._driving.deadline,
        }

    @property
    def sensors(self) -> SensorTable:
        """The boat's sensors."""
        return self._estimator.sensors

    def initial(self, t_ns: int) -> PilotState:
        """State at switch-on: nothing known, thrusters at rest."""
        return PilotState(
            estimator=self._estimator.initial(),
            monitors=self._monitors.initial(),
            f_command_n=(0.0,) * len(self.settings.vessel.controls),
        )

    def step(self, state: PilotState, inputs: Sequence[Message], t_ns: int) -> tuple[PilotState, Outputs]:
        """Take `inputs` in order at `t_ns` [ns]; what is to be done, said or logged."""
        outputs: Outputs = []
        for message in inputs:
            state, more = self._take(state, message, t_ns)
            state, status = transitions.mode_status(state, t_ns, tick=isinstance(message, Tick))
            outputs += [*more, *status]
        return state, outputs

    def _take(self, state: PilotState, message: Message, t_ns: int) -> tuple[PilotState, Outputs]:
        """One message: monitors that may withhold it, its handler, all other monitors."""
        state, outputs, let_through = self._monitors.screen(state, message, t_ns)
        if let_through is None:
            return state, outputs
        if handle := self._handlers.get(type(message)):
            state, more = handle(state, let_through, t_ns)
            outputs += more
            for innovation in more:
                if isinstance(innovation, Innovation):
                    state, alerts = self._monitors.hear(state, innovation, t_ns)
                    outputs += alerts
        state, more = self._monitors.hear(state, let_through, t_ns)
        return state, [*outputs, *more]

    def _tick(self, state: PilotState, tick: Tick, t_ns: int) -> tuple[PilotState, Outputs]:
        belief = self._estimator.belief(state.estimator, t_ns)
        estimate = vet(self._estimator.estimate(state.estimator, t_ns, belief), findings(state))
        motion = self._motion.step(state.model_nu, belief, anew=state.monitor(ThrusterState).has_changed(t_ns))
        state = replace(state, estimate=estimate, model_nu=motion)
        state, outputs = self._judge(state, tick, estimate, belief, t_ns)
        if state.open_tick is not None:  # the shell was too busy to say so: its lease still comes first
            state, left = self._driving.choose(state, t_ns, "no plan before the next tick")
            outputs += left
        state, more = self._driving.drive(replace(state, open_tick=tick.index), estimate, t_ns)
        return state, [estimate, *outputs, *more]

    def _judge(
        self, state: PilotState, tick: Tick, estimate: StateEstimate, belief: FilterState | None, t_ns: int
    ) -> tuple[PilotState, Outputs]:
        """Conditions through the mode table, and what is still wanted of autopilot and sticks."""
        state, outputs = self._monitors.hear(state, estimate, t_ns)
        alive = autopilot_state.is_alive(state.monitor(AutopilotState).heartbeat_ns, t_ns)
        thrusters = state.monitor(ThrusterState)
        view = TickView(
            t_ns, tick.lateness_ns, estimate, state.plan_ns, alive, belief, state.model_nu,
            self.settings.control.period_s, state.helm.driving, state.helm.mode == "excitation",
            is_suspect(state), thrusters.suspected, thrusters.has_changed(t_ns), _leg(state, estimate),
        )  # fmt: skip
        state, conditions, alerts = self._monitors.on_tick(state, view)
        helm, changes = modes.apply_conditions(state.helm, conditions, t_ns)
        state = transitions.apply_mode_state(state, helm, t_ns)
        outputs += [*alerts, *changes]
        if state.helm.mode == "manual" and (why := self._stick_rejection(state, t_ns)):
            state, more = transitions.event(state, "sticks_lost", why, t_ns)
        elif state.helm.mode in ("starting", "locked"):
            state, more = self._make_ready(state, conditions, t_ns)
            if why := expiry(state, state.monitor(AutopilotState).heartbeat_ns, t_ns):
                state, over = transitions.event(state, "expired", why, t_ns)
                more = [*more, *over]
        else:
            more = []
        return state, [*outputs, *more]

    def _make_ready(self, state: PilotState, conditions: Mapping[Event, str], t_ns: int) -> tuple[PilotState, Outputs]:
        """Requests to the autopilot, and `ready` once nothing is missing any more."""
        if missing := modes.waits_for(state.helm, conditions):
            return transitions.waiting(state, missing), []
        autopilot, requests, missing = autopilot_state.prepare(state.monitor(AutopilotState), t_ns)
        state = state.with_monitors(autopilot)
        if not missing and state.helm.mode == "locked":
            missing = self._stick_rejection(state, t_ns) or ""
        if missing and autopilot_state.is_asked_to_arm(autopilot):
            refusals, reason, alerts = explain(state.monitor(ArmingRefusals), t_ns)
            missing += f", which it refuses: {reason}" if reason else ""
            return transitions.waiting(state.with_monitors(refusals), missing), [*requests, *alerts]
        if missing:
            return transitions.waiting(state, missing), list(requests)
        state, more = transitions.event(state, "ready", "all is ready", t_ns)
        return state, [*requests, *more]

    def _stick_rejection(self, state: PilotState, t_ns: int) -> str | None:
        return manual_control.rejection(state.monitor(Sticks), t_ns, self.settings.control.manual_timeout_s)


def _leg(state: PilotState, estimate: StateEstimate) -> LegAhead | None:
    """The leg of a mission under way."""
    guided = state.guidance
    if state.helm.mode != "auto" or guided.phase != "leg" or guided.route is None:
        return None
    ahead_m = math.dist((estimate.north_m, estimate.east_m), guided.route.points[guided.target])
    return LegAhead(len(guided.passed) + 1, guided.s_m, ahead_m)
