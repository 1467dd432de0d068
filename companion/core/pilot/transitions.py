"""Events of the mode table (`modes`), what a change of mode resets in the pilot's state, and the ModeStatus."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from companion.core.guidance import guidance
from companion.core.messages import ModeStatus
from companion.core.pilot import manual_control, modes
from companion.core.pilot.manual_control import Sticks
from companion.core.pilot.modes import THRUSTERS, Event, ModeState
from companion.core.pilot.monitors.plan_gap import ControllerTime
from companion.core.pilot.plan_check import NO_PROPOSALS
from companion.core.pilot.state import Outputs, PilotState

STATUS_PERIOD_NS = 1_000_000_000
"""A ModeStatus at least so often."""


def event(state: PilotState, name: Event, why: str, t_ns: int) -> tuple[PilotState, Outputs]:
    """One event through the mode table."""
    helm, alerts = modes.apply_event(state.helm, name, why, t_ns)
    return apply_mode_state(state, helm, t_ns), list(alerts)


def events(state: PilotState, reasons: Mapping[Event, str], t_ns: int) -> tuple[PilotState, Outputs]:
    """Several events with their reasons, one after the other."""
    outputs: Outputs = []
    for name, why in reasons.items():
        state, more = event(state, name, why, t_ns)
        outputs += more
    return state, outputs


def apply_mode_state(state: PilotState, helm: ModeState, t_ns: int) -> PilotState:
    """A new mode starts afresh; only between two modes of the controller is the plan kept."""
    before, now = state.helm.mode, helm.mode
    state = replace(state, helm=helm)
    if now == before:
        return state
    state = replace(state, guidance=guidance.IDLE)
    if now == "locked":
        state = state.with_monitors(manual_control.locked(state.monitor(Sticks)))
    controlled = THRUSTERS[now] == "controller"
    if controlled and THRUSTERS[before] == "controller":
        return state
    state = state.with_monitors(ControllerTime(since_ns=t_ns if controlled else None))
    return replace(state, plan=None, asked=(), proposals=NO_PROPOSALS)


def waiting(state: PilotState, why: str) -> PilotState:
    """With the reason for which `starting` or `locked` waits."""
    return replace(state, helm=replace(state.helm, why=why))


def mode_status(state: PilotState, t_ns: int, *, tick: bool) -> tuple[PilotState, Outputs]:
    """A ModeStatus where the mode has changed, or at a tick, once `STATUS_PERIOD_NS` has passed since the last."""
    helm, (mode, last_ns) = state.helm, state.last_status
    due = tick and (last_ns is None or t_ns - last_ns >= STATUS_PERIOD_NS)
    if mode == helm.mode and not due:
        return state, []
    status = ModeStatus(t_ns=t_ns, mode=helm.mode, why=helm.why, driving=helm.driving)
    return replace(state, last_status=(helm.mode, t_ns)), [status]
