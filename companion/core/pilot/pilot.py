"""The boat's mind, pure: `step(state, inputs, t) -> (state, outputs)`. It composes the other rooms.

    Tick      -> estimate, conditions, mode table (`modes`); then what the mode's thrusters do (`driving`)
    plans     -> the lease of the open tick (`driving`)
    all else  -> `hearing`

Every tick ends in exactly one OverrideLease, neutral in every mode that does not drive.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from companion.core.estimation.estimator import Estimator
from companion.core.messages import Message, PlanDeadline, PlanResult, StateEstimate, Tick
from companion.core.pilot import annunciator, autopilot_state, manual_control, modes, transitions
from companion.core.pilot import conditions as watch
from companion.core.pilot.inputs import Handler, InputHandler
from companion.core.pilot.monitors import battery, link_latency, override_monitor
from companion.core.pilot.state import Outputs, PilotSettings, PilotState
from companion.core.pilot.thrust_command import ThrustCommander

__all__ = ["Pilot", "PilotSettings", "PilotState"]


class Pilot:
    """Compiled functions and settings; all that changes is in PilotState."""

    def __init__(self, settings: PilotSettings):
        self.settings = settings
        vessel = settings.vessel
        self.channels = (*(t.channel for t in vessel.thrusters), *settings.control.neutral_channels)
        self._estimator, self._fence = Estimator(vessel, settings.site), settings.fence
        self._hearing = InputHandler(settings, self._estimator, self.channels)
        self._driving = ThrustCommander(settings, self._estimator, self.channels)
        self._handlers: Mapping[type[Message], Handler] = {
            **self._hearing.handlers(),
            Tick: self._tick,
            PlanResult: self._driving.planned,
            PlanDeadline: self._driving.deadline,
        }

    def initial(self, t_ns: int) -> PilotState:
        """State at switch-on: nothing known, thrusters at rest."""
        vessel = self.settings.vessel
        return PilotState(
            estimator=self._estimator.initial(),
            pack=battery.BatteryState(vessel.propulsion.nominal_voltage_V),
            f_command_n=(0.0,) * len(vessel.thrusters),
        )

    def step(self, state: PilotState, inputs: Sequence[Message], t_ns: int) -> tuple[PilotState, Outputs]:
        """Take `inputs` in order at `t_ns` [ns]; what is to be done, said or logged."""
        outputs: Outputs = []
        for message in inputs:
            if handle := self._handlers.get(type(message)):
                state, more = handle(state, message, t_ns)
                state, told = transitions.mode_status(state, t_ns, tick=isinstance(message, Tick))
                outputs += [*more, *told]
        return state, outputs

    def _tick(self, state: PilotState, tick: Tick, t_ns: int) -> tuple[PilotState, Outputs]:
        estimate = self._estimator.estimate(state.estimator, t_ns)
        state, outputs = self._judge(replace(state, estimate=estimate), tick, estimate, t_ns)
        if state.open_tick is not None:  # the shell was too busy to say so: its lease still comes first
            state, left = self._driving.choose(state, t_ns, "no plan before the next tick")
            outputs += left
        state, more = self._driving.drive(replace(state, open_tick=tick.index), estimate, t_ns)
        return state, [estimate, *outputs, *more]

    def _judge(self, state: PilotState, tick: Tick, estimate: StateEstimate, t_ns: int) -> tuple[PilotState, Outputs]:
        """Conditions through the mode table, and what is still asked of autopilot and sticks."""
        silence = autopilot_state.silence(state.vehicle, t_ns)
        seen, alerts = annunciator.at_estimate(state.lookout, estimate)
        watched, conditions = watch.at_tick(
            state.watch, tick, estimate, seen, self._fence, state.pack, self.settings.control, state.plan_ns
        )
        heard, more, told = override_monitor.at_tick(state.echo, t_ns, heard=silence is None)
        trips, late = link_latency.at_tick(state.round_trips, t_ns, heard=silence is None)
        conditions |= more | late
        if silence:
            conditions["link_lost"] = silence
        state = replace(state, lookout=seen, watch=watched, echo=heard, round_trips=trips)
        helm, judged = modes.apply_conditions(state.helm, conditions, t_ns)
        state = transitions.apply_mode_state(state, helm, t_ns)
        outputs: Outputs = [*alerts, *told, *judged]
        if state.helm.mode == "manual" and (why := self._stick_trouble(state, t_ns)):
            state, more = transitions.event(state, "sticks_lost", why, t_ns)
            return state, [*outputs, *more]
        if state.helm.mode not in ("starting", "locked"):
            return state, outputs
        missing = modes.waits_for(state.helm, conditions)
        if missing:
            return transitions.waiting(state, missing), outputs
        known, requests, waiting = autopilot_state.prepare(state.vehicle, t_ns)
        state, outputs = replace(state, vehicle=known), [*outputs, *requests]
        if not waiting and state.helm.mode == "locked":
            waiting = self._stick_trouble(state, t_ns) or ""
        if waiting:
            return transitions.waiting(state, waiting), outputs
        state, more = transitions.event(state, "ready", "all is ready", t_ns)
        return state, [*outputs, *more]

    def _stick_trouble(self, state: PilotState, t_ns: int) -> str | None:
        return manual_control.rejection(state.sticks, t_ns, self.settings.control.manual_timeout_s)
