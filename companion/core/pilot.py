"""The boat's mind, pure: `step(state, inputs, t) -> (state, outputs)`. It composes the other rooms.

    sensors            -> estimator
    Tick               -> estimate, conditions, mode table (`modes`); then what the mode's thrusters do:
                          controller  guidance, SolveRequest; its lease follows
                          sticks, excitation, neutral   the lease at once
    PlanResult         -> lease from the plan, if its tick is still open and the plan is sound
    PlanDeadline       -> lease from the fallback ladder, if its tick is still open
    all else           -> events of the mode table, at once

Every tick ends in exactly one OverrideLease, neutral in every mode that does not drive. The state predicted to
when a command acts (dead time ahead, under the commands already sent) is what the NMPC plans from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from msgspec.structs import replace as struct_replace

from companion.core import echo, frozen, guidance, lookout, modes, pack, round_trip, steering, sticks, vehicle, watch
from companion.core.allocation import allocate, force_limits, pulse_widths
from companion.core.estimator import Estimator
from companion.core.excitation.flight import BEGINNING, Flight
from companion.core.fallback import FallbackSettings, command
from companion.core.frames import ssa
from companion.core.messages import (
    Alert,
    Attitude,
    Battery,
    GuidanceReference,
    Heartbeat,
    ImuSample,
    LinkStatus,
    ManualInput,
    Message,
    NewMission,
    OperatorCommand,
    OverrideLease,
    ParamValue,
    PlanDeadline,
    PlanResult,
    RcChannels,
    ServoOutput,
    SolveRequest,
    StateEstimate,
    Tick,
    TimeSync,
    UwbPosition,
    UwbRanges,
)
from companion.core.mission import Mission
from companion.core.modes import THRUSTERS
from companion.core.path import Path, Waypoint
from companion.core.pilot_state import PilotSettings, PilotState
from companion.core.thrusters import NEUTRAL_US

__all__ = ["Pilot", "PilotSettings", "PilotState"]

SPREAD_SIGMAS = 2.0
"""An excitation stays so many sigmas of its position farther from the fence; assumed."""
REMEMBERED_TICKS = 20
"""Requests whose plans are still welcome, by tick: twice what the oldest usable plan needs at 10 Hz; assumed."""

Outputs = list[Message]


class Pilot:
    """Compiled functions and settings; all that changes is in PilotState."""

    def __init__(self, settings: PilotSettings):
        self.settings = settings
        vessel = settings.vessel
        still = settings.control.neutral_channels
        self.channels = (*(t.channel for t in vessel.thrusters), *still)
        self._still = (NEUTRAL_US,) * len(still)
        self._n = len(vessel.thrusters)
        self._estimator = Estimator(vessel, settings.site)
        self._flight: Flight | None = None
        if told := settings.excitation:
            self._flight = Flight(told, vessel, settings.site, name=told.name)
        self._sticks, self._fence, self._limits = sticks.StickForce(vessel), settings.fence, force_limits(vessel)
        self._latency_ns = round(settings.control.latency_s * 1e9)
        self._ahead_ns = self._latency_ns + round(vessel.propulsion.dead_time_s * 1e9)
        self._ladder = FallbackSettings(plan_age_s=settings.control.plan_deadline_s)
        self._times_s = [k * settings.nmpc.step_s for k in range(settings.nmpc.stages + 1)]

    def initial(self, t_ns: int) -> PilotState:
        """State at switch-on: nothing known, thrusters at rest."""
        vessel = self.settings.vessel
        return PilotState(
            estimator=self._estimator.initial(),
            pack=pack.Pack(vessel.propulsion.nominal_voltage_V),
            f_command_n=(0.0,) * len(vessel.thrusters),
        )

    def step(self, state: PilotState, inputs: Sequence[Message], t_ns: int) -> tuple[PilotState, Outputs]:
        """Take `inputs` in order at `t_ns` [ns]; what is to be done, said or logged."""
        outputs: Outputs = []
        for message in inputs:
            if handle := _HANDLERS.get(type(message)):
                state, more = handle(self, state, message, t_ns)
                state, told = steering.told(state, t_ns, tick=isinstance(message, Tick))
                outputs += [*more, *told]
        return state, outputs

    # --- what comes in -----------------------------------------------------------------------------

    def _inertial(self, state: PilotState, message: ImuSample | Attitude, t_ns: int) -> tuple[PilotState, Outputs]:
        """A reading that is not one of a sensor that is stuck."""
        kind = type(message).__name__
        heard, alerts = frozen.hear(state.inertial.get(kind, frozen.NOTHING_HEARD), message, t_ns)
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
            seen, alerts = lookout.at_ranges(state.lookout, message, self._estimator.anchors)
            state, outputs = replace(state, lookout=seen), [*outputs, *alerts]
        return replace(state, estimator=estimator), outputs

    def _battery(self, state: PilotState, message: Battery, t_ns: int) -> tuple[PilotState, Outputs]:
        nominal_v = self.settings.vessel.propulsion.nominal_voltage_V
        return replace(state, pack=pack.read(state.pack, message, nominal_v, self.settings.battery)), []

    def _heartbeat(self, state: PilotState, message: Heartbeat, t_ns: int) -> tuple[PilotState, Outputs]:
        known, events = vehicle.hear(state.vehicle, message)
        return steering.events(replace(state, vehicle=known), events, t_ns)

    def _rc(self, state: PilotState, message: RcChannels, t_ns: int) -> tuple[PilotState, Outputs]:
        heard, events = echo.at_rc(state.echo, message, self.channels, self.settings.system_id)
        return steering.events(replace(state, echo=heard), events, t_ns)

    def _servo(self, state: PilotState, message: ServoOutput, t_ns: int) -> tuple[PilotState, Outputs]:
        heard, alerts = echo.at_servo(state.echo, message, self._n)
        return replace(state, echo=heard), list(alerts)

    def _parameter(self, state: PilotState, message: ParamValue, t_ns: int) -> tuple[PilotState, Outputs]:
        return replace(state, echo=echo.at_parameter(state.echo, message, self.channels[: self._n])), []

    def _timesync(self, state: PilotState, message: TimeSync, t_ns: int) -> tuple[PilotState, Outputs]:
        return replace(state, round_trips=round_trip.hear(state.round_trips, message)), []

    def _link(self, state: PilotState, message: LinkStatus, t_ns: int) -> tuple[PilotState, Outputs]:
        level = "warning" if message.state in ("stale", "lost") else "info"
        text = f"{message.link}: {message.state}: {message.reason}"
        return state, [Alert(t_ns=t_ns, level=level, text=text)]

    def _operator(self, state: PilotState, message: OperatorCommand, t_ns: int) -> tuple[PilotState, Outputs]:
        if message.command == "excite" and self._flight is None:
            return state, [Alert(t_ns=t_ns, level="warning", text="no excitation to fly: name one in the run file")]
        why = f"{'stopped' if message.command == 'stop' else message.command} by the operator"
        return steering.event(state, message.command, why, t_ns)

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
        return replace(state, sticks=sticks.hear(state.sticks, message, t_ns, timeout_s)), []

    # --- a tick and its one lease ------------------------------------------------------------------

    def _tick(self, state: PilotState, tick: Tick, t_ns: int) -> tuple[PilotState, Outputs]:
        estimate = self._estimator.estimate(state.estimator, t_ns)
        state, outputs = self._judge(replace(state, estimate=estimate), tick, estimate, t_ns)
        if state.open_tick is not None:  # the shell was too busy to say so: its lease still comes first
            state, left = self._choose(state, t_ns, "no plan before the next tick")
            outputs += left
        state, more = self._drive(replace(state, open_tick=tick.index), estimate, t_ns)
        return state, [estimate, *outputs, *more]

    def _judge(self, state: PilotState, tick: Tick, estimate: StateEstimate, t_ns: int) -> tuple[PilotState, Outputs]:
        """Conditions through the mode table, and what is still asked of autopilot and sticks."""
        silence = vehicle.silence(state.vehicle, t_ns)
        seen, alerts = lookout.at_estimate(state.lookout, estimate)
        watched, conditions = watch.at_tick(
            state.watch, tick, estimate, seen, self._fence, state.pack, self.settings.control, state.plan_ns
        )
        heard, more, told = echo.at_tick(state.echo, t_ns, heard=silence is None)
        trips, late = round_trip.at_tick(state.round_trips, t_ns, heard=silence is None)
        conditions |= more | late
        if silence:
            conditions["link_lost"] = silence
        state = replace(state, lookout=seen, watch=watched, echo=heard, round_trips=trips)
        helm, judged = modes.look(state.helm, conditions, t_ns)
        state = steering.steered(state, helm, t_ns)
        outputs: Outputs = [*alerts, *told, *judged]
        if state.helm.mode == "manual" and (why := self._stick_trouble(state, t_ns)):
            state, more = steering.event(state, "sticks_lost", why, t_ns)
            return state, [*outputs, *more]
        if state.helm.mode not in ("starting", "locked"):
            return state, outputs
        missing = modes.waits_for(state.helm, conditions)
        if missing:
            return steering.waiting(state, missing), outputs
        known, requests, waiting = vehicle.prepare(state.vehicle, t_ns)
        state, outputs = replace(state, vehicle=known), [*outputs, *requests]
        if not waiting and state.helm.mode == "locked":
            waiting = self._stick_trouble(state, t_ns) or ""
        if waiting:
            return steering.waiting(state, waiting), outputs
        state, more = steering.event(state, "ready", "all is ready", t_ns)
        return state, [*outputs, *more]

    def _stick_trouble(self, state: PilotState, t_ns: int) -> str | None:
        return sticks.trouble(state.sticks, t_ns, self.settings.control.manual_timeout_s)

    def _drive(self, state: PilotState, estimate: StateEstimate, t_ns: int) -> tuple[PilotState, Outputs]:
        """What the thrusters of this mode do at this tick."""
        thrusters = THRUSTERS[state.helm.mode]
        if thrusters == "excitation" and self._flight:
            return self._excite(state, self._flight, estimate, t_ns)
        if thrusters == "sticks":
            return self._by_hand(state, t_ns)
        if thrusters != "controller" or state.open_tick is None:
            return self._choose(state, t_ns, "")
        eta, nu = _pose(estimate), _velocity(estimate)
        state = self._begin(state, eta, nu, t_ns)
        state, reference = self._guide(state, eta, nu, t_ns)
        assert state.open_tick is not None
        request = self._request(state, estimate, state.open_tick, t_ns)
        asked = (*state.asked, (state.open_tick, t_ns))[-REMEMBERED_TICKS:]
        return replace(state, asked=asked, row=request.reference[0]), [reference, request]

    def _by_hand(self, state: PilotState, t_ns: int) -> tuple[PilotState, Outputs]:
        """The sticks' forces, no faster than the thrusters may change."""
        last, propulsion = np.array(state.f_command_n), self.settings.vessel.propulsion
        most = propulsion.rate_limit_N_s * self.settings.control.period_s
        wanted = allocate(self._sticks.tau(state.sticks), self.settings.vessel)
        f = np.clip(np.clip(wanted, last - most, last + most), *self._limits)
        source = state.sticks.last.source if state.sticks.last else ""
        return self._lease(state, f, "manual", source, t_ns)

    def _begin(self, state: PilotState, eta, nu, t_ns: int) -> PilotState:
        """Start what is wanted, once driving is allowed; a mission goes on where it was left."""
        if state.guidance.phase != "idle":
            return state
        g, mission = self.settings.guidance, state.mission or self.settings.mission
        if state.helm.mode == "hold":
            return replace(state, guidance=guidance.hold(g, eta, nu, t_ns))
        passed = state.passed if len(state.passed) < len(mission.path.waypoints) else ()
        end = mission.end_heading_rad
        begun = guidance.start(mission.path, g, eta, nu, t_ns, end_heading_rad=end, passed=passed)
        return replace(state, guidance=begun)

    def _excite(
        self, state: PilotState, flight: Flight, estimate: StateEstimate, t_ns: int
    ) -> tuple[PilotState, Outputs]:
        """One tick of the excitation, and its lease; neutral when it is over."""
        eta, nu = np.array(_pose(estimate)), np.array(_velocity(estimate))
        spread_m = SPREAD_SIGMAS * math.sqrt(estimate.covariance[0] + estimate.covariance[7])
        at, f, note = flight.step(state.flight, eta, nu, t_ns, spread_m=spread_m)
        status = flight.status(at, t_ns)
        outputs: Outputs = [status]
        if note:
            level = "warning" if at.phase == "failed" else "info"
            outputs.append(Alert(t_ns=t_ns, level=level, text=note))
        state = replace(state, flight=at)
        if flight.is_over(at):
            state, more = steering.event(replace(state, flight=BEGINNING), "finished", note, t_ns)
            state, lease = self._choose(state, t_ns, "")
            outputs += more
        else:
            state, lease = self._lease(state, f, "excitation", f"{status.phase} {status.name}", t_ns)
        return state, [*outputs, *lease]

    def _guide(self, state: PilotState, eta, nu, t_ns: int) -> tuple[PilotState, GuidanceReference]:
        moved, reference = guidance.step(state.guidance, self.settings.guidance, eta, nu, t_ns)
        passed = moved.passed if state.helm.mode == "auto" else state.passed
        return replace(state, guidance=moved, passed=passed), reference

    def _request(self, state: PilotState, estimate: StateEstimate, index: int, t_ns: int) -> SolveRequest:
        x0 = self._ahead(state, t_ns)
        rows = guidance.horizon(state.guidance, self.settings.guidance, tuple(x0[:3]), tuple(x0[3:6]), self._times_s)
        return SolveRequest(
            t_ns=t_ns,
            index=index,
            x0=tuple(map(float, x0)),
            reference=tuple(tuple(map(float, row)) for row in rows),
            disturbance_n=estimate.disturbance_n,
            f_prev_n=state.f_command_n,
        )

    def _ahead(self, state: PilotState, t_ns: int) -> np.ndarray:
        """[x y psi u v r f] when a command sent now begins to act, under those already sent."""
        belief = self._estimator.belief(state.estimator, t_ns + self._ahead_ns)
        assert belief is not None  # a healthy estimate has one
        return np.concatenate([belief.x[:6], belief.f_n])

    def _planned(self, state: PilotState, plan: PlanResult, t_ns: int) -> tuple[PilotState, Outputs]:
        problem, asked_ns = _unsound(plan, self._n), dict(state.asked).get(plan.index)
        if problem is None and asked_ns is not None and (state.plan is None or asked_ns >= state.plan_ns):
            state = replace(state, plan=plan, plan_ns=asked_ns)
        if plan.index != state.open_tick:
            return state, []
        return self._choose(state, t_ns, problem or "")

    def _deadline(self, state: PilotState, late: PlanDeadline, t_ns: int) -> tuple[PilotState, Outputs]:
        if late.index != state.open_tick:
            return state, []
        return self._choose(state, t_ns, "no plan in time")

    def _choose(self, state: PilotState, t_ns: int, reason: str) -> tuple[PilotState, Outputs]:
        """The lease of the open tick: the highest rung that holds; neutral where the boat may not drive."""
        if THRUSTERS[state.helm.mode] != "controller":
            return self._lease(state, np.zeros(self._n), "neutral", state.helm.why, t_ns)
        age_s = (t_ns - state.plan_ns) * 1e-9
        f, source, why = command(
            state.plan,
            age_s,
            state.estimate,
            state.row,
            self.settings.vessel,
            step_s=self.settings.nmpc.step_s,
            settings=self._ladder,
        )
        return self._lease(state, f, source, "" if source == "plan" else f"{reason}; {why}", t_ns)

    def _lease(self, state: PilotState, f_n, source, reason: str, t_ns: int) -> tuple[PilotState, Outputs]:
        assert state.open_tick is not None
        f = tuple(map(float, f_n))
        lease = OverrideLease(
            t_ns=t_ns,
            index=state.open_tick,
            channels=self.channels,
            pwm_us=pulse_widths(np.array(f), self.settings.vessel, state.pack.voltage_v) + self._still,
            valid_for_s=self.settings.control.lease_s,
            source=source,
            reason=reason,
            f_command_n=f,
        )
        told = self._estimator.command(state.estimator, t_ns + self._latency_ns, f)
        seen, alerts = lookout.at_lease(state.lookout, lease)
        state = replace(state, estimator=told, f_command_n=f, open_tick=None, lookout=seen)
        return replace(state, echo=echo.at_lease(state.echo, lease)), [lease, *alerts]


_HANDLERS: dict[type[Message], Callable[..., tuple[PilotState, Outputs]]] = {
    ImuSample: Pilot._inertial,
    Attitude: Pilot._inertial,
    UwbRanges: Pilot._sense,
    UwbPosition: Pilot._sense,
    Battery: Pilot._battery,
    Heartbeat: Pilot._heartbeat,
    LinkStatus: Pilot._link,
    OperatorCommand: Pilot._operator,
    ManualInput: Pilot._sticks_moved,
    NewMission: Pilot._new_mission,
    RcChannels: Pilot._rc,
    ParamValue: Pilot._parameter,
    ServoOutput: Pilot._servo,
    TimeSync: Pilot._timesync,
    Tick: Pilot._tick,
    PlanResult: Pilot._planned,
    PlanDeadline: Pilot._deadline,
}


def _unsound(plan: PlanResult, n: int) -> str | None:
    """Why a plan cannot be used at all."""
    if plan.status != "ok":
        return f"plan {plan.status}: {plan.reason}"
    f = [value for row in plan.f_n for value in row]
    if not plan.f_n or any(len(row) != n for row in plan.f_n) or not np.isfinite(f).all():
        return f"plan {plan.index} is not sound: expected rows of {n} finite forces"
    return None


def _pose(estimate: StateEstimate) -> tuple[float, float, float]:
    return estimate.north_m, estimate.east_m, estimate.psi_rad


def _velocity(estimate: StateEstimate) -> tuple[float, float, float]:
    return estimate.u_m_s, estimate.v_m_s, estimate.r_rad_s
