"""Every message that flows through the boat: frozen, stamped, with the unit in the name.

A message is a value. `t_ns` is the instant it speaks of, on the companion's monotonic clock [ns];
sensor messages add `t_rx_ns`, the instant its last byte arrived. Messages are msgspec structs, so the
recorder writes them as JSON with a schema made from the very same class and the replay reads them back
bit for bit (floats are written in shortest round-trip form). A missing number is None, never NaN.

Frames: NED for positions and headings, body (x forward, y starboard, z down) for velocities and forces.

`sensors` holds what comes over the wires, `control` what the program itself says; this page has all of them.
"""

from __future__ import annotations

from companion.core.messages.control import (
    Alert,
    ExcitationStatus,
    GroundTruth,
    GuidanceReference,
    Health,
    Innovation,
    InterlockTrip,
    LoopTiming,
    ManualInput,
    MissionPoint,
    Mode,
    ModeStatus,
    NewMission,
    OperatorCommand,
    OverrideLease,
    PlanDeadline,
    PlanResult,
    ProcessStats,
    SolveRequest,
    StateEstimate,
    StepMark,
    Tick,
    VehicleRequest,
)
from companion.core.messages.sensors import (
    HELD_PORT,
    MEASUREMENTS,
    AnchorRange,
    Attitude,
    AutopilotInfo,
    Battery,
    CommandAck,
    Heartbeat,
    ImuSample,
    LinkState,
    LinkStatus,
    Measured,
    Message,
    MotorOutputs,
    ParamValue,
    RcChannels,
    ServoOutput,
    StatusText,
    TimeSync,
    UwbPosition,
    UwbRanges,
    Vec,
)

__all__ = [
    "HELD_PORT", "INPUTS", "MEASUREMENTS", "NOTES", "OUTPUTS", "Alert", "AnchorRange", "Attitude", "AutopilotInfo",
    "Battery", "CommandAck", "ExcitationStatus", "GroundTruth", "GuidanceReference", "Health", "Heartbeat", "ImuSample",
    "Innovation", "InterlockTrip", "LinkState", "LinkStatus", "LoopTiming", "ManualInput", "Measured", "Message",
    "MissionPoint", "Mode", "ModeStatus", "MotorOutputs", "NewMission", "OperatorCommand", "OverrideLease",
    "ParamValue",
    "PlanDeadline", "PlanResult", "ProcessStats", "RcChannels", "ServoOutput", "SolveRequest", "StateEstimate",
    "StatusText", "StepMark", "Tick", "TimeSync", "UwbPosition", "UwbRanges", "Vec", "VehicleRequest", "topic",
]  # fmt: skip

INPUTS: tuple[type[Message], ...] = (
    *MEASUREMENTS, Heartbeat, Battery, ServoOutput, MotorOutputs, RcChannels,
    CommandAck, ParamValue, TimeSync, StatusText, AutopilotInfo, LinkStatus, Tick, PlanDeadline, OperatorCommand,
    InterlockTrip, ManualInput, NewMission, PlanResult,
)  # fmt: skip
OUTPUTS: tuple[type[Message], ...] = (
    StateEstimate, Innovation, GuidanceReference, ExcitationStatus, SolveRequest, OverrideLease, VehicleRequest,
    ModeStatus, Alert,
)  # fmt: skip
NOTES: tuple[type[Message], ...] = (StepMark, LoopTiming, ProcessStats, GroundTruth)


def topic(kind: type[Message]) -> str:
    """Topic of a message class in logs and telemetry: `/imu_sample` for ImuSample."""
    name = kind.__name__
    return "/" + "".join(("_" if c.isupper() and i else "") + c.lower() for i, c in enumerate(name))
