"""What the monitors of sensors say together: what was found, and whether to blame a thruster at all."""

from __future__ import annotations

from companion.core.pilot.state import PilotState
from companion.core.pilot.trust.sensors.accelerometer_check import AccelerometerState
from companion.core.pilot.trust.sensors.heading_check import HeadingState
from companion.core.pilot.trust.sensors.motion_check import MotionState
from companion.core.pilot.trust.sensors.path_check import PathState
from companion.core.pilot.trust.verdict import Finding


def findings(state: PilotState) -> tuple[Finding, ...]:
    """What was found of the sensors."""
    monitors = AccelerometerState, HeadingState, MotionState, PathState
    return tuple(finding for kind in monitors for finding in state.monitor(kind).findings)


def is_suspect(state: PilotState) -> bool:
    """Whether sensors contradict each other, perhaps: what a thruster would be blamed for may be theirs."""
    monitors = HeadingState, MotionState, PathState
    return bool(state.monitor(AccelerometerState).findings) or any(state.monitor(m).is_suspect for m in monitors)
