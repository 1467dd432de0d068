"""The boat's mind, pure: `step(state, inputs, t) -> (state, outputs)`. It composes the other rooms.

    sensors            -> estimator
    Tick               -> estimate, vehicle phase, guidance, SolveRequest; neutral where not driving;
                          or, while an excitation is flown, its lease at once, without guidance and NMPC
    PlanResult         -> lease from the plan, if its tick is still open and the plan is sound
    PlanDeadline       -> lease from the fallback ladder, if its tick is still open

Every tick ends in exactly one OverrideLease. The state predicted to when a command acts (dead time ahead,
under the commands already sent) is what the NMPC plans from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from msgspec.structs import replace as struct_replace

from companion.core import guidance, lookout, vehicle
from companion.core.allocation import pulse_widths
from companion.core.estimator import Estimator, EstimatorState
from companion.core.excitation.file import Excitation
from companion.core.excitation.flight import BEGINNING, Flight, FlightState
from companion.core.fallback import FallbackSettings, command
from companion.core.frames import ssa
from companion.core.guidance import GuidanceSettings, GuidanceState
from companion.core.lookout import Lookout
from companion.core.messages import (
    Alert,
    Attitude,
    Battery,
    GuidanceReference,
    Heartbeat,
    ImuSample,
    LinkStatus,
    Message,
    OperatorCommand,
    OverrideLease,
    PlanDeadline,
    PlanResult,
    SolveRequest,
    StateEstimate,
    Tick,
    UwbPosition,
    UwbRanges,
)
from companion.core.mission import Mission
from companion.core.nmpc import NmpcSettings
from companion.core.run_file import Control
from companion.core.site import Site
from companion.core.thrusters import NEUTRAL_US
from companion.core.vehicle import Vehicle
from companion.core.vessel_file import VesselFile

VOLTAGE_SHARE = 0.2
"""Weight of a new voltage reading against the old mean: load spikes should not shake the thrust; assumed."""
VOLTAGE_RANGE = (0.5, 1.5)
"""Readings outside these shares of the nominal voltage are no pack's (0 V: no battery monitor); assumed."""
SPREAD_SIGMAS = 2.0
"""An excitation stays so many sigmas of its position farther from the fence; assumed."""
REMEMBERED_TICKS = 20
"""Requests whose plans are still welcome, by tick: twice what the oldest usable plan needs at 10 Hz; assumed."""

NOTHING_SEEN = Lookout()

Wanted = Literal["mission", "hold", "excitation"]
_WANTED: dict[str, Wanted] = {"start": "mission", "hold": "hold", "excite": "excitation"}


@dataclass(frozen=True)
class PilotSettings:
    """Everything that a run is configured with."""

    vessel: VesselFile
    site: Site
    mission: Mission
    control: Control = field(default_factory=Control)
    guidance: GuidanceSettings = field(default_factory=GuidanceSettings)
    nmpc: NmpcSettings = field(default_factory=NmpcSettings)
    excitation: Excitation | None = None
    """Flown on the operator's `excite`."""


@dataclass(frozen=True)
class PilotState:
    """Everything the boat remembers between steps."""

    estimator: EstimatorState
    voltage_v: float
    f_command_n: tuple[float, ...]
    vehicle: Vehicle = vehicle.STOPPED
    guidance: GuidanceState = guidance.IDLE
    wanted: Wanted = "mission"
    flight: FlightState = BEGINNING
    passed: tuple[guidance.Passage, ...] = ()
    lookout: Lookout = NOTHING_SEEN
    open_tick: int | None = None
    asked: tuple[tuple[int, int], ...] = ()
    """Tick and instant [ns] of the latest SolveRequests."""
    estimate: StateEstimate | None = None
    row: tuple[float, ...] | None = None
    plan: PlanResult | None = None
    plan_ns: int = 0


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
        self._latency_ns = round(settings.control.latency_s * 1e9)
        self._ahead_ns = self._latency_ns + round(vessel.propulsion.dead_time_s * 1e9)
        self._ladder = FallbackSettings(plan_age_s=settings.control.plan_deadline_s)
        self._times_s = [k * settings.nmpc.step_s for k in range(settings.nmpc.stages + 1)]

    def initial(self, t_ns: int) -> PilotState:
        """State at switch-on: nothing known, thrusters at rest."""
        vessel = self.settings.vessel
        return PilotState(
            estimator=self._estimator.initial(),
            voltage_v=vessel.propulsion.nominal_voltage_V,
            f_command_n=(0.0,) * len(vessel.thrusters),
        )

    def step(self, state: PilotState, inputs: Sequence[Message], t_ns: int) -> tuple[PilotState, Outputs]:
        """Take `inputs` in order at `t_ns` [ns]; what is to be done, said or logged."""
        outputs: Outputs = []
        for message in inputs:
            if handle := _HANDLERS.get(type(message)):
                state, more = handle(self, state, message, t_ns)
                outputs += more
        return state, outputs

    # --- what comes in -----------------------------------------------------------------------------

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
        low, high = (share * self.settings.vessel.propulsion.nominal_voltage_V for share in VOLTAGE_RANGE)
        if not low <= message.voltage_v <= high:
            return state, []
        mean = state.voltage_v + VOLTAGE_SHARE * (message.voltage_v - state.voltage_v)
        return replace(state, voltage_v=mean), []

    def _heartbeat(self, state: PilotState, message: Heartbeat, t_ns: int) -> tuple[PilotState, Outputs]:
        known, alerts = vehicle.hear(state.vehicle, message, t_ns)
        return replace(state, vehicle=known), alerts

    def _link(self, state: PilotState, message: LinkStatus, t_ns: int) -> tuple[PilotState, Outputs]:
        level = "warning" if message.state in ("stale", "lost") else "info"
        text = f"{message.link}: {message.state}: {message.reason}"
        return state, [Alert(t_ns=t_ns, level=level, text=text)]

    def _operator(self, state: PilotState, message: OperatorCommand, t_ns: int) -> tuple[PilotState, Outputs]:
        if message.command == "stop":
            stopped = replace(state.vehicle, phase="stopped", why="stopped by the operator")
            return replace(state, vehicle=stopped, guidance=guidance.IDLE, plan=None, asked=()), []
        if message.command == "excite" and self._flight is None:
            return state, [Alert(t_ns=t_ns, level="warning", text="no excitation to fly: name one in the run file")]
        wanted: Wanted = _WANTED[message.command]
        if state.vehicle.phase == "driving":
            if wanted == state.wanted:
                return state, []
            return replace(state, wanted=wanted, guidance=guidance.IDLE), []
        waiting = replace(state.vehicle, phase="waiting")
        return replace(state, vehicle=waiting, wanted=wanted, guidance=guidance.IDLE), []

    # --- a tick and its one lease ------------------------------------------------------------------

    def _tick(self, state: PilotState, tick: Tick, t_ns: int) -> tuple[PilotState, Outputs]:
        estimate = self._estimator.estimate(state.estimator, t_ns)
        seen, alerts = lookout.at_estimate(state.lookout, estimate)
        unfit = _unfit(estimate) or lookout.blind(seen, t_ns, self.settings.control.blind_s)
        known, more = vehicle.advance(state.vehicle, t_ns, unfit=unfit)
        state = replace(state, estimate=estimate, vehicle=known, lookout=seen)
        outputs: Outputs = [estimate, *alerts, *more]
        if state.open_tick is not None:  # the shell was too busy to say so: its lease still comes first
            state, left = self._choose(state, t_ns, "no plan before the next tick")
            outputs += left
        if known.phase != "driving":
            state = replace(state, guidance=guidance.IDLE, plan=None, asked=(), open_tick=tick.index)
            state, lease = self._choose(state, t_ns, "")
            return state, [*outputs, *lease]
        if state.wanted == "excitation" and self._flight:
            state, flown = self._excite(replace(state, open_tick=tick.index), self._flight, estimate, t_ns)
            return state, [*outputs, *flown]
        eta, nu = _pose(estimate), _velocity(estimate)
        state = self._begin(state, eta, nu, t_ns)
        state, reference = self._guide(state, eta, nu, t_ns)
        request = self._request(state, estimate, tick.index, t_ns)
        asked = (*state.asked, (tick.index, t_ns))[-REMEMBERED_TICKS:]
        state = replace(state, open_tick=tick.index, asked=asked, row=request.reference[0])
        return state, [*outputs, reference, request]

    def _begin(self, state: PilotState, eta, nu, t_ns: int) -> PilotState:
        """Start what is wanted, once driving is allowed; a mission goes on where it was left."""
        if state.guidance.phase != "idle":
            return state
        g, mission = self.settings.guidance, self.settings.mission
        if state.wanted == "hold":
            return replace(state, guidance=guidance.hold(g, eta, nu, t_ns))
        passed = state.passed if len(state.passed) < len(mission.path.waypoints) else ()
        end = mission.end_heading_rad
        begun = guidance.start(mission.path, g, eta, nu, t_ns, end_heading_rad=end, passed=passed)
        return replace(state, guidance=begun)

    def _excite(
        self, state: PilotState, flight: Flight, estimate: StateEstimate, t_ns: int
    ) -> tuple[PilotState, Outputs]:
        """One tick of the excitation, and its lease; neutral while the estimate is not healthy, and when it is over."""
        state = replace(state, guidance=guidance.IDLE, plan=None, asked=())
        if estimate.health != "healthy":  # it finds back to the middle afterwards, as after every break
            return self._lease(state, np.zeros(self._n), "neutral", f"estimate {estimate.health}", t_ns)
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
            stopped = replace(state.vehicle, phase="stopped", why=note)
            state, lease = self._choose(replace(state, vehicle=stopped, flight=BEGINNING), t_ns, "")
        else:
            state, lease = self._lease(state, f, "excitation", f"{status.phase} {status.name}", t_ns)
        return state, [*outputs, *lease]

    def _guide(self, state: PilotState, eta, nu, t_ns: int) -> tuple[PilotState, GuidanceReference]:
        moved, reference = guidance.step(state.guidance, self.settings.guidance, eta, nu, t_ns)
        passed = moved.passed if state.wanted == "mission" else state.passed
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
        if state.vehicle.phase != "driving":
            why = state.vehicle.why or state.vehicle.phase
            return self._lease(state, np.zeros(self._n), "neutral", why, t_ns)
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
            pwm_us=pulse_widths(np.array(f), self.settings.vessel, state.voltage_v) + self._still,
            valid_for_s=self.settings.control.lease_s,
            source=source,
            reason=reason,
            f_command_n=f,
        )
        told = self._estimator.command(state.estimator, t_ns + self._latency_ns, f)
        seen, alerts = lookout.at_lease(state.lookout, lease)
        return replace(state, estimator=told, f_command_n=f, open_tick=None, lookout=seen), [lease, *alerts]


_HANDLERS: dict[type[Message], Callable[..., tuple[PilotState, Outputs]]] = {
    ImuSample: Pilot._sense,
    Attitude: Pilot._sense,
    UwbRanges: Pilot._sense,
    UwbPosition: Pilot._sense,
    Battery: Pilot._battery,
    Heartbeat: Pilot._heartbeat,
    LinkStatus: Pilot._link,
    OperatorCommand: Pilot._operator,
    Tick: Pilot._tick,
    PlanResult: Pilot._planned,
    PlanDeadline: Pilot._deadline,
}


def _unfit(estimate: StateEstimate) -> str | None:
    if estimate.health in ("healthy", "degraded"):
        return None
    return f"state estimate {estimate.health}: {estimate.reason}"


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
