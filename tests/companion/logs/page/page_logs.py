"""Logs that a page can be made of: those of the stepped simulation, with what the shell notes beside."""

from pathlib import Path

from companion.core.messages import GroundTruth, LoopTiming, Message, OverrideLease
from tests.companion.logs.readers.run_logs import record, simulated


def driven() -> list[Message]:
    """15 s of a boat that is pushed about (seed 3), with a LoopTiming after every lease."""
    out: list[Message] = []
    for message in simulated():
        if isinstance(message, GroundTruth):
            continue
        out.append(message)
        if isinstance(message, OverrideLease):
            timing = LoopTiming(t_ns=message.t_ns, index=message.index, lateness_ms=0.2, imu_to_override_ms=9.0)
            out.append(timing)
    return out


def page_log(folder: Path) -> Path:
    """That log on disk."""
    return record(folder / "boat.mcap", driven())
