"""Health of the estimate, with the reason as text for the operator.

lost       position sigma above the limit along its worst axis, or no attitude for too long
degraded   no position, IMU or heading for too long (the filter dead-reckons), position sigma raised,
           positions moved the boat against its motion, or a start or a gap too short a time ago
"""

from __future__ import annotations

import math

from companion.core.estimation.filter_state import LAYOUT, FilterState
from companion.core.estimation.ranging.ranges import position_sigma_m
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.messages import Health
from companion.core.sensors.sensor import PositionHealth

SETTLES = "it settles: speed is not known well yet"
TURNS_UNSEEN_S = 3.0
"""Without an attitude for longer nothing tells how the boat turns. Assumed: as long as without heartbeats."""
DISPLACED_S = 10.0
"""A position taken anew is told for so long; assumed, and shorter than `control.blind_s`: nothing is missing."""


def is_settled(before: FilterState, after: FilterState, tuning: EstimatorTuning) -> bool:
    """Whether speed is known well enough after a start or a gap, `before` a position was fused as well as `after`.

    Once true it stays so until the next gap.
    """
    since_s = (after.t_ns - after.since_ns) * 1e-9
    is_early = since_s < tuning.settle_s or after.fixes < tuning.settle_fixes
    if after.settled or is_early or after.position_ns == before.position_ns:
        return after.settled
    known_before, known = (math.sqrt(max(b.P[i, i] for i in LAYOUT.velocity)) for b in (before, after))
    return known_before <= tuning.settled_before_fix_sigma_m_s and known <= tuning.settled_velocity_sigma_m_s


def assess(belief: FilterState, t_ns: int, tuning: EstimatorTuning, position: PositionHealth) -> tuple[Health, str]:
    """Health and reason of a filter state at t_ns; one that could not be predicted so far is lost.

    `position`: limits of the boat's sensor of positions.
    """
    if not belief.is_finite:
        return "lost", "the filter's numbers are not finite"
    if t_ns > belief.t_ns:
        return "lost", "no sensor message for too long to carry the estimate on"
    position_s = (t_ns - belief.position_ns) * 1e-9
    imu_s = float("inf") if belief.imu_ns is None else (t_ns - belief.imu_ns) * 1e-9
    heading_s = belief.heading_gate.starved_s(t_ns)
    sigma_m = position_sigma_m(LAYOUT, belief.P)
    settles = belief.is_settling(tuning.settle_most_s)
    reasons = [SETTLES] if settles else []
    if position_s > position.timeout_s:
        reasons.append(f"no {position.label} accepted for {position_s:.1f} s, dead reckoning")
    if imu_s > tuning.imu_timeout_s:
        reasons.append("no IMU" if imu_s == float("inf") else f"no IMU for {imu_s:.1f} s")
    if heading_s > tuning.imu_timeout_s:
        reasons.append("no heading accepted" + (f" for {heading_s:.1f} s" if heading_s < 1e9 else ""))
    if belief.was_displaced(t_ns, DISPLACED_S):
        reasons.append(f"{position.label} was against the motion by more than its error: taken anew")
    if sigma_m > position.degraded_sigma_m and not settles:  # then it grows because speed is not known
        reasons.append(f"position sigma {sigma_m:.2f} m")
    turns_s = (t_ns - belief.rates_ns) * 1e-9
    if turns_s > TURNS_UNSEEN_S:
        reasons.append(f"no attitude for {turns_s:.1f} s: nothing tells how the boat turns")
    if sigma_m > position.lost_sigma_m or turns_s > TURNS_UNSEEN_S:
        return "lost", "; ".join(reasons)
    return ("degraded", "; ".join(reasons)) if reasons else ("healthy", "")
