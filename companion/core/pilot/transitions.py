"""Events of the mode table (`modes`) as they change what the pilot remembers, and the mode as it is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from companion.core.guidance import guidance
from companion.core.messages import ModeStatus
from companion.core.pilot import manual_control, modes
from companion.core.pilot.modes import THRUSTERS, Event, ModeState
from companion.core.pilot.state import Outputs, PilotState

STATUS_PERIOD_NS = 1_000_000_000
"""A ModeStatus at least so often."""


def event(state: PilotState, name: Event, why: str, t_ns: int) -> tuple[PilotState, Outputs]:
    """One event through the mode table."""
    helm, alerts = modes.apply_event(state.helm, name, why, t_ns)
    return apply_mode_state(state, helm, t_ns), list(alerts)


def events(state: PilotState, found: Sequence[tuple[Event, str]], t_ns: int) -> tuple[PilotState, Outputs]:
    """Several, one after the other."""
    outputs: Outputs = []
    for name, why in found:
        state, more = event(state, name, why, t_ns)
        outputs += more
    return state, outputs


def apply_mode_state(state: PilotState, helm: ModeState, t_ns: int) -> PilotState:
    """Another mode begins with nothing of the one before but the plan between two modes of the controller."""
    before, now = state.helm.mode, helm.mode
    state = replace(state, helm=helm)
    if now == before:
        return state
    state = replace(state, guidance=guidance.IDLE)
    if now == "locked":
        state = replace(state, sticks=manual_control.locked(state.sticks))
    controlled = THRUSTERS[now] == "controller"
    if controlled and THRUSTERS[before] == "controller":
        return state
    watched = replace(state.watch, since_ns=t_ns if controlled else None)
    return replace(state, watch=watched, plan=None, asked=())


def waiting(state: PilotState, why: str) -> PilotState:
    """What `starting` and `locked` wait for, in words."""
    return replace(state, helm=replace(state.helm, why=why))


def mode_status(state: PilotState, t_ns: int, *, tick: bool) -> tuple[PilotState, Outputs]:
    """A ModeStatus where the mode is not the one last told, or at a tick, where that was a second ago."""
    helm, (mode, last_ns) = state.helm, state.told
    due = tick and (last_ns is None or t_ns - last_ns >= STATUS_PERIOD_NS)
    if mode == helm.mode and not due:
        return state, []
    status = ModeStatus(t_ns=t_ns, mode=helm.mode, why=helm.why, driving=helm.driving)
    return replace(state, told=(helm.mode, t_ns)), [status]
