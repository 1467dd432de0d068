"""What the monitors of sensors say together: what was found, and whether to blame a thruster at all."""

from __future__ import annotations

from companion.core.estimation.filter_state import FilterState
from companion.core.pilot.state import PilotState
from companion.core.pilot.trust.sensors.accelerometer_check import AccelerometerState
from companion.core.pilot.trust.sensors.heading_check import HeadingState
from companion.core.pilot.trust.sensors.motion_check import MotionState
from companion.core.pilot.trust.sensors.path_check import PathState
from companion.core.pilot.trust.verdict import Finding

DISPLACED_NS = 10_000_000_000
"""After positions have moved the boat against its motion, its speed is believed again; assumed."""


def findings(state: PilotState) -> tuple[Finding, ...]:
    """What was found of the sensors."""
    monitors = AccelerometerState, HeadingState, MotionState, PathState
    return tuple(finding for kind in monitors for finding in state.monitor(kind).findings)


def is_suspect(state: PilotState, belief: FilterState | None) -> bool:
    """Whether sensors contradict each other, perhaps: what a thruster would be blamed for may be theirs."""
    if belief is not None and belief.displaced_ns and belief.t_ns - belief.displaced_ns < DISPLACED_NS:
        return True
    monitors = HeadingState, MotionState, PathState
    return bool(state.monitor(AccelerometerState).findings) or any(state.monitor(m).is_suspect for m in monitors)
