"""Thruster commands of a tick, and the one lease in which it ends.

    controller                    guidance and a SolveRequest; the lease follows
    sticks, excitation, neutral   the lease at once
    PlanResult                    lease from the plan, if its tick is still open and it can be meant (`plan_check`)
    PlanDeadline                  lease from the fallback ladder, if its tick is still open

The state predicted to when a command acts (dead time ahead, under the commands already sent) is what the NMPC plans
from.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from companion.core.constants import NEUTRAL_US
from companion.core.control.fallback import FallbackSettings, command
from companion.core.estimation.estimator import Estimator
from companion.core.excitation.flight import BEGINNING, Flight
from companion.core.guidance import guidance
from companion.core.guidance.steerage import corner_problems
from companion.core.messages import (
    Alert,
    GuidanceReference,
    OverrideLease,
    PlanDeadline,
    PlanResult,
    SolveRequest,
    StateEstimate,
)
from companion.core.model.actuators.propulsion import channels_of, control_limits
from companion.core.pilot import manual_control, transitions
from companion.core.pilot.manual_control import Sticks
from companion.core.pilot.modes import THRUSTERS
from companion.core.pilot.monitors.battery import BatteryState
from companion.core.pilot.monitors.table import MonitorTable
from companion.core.pilot.plan_check import PlanCheck
from companion.core.pilot.state import Outputs, PilotSettings, PilotState
from companion.core.pilot.trust.thrusters.remaining_thrust import RemainingThrust
from companion.core.pilot.trust.thrusters.thruster_verdict import ThrusterState

SPREAD_SIGMAS = 2.0
"""An excitation stays so many sigmas of its position farther from the fence; assumed."""
DRIFTS = "this boat cannot keep station: its thrust is off and it drifts"
REMEMBERED_TICKS = 20
"""Latest requests whose plans are still taken: twice what the oldest usable plan needs at 10 Hz; assumed."""


class ThrustCommander:
    """Settings, estimator and what is compiled for them; all that changes is in PilotState."""

    def __init__(
        self, settings: PilotSettings, estimator: Estimator, channels: tuple[int, ...], monitors: MonitorTable
    ):
        self.settings, self._estimator, self._channels, self._monitors = settings, estimator, channels, monitors
        vessel = settings.vessel
        self._n = len(vessel.controls)
        self._still = (NEUTRAL_US,) * (len(channels) - self._n)
        self._flight = settings.flight()
        self._sticks, self._limits = manual_control.StickForce(vessel), control_limits(vessel)
        self._latency_ns = round(settings.control.latency_s * 1e9)
        self._ahead_ns = self._latency_ns + round(max(c.dead_time_s for c in channels_of(vessel)) * 1e9)
        self._remaining = RemainingThrust(vessel)
        self._ladder = FallbackSettings(plan_age_s=settings.control.plan_deadline_s)
        self._check = PlanCheck(vessel, step_s=settings.nmpc.step_s, period_s=settings.control.period_s)
        self._times_s = [k * settings.nmpc.step_s for k in range(settings.nmpc.stages + 1)]

    def drive(self, state: PilotState, estimate: StateEstimate, t_ns: int) -> tuple[PilotState, Outputs]:
        """The tick of a mode: a lease at once, or a request to the controller."""
        thrusters = THRUSTERS[state.helm.mode]
        if thrusters == "excitation" and self._flight:
            return self._excite(state, self._flight, estimate, t_ns)
        if thrusters == "sticks":
            return self._by_hand(state, t_ns)
        if thrusters != "controller" or state.open_tick is None:
            return self.choose(state, t_ns, "")
        eta, nu, drifted = _pose(estimate), _velocity(estimate), self._drifts(state)
        idle, state = state.guidance.phase == "idle", self._begin(state, eta, nu, t_ns)
        sharp = self._sharp_corners(state) if idle else []
        state, reference = self._guide(state, eta, nu, t_ns)
        assert state.open_tick is not None
        request = self._request(state, estimate, state.open_tick, t_ns)
        asked = (*state.asked, (state.open_tick, t_ns))[-REMEMBERED_TICKS:]
        begins = self._drifts(state) and not drifted
        alerts = [Alert(t_ns=t_ns, level="warning", text=text) for text in [*sharp, *[DRIFTS] * begins]]
        return replace(state, asked=asked, row=request.reference[0]), [reference, request, *alerts]

    def _sharp_corners(self, state: PilotState) -> list[str]:
        """Corners of the way from where the boat is that it cannot round: those of the mission itself are refused."""
        route, first = state.guidance.route, len(state.guidance.passed) - 1
        problems = corner_problems(route, self.settings.guidance, first) if route else []
        return [f"on the way from here, {problem}; it will swing wide: start from farther away" for problem in problems]

    def _drifts(self, state: PilotState) -> bool:
        """Whether station should be kept by a boat that cannot: its thrust is off."""
        return self.settings.guidance.end == "drift" and state.guidance.phase in ("station", "done")

    def _by_hand(self, state: PilotState, t_ns: int) -> tuple[PilotState, Outputs]:
        """Forces of the sticks; the thrusters' rate limit comes after what is lost of them (`_with_what_is_left`)."""
        sticks = state.monitor(Sticks)
        wanted = self._sticks.commands(sticks, np.array(state.f_command_n), self.settings.control.period_s)
        f = np.clip(wanted, *self._limits)
        source = sticks.last.source if sticks.last else ""
        return self._lease(state, f, "manual", source, t_ns)

    def _begin(self, state: PilotState, eta, nu, t_ns: int) -> PilotState:
        """Guidance begins: to keep station or to follow the mission, which goes on where it was left."""
        if state.guidance.phase != "idle":
            return state
        g, mission = self.settings.guidance, state.mission or self.settings.mission
        if state.helm.mode == "hold":
            held = guidance.hold(g, eta, nu, t_ns, passed=state.passed, is_clear=self._is_clear)
            return replace(state, guidance=held)
        passed = state.passed if len(state.passed) < len(mission.path.waypoints) else ()
        end = mission.end_heading_rad
        begun = guidance.start(mission.path, g, eta, nu, t_ns, end_heading_rad=end, passed=passed)
        return replace(state, guidance=begun)

    def _is_clear(self, north_m: float, east_m: float) -> bool:
        """Whether station can be kept at a place as far as fences go."""
        return self.settings.fence.clearance(north_m, east_m) >= self.settings.nmpc.fence_margin_m

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
            state, more = transitions.event(replace(state, flight=BEGINNING), "finished", note, t_ns)
            state, lease = self.choose(state, t_ns, "")
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

    def planned(self, state: PilotState, plan: PlanResult, t_ns: int) -> tuple[PilotState, Outputs]:
        """A plan arrives: kept if it can be meant, and the open tick's lease if it answers that tick."""
        proposals, problem, trusted = self._check.judge(state.proposals, plan)
        state, asked_ns = replace(state, proposals=proposals), dict(state.asked).get(plan.index)
        state = state if trusted else replace(state, plan=None)
        if problem is None and asked_ns is not None and (state.plan is None or asked_ns >= state.plan_ns):
            state = replace(state, plan=plan, plan_ns=asked_ns)
        if plan.index != state.open_tick:
            return state, []
        return self.choose(state, t_ns, problem or "plan late")

    def deadline(self, state: PilotState, late: PlanDeadline, t_ns: int) -> tuple[PilotState, Outputs]:
        """The plan of the open tick did not come in time."""
        if late.index != state.open_tick:
            return state, []
        return self.choose(state, t_ns, "no plan in time")

    def choose(self, state: PilotState, t_ns: int, reason: str) -> tuple[PilotState, Outputs]:
        """The lease of the open tick: the highest rung that holds, within the thrusters' rate limit; neutral where the
        boat may not drive. `reason`: why no plan of this tick is used, told where none is.
        """
        if THRUSTERS[state.helm.mode] != "controller":
            return self._lease(state, np.zeros(self._n), "neutral", state.helm.why, t_ns)
        if self._drifts(state):
            return self._lease(state, np.zeros(self._n), "neutral", DRIFTS, t_ns)
        age_s = (t_ns - state.plan_ns) * 1e-9
        f, source, why = command(
            state.plan,
            age_s,
            state.estimate,
            state.row,
            self.settings.vessel,
            step_s=self.settings.nmpc.step_s,
            settings=self._ladder,
            now=state.f_command_n,
            within_s=self.settings.control.period_s,
        )
        return self._lease(state, f, source, "" if source == "plan" else f"{reason}; {why}", t_ns)

    def _with_what_is_left(
        self, state: PilotState, f_n: np.ndarray, source: str, t_ns: int
    ) -> tuple[np.ndarray, tuple[int, ...]]:
        """Forces that come for those wanted, and their pulse widths; neutral stays neutral, and so do sticks at rest:
        who has let go of them is not asked for a probe, nor to hold against a thruster that is stuck.
        """
        thrusters, voltage_v = state.monitor(ThrusterState), state.monitor(BatteryState).voltage_v
        if source != "neutral" and not (source == "manual" and not f_n.any()):
            if thrusters.probing:
                f_n = np.clip(f_n + self._remaining.probe(t_ns), *self._limits)
            f_n = self._remaining.redistribute(f_n, thrusters.health)
        if source in ("plan", "shifted_plan", "pd", "manual"):
            f_n = self._check.within_rate(self._acting(state, t_ns), f_n)
        return f_n, self._remaining.pulses(f_n, thrusters.health, voltage_v)

    def _acting(self, state: PilotState, t_ns: int) -> np.ndarray:
        """Forces commanded until now [N]; none where the last lease is over, for then neutral was sent."""
        over = state.lease_end_ns is not None and state.lease_end_ns < t_ns
        return np.zeros(self._n) if over else np.array(state.f_command_n)

    def _lease(self, state: PilotState, f_n, source, reason: str, t_ns: int) -> tuple[PilotState, Outputs]:
        assert state.open_tick is not None
        f_n, widths = self._with_what_is_left(state, np.asarray(f_n, dtype=float), source, t_ns)
        f = tuple(map(float, f_n))
        lease = OverrideLease(
            t_ns=t_ns,
            index=state.open_tick,
            channels=self._channels,
            pwm_us=widths + self._still,
            valid_for_s=self.settings.control.lease_s,
            source=source,
            reason=reason,
            f_command_n=f,
        )
        estimator, over_ns = state.estimator, state.lease_end_ns
        if over_ns is not None and over_ns < t_ns:  # nobody kept the thrusters turning since
            estimator = self._estimator.command(estimator, over_ns + self._latency_ns, (0.0,) * self._n)
        estimator = self._estimator.command(estimator, t_ns + self._latency_ns, f)
        state = replace(
            state,
            estimator=estimator,
            f_command_n=f,
            open_tick=None,
            lease_end_ns=t_ns + round(lease.valid_for_s * 1e9),
        )
        state, alerts, _ = self._monitors.screen(state, lease, t_ns)
        state, more = self._monitors.hear(state, lease, t_ns)
        return state, [lease, *alerts, *more]


def _pose(estimate: StateEstimate) -> tuple[float, float, float]:
    return estimate.north_m, estimate.east_m, estimate.psi_rad


def _velocity(estimate: StateEstimate) -> tuple[float, float, float]:
    return estimate.u_m_s, estimate.v_m_s, estimate.r_rad_s
