"""How well a run went, against the truth: tracking, speed, turns, station, estimate.

Straight part of a leg: samples whose foot on the leg lies `CORNER_M` or more from both of its ends, while that
leg is driven. The surge error there is true u against the speed that guidance asked for at that tick.
Overshoot of a corner: how far the true track swings out beyond the line of the next leg, on the outer side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.geometry.frames import ssa
from companion.core.guidance.missions.draft import Mission
from companion.core.messages import GroundTruth, GuidanceReference, StateEstimate

CORNER_M = 1.5  # a boat's length: where the course is rounded, "on the leg" means nothing
SETTLED_S = 3.0  # station keeping is judged over the last seconds of a run, where nothing else is said


@dataclass(frozen=True)
class TrueTrack:
    """One row a tick: t [s]; truth and estimate [x y psi u v r]; P (k, 6, 6); asked-for speed; leg; on leg."""

    t_s: np.ndarray
    truth: np.ndarray
    estimate: np.ndarray
    P: np.ndarray
    u_ref: np.ndarray
    leg: np.ndarray
    on_leg: np.ndarray


def leg_errors(points: np.ndarray, leg: int, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Along-track and cross-track error [m] of `places` (k, 2) to one leg of `points`, and its length."""
    start, end = points[leg], points[leg + 1]
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    away = places - start
    return away @ along, away @ np.array([-along[1], along[0]]), length


def tracking(track: TrueTrack, points: np.ndarray) -> dict[str, float]:
    """cross_track_rms_m, surge_rms_error_m_s on straight parts; overshoot_m of the worst corner.

    NaN where no straight part, or no corner, was driven.
    """
    cross, surge, overshoot = [], [], []
    for leg in range(len(points) - 1):
        driven = track.on_leg & (track.leg == leg)
        x_e, y_e, length = leg_errors(points, leg, track.truth[driven, :2])
        straight = (x_e >= CORNER_M) & (x_e <= length - CORNER_M)
        cross.append(y_e[straight])
        surge.append((track.truth[driven, 3] - track.u_ref[driven])[straight])
        if leg and driven.any():
            before = points[leg] - points[leg - 1]
            after = points[leg + 1] - points[leg]
            side = math.copysign(1.0, before[0] * after[1] - before[1] * after[0])
            overshoot.append(float((-side * y_e).max(initial=0.0)))
    return {
        "cross_track_rms_m": _rms(np.concatenate([np.zeros(0), *cross])),
        "surge_rms_error_m_s": _rms(np.concatenate([np.zeros(0), *surge])),
        "overshoot_m": max(overshoot, default=math.nan),
    }


def end_heading(mission: Mission) -> float:
    """Heading to hold at the end [rad]: the mission's, else the last leg's; NaN where there is neither."""
    wanted, legs = mission.end_heading_rad, mission.path.angles_rad
    return wanted if wanted is not None else (legs[-1] if legs else math.nan)


def station(track: TrueTrack, pose: Sequence[float], over_s: float = SETTLED_S) -> dict[str, float]:
    """Largest position [m] and heading error [deg] of the truth over the last `over_s`; NaN where `pose` has NaN."""
    last = track.t_s >= track.t_s[-1] - over_s
    away = np.linalg.norm(track.truth[last, :2] - np.asarray(pose[:2]), axis=1)
    turn = [abs(ssa(float(psi) - pose[2])) for psi in track.truth[last, 2]]
    return {"station_error_m": float(away.max()), "station_error_deg": math.degrees(max(turn))}


def estimation(track: TrueTrack) -> dict[str, float]:
    """RMSE of position, u, v and heading, and the mean NEES of [x y psi u v r] (6 where consistent)."""
    error = track.estimate - track.truth
    error[:, 2] = [ssa(float(e)) for e in error[:, 2]]
    nees = np.einsum("ki,ki->k", error, np.linalg.solve(track.P, error[:, :, None])[:, :, 0])
    return {
        "position_rmse_m": float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean())),
        "u_rmse_m_s": _rms(error[:, 3]),
        "v_rmse_m_s": _rms(error[:, 4]),
        "velocity_rmse_m_s": float(np.sqrt((error[:, 3:5] ** 2).mean(axis=0).max())),
        "heading_rmse_deg": math.degrees(_rms(error[:, 2])),
        "nees": float(nees.mean()),
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else math.nan


def track_of(
    estimates: Sequence[StateEstimate],
    references: Sequence[GuidanceReference],
    truths: Sequence[GroundTruth] | Sequence[StateEstimate],
) -> TrueTrack:
    """Rows for the ticks that were driven; the truth is interpolated to the estimate's instant."""
    asked = {r.t_ns: r for r in references if r.phase != "idle"}
    rows = [e for e in estimates if e.t_ns in asked]
    at = np.array([e.t_ns for e in rows], dtype=float)
    when = np.array([t.t_ns for t in truths], dtype=float)
    known = np.array([_motion(t) for t in truths]).reshape(-1, 6)
    known[:, 2] = np.unwrap(known[:, 2])
    truth = np.column_stack([np.interp(at, when, known[:, i]) for i in range(6)])
    refs = [asked[e.t_ns] for e in rows]
    return TrueTrack(
        t_s=at * 1e-9,
        truth=truth,
        estimate=np.array([_motion(e) for e in rows]).reshape(-1, 6),
        P=np.array([e.covariance for e in rows]).reshape(-1, 6, 6),
        u_ref=np.array([r.u_ref_m_s for r in refs]),
        leg=np.array([r.leg for r in refs], dtype=int),
        on_leg=np.array([r.phase == "leg" for r in refs], dtype=bool),
    )


def _motion(m: StateEstimate | GroundTruth) -> tuple[float, ...]:
    return m.north_m, m.east_m, m.psi_rad, m.u_m_s, m.v_m_s, m.r_rad_s
