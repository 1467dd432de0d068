"""What a demo run was like, in figures: from the companion's log and the simulator's truth, nothing else."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.messages import (
    GroundTruth,
    GuidanceReference,
    LoopTiming,
    Message,
    ModeStatus,
    OverrideLease,
    PlanResult,
    ProcessStats,
    StateEstimate,
    Tick,
    UwbRanges,
)
from companion.core.pilot.pilot import PilotSettings
from companion.logs.log_file import LogFile
from sim.world.score import TrueTrack, end_heading, estimation, station, track_of, tracking

KINDS = (
    GuidanceReference, LoopTiming, ModeStatus, OverrideLease, PlanResult, ProcessStats, StateEstimate, Tick, UwbRanges,
)  # fmt: skip
STOPPED = "stopped: "
"""What a reason to be in `safe` begins with (`companion.core.pilot.modes`)."""
ENDS_S = 3.0
"""A program that was told to end does so within this time; assumed."""


@dataclass(frozen=True)
class DemoScore:
    """`figures` and `stopped` (why driving was stopped for good; empty: it was not) go to summary.json; the rest is
    for the picture.
    """

    figures: dict[str, float | int]
    stopped: str
    track: TrueTrack
    messages: dict[type[Message], list[Any]]
    truths: list[GroundTruth]


def summarise(run_log: Path, truth_log: Path, settings: PilotSettings) -> DemoScore:
    """Read both logs and compute every figure."""
    messages: dict[type[Message], list[Any]] = {kind: [] for kind in KINDS}
    for message in LogFile(run_log).messages(*KINDS):
        messages[type(message)].append(message)
    truths = [m for m in LogFile(truth_log).messages(GroundTruth) if isinstance(m, GroundTruth)]
    track = track_of(messages[StateEstimate], messages[GuidanceReference], truths)
    points = np.array(settings.mission.path.points)
    passed = max((r.waypoints_passed for r in messages[GuidanceReference]), default=0)
    figures: dict[str, float | int] = {"waypoints_total": len(points), "waypoints_passed": passed}
    if len(track.t_s):
        pose = (*points[-1], end_heading(settings.mission))
        arrived = settings.guidance.end == "station" and passed == len(points)
        kept = station(track, pose) if arrived else {}
        figures |= tracking(track, points) | kept | estimation(track)
    figures |= _timing(messages) | {"simulator_stall_ms": _longest_gap_ms(truths)}
    return DemoScore(figures, why_stopped(messages), track, messages, truths)


def why_stopped(messages: dict[type[Message], list[Any]]) -> str:
    """When and why the boat went into `safe`, or an operator stopped it, if it did not drive again; else empty.

    Told to end, the program stops the boat as an operator does, and is gone within `ENDS_S`.
    """
    ticks, latest_first = messages[Tick], messages[ModeStatus][::-1]
    idle = list(takewhile(lambda m: m.mode == "idle", latest_first))
    rest = latest_first[len(idle) :]
    safe = list(takewhile(lambda m: m.mode == "safe", rest))
    if not rest or not ticks:
        return ""
    if safe:
        stop, why = safe[-1], safe[-1].why.removeprefix(STOPPED).partition("; thrusters")[0]
    elif idle and (ticks[-1].t_ns - idle[-1].t_ns) * 1e-9 > ENDS_S:
        stop, why = idle[-1], idle[-1].why
    else:
        return ""
    return f"driving was stopped after {(stop.t_ns - ticks[0].t_ns) * 1e-9:.1f} s: {why}"


def _timing(messages: dict[type[Message], list[Any]]) -> dict[str, float | int]:
    timing: list[LoopTiming] = messages[LoopTiming]
    plans = [m.solve_time_s * 1e3 for m in messages[PlanResult]]
    latency = [m.imu_to_override_ms for m in timing if m.imu_to_override_ms is not None]
    stats: list[ProcessStats] = messages[ProcessStats][1:]
    return {
        "ticks": len(messages[Tick]),
        "leases": len(messages[OverrideLease]),
        "leases_from_plan": sum(m.source == "plan" for m in messages[OverrideLease]),
        "lateness_p99_ms": _percentile([m.lateness_ms for m in timing], 99),
        "latency_p99_ms": _percentile(latency, 99),
        "nmpc_p50_ms": _percentile(plans, 50),
        "nmpc_p99_ms": _percentile(plans, 99),
        "cpu_percent": float(np.mean([m.cpu_percent for m in stats])) if stats else float("nan"),
        "rss_mb": max((m.rss_mb for m in stats), default=float("nan")),
    }


def _longest_gap_ms(truths: list[GroundTruth]) -> float:
    """Longest time [ms] for which the simulator did nothing, from the stamps of its truth."""
    return max((b.t_ns - a.t_ns for a, b in pairwise(truths)), default=0) * 1e-6


def _percentile(values: list[float], share: float) -> float:
    return float(np.percentile(values, share)) if values else float("nan")


def for_json(score: DemoScore) -> dict[str, float | int | str | None]:
    """For JSON, which has no NaN: what was not measured is null, as is `stopped` where driving was not."""
    finite = {name: value if math.isfinite(value) else None for name, value in score.figures.items()}
    return {**finite, "stopped": score.stopped or None}
