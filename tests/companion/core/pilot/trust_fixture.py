"""Monitors' states of a boat that is contradicted, or crippled."""

from __future__ import annotations

from msgspec.structs import replace

from companion.core.pilot.state import PilotState
from companion.core.pilot.trust.sensors.motion_check import MotionState
from companion.core.pilot.trust.thrusters.thruster_verdict import ThrusterState
from companion.core.pilot.trust.verdict import Finding


def in_trouble(state: PilotState, condition: str, t_ns: int) -> MotionState | ThrusterState:
    """The state of the monitor that reports this condition."""
    if condition == "crippled":
        return replace(state.monitor(ThrusterState), hopeless="a thruster is stuck")
    finding = Finding("sensor", "position", "ranges contradict the motion", t_ns)
    return replace(state.monitor(MotionState), findings=(finding,))
