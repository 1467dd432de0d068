"""How far a boat has come: the state of guidance, which waypoints were passed, and whether it has settled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from companion.core.geometry.frames import ssa
from companion.core.guidance.course import Course, hold_point
from companion.core.guidance.path import Path
from companion.core.guidance.reference import GuidanceSettings


@dataclass(frozen=True)
class Passage:
    """A waypoint of the mission was passed: how, when, and the closest that the boat came to it [m]."""

    waypoint: int
    reason: Literal["circle", "along-track"]
    miss_m: float
    t_ns: int


@dataclass(frozen=True)
class GuidanceState:
    """Everything that guidance remembers.

    `route`: the driven path, from where the boat was through the waypoints then ahead (None: plain hold);
    `target`: index into it of the waypoint ahead; `closest_m`: closest approach to that so far. `course`: the
    rounded route or the pose to hold; `s_m`: arc length on it; `end_psi_rad`: heading to hold at its end.
    """

    phase: Literal["idle", "leg", "station", "done"] = "idle"
    t_ns: int = 0
    route: Path | None = None
    course: Course | None = None
    target: int = 1
    passed: tuple[Passage, ...] = ()
    end_psi_rad: float = 0.0
    s_m: float = 0.0
    psi_ref_rad: float = 0.0
    u_ref_m_s: float = 0.0
    y_int_m: float = 0.0
    closest_m: float = math.inf
    settled_ns: int | None = None


def pass_waypoint(state: GuidanceState, settings: GuidanceSettings, eta: Sequence[float]) -> GuidanceState:
    """Record the target as passed where it is, one per step."""
    if state.phase != "leg" or state.route is None or state.course is None:
        return state
    points, leg = state.route.points, state.target - 1
    closest = min(state.closest_m, math.dist((eta[0], eta[1]), points[state.target]))
    x_e, _ = state.route.errors(leg, eta[0], eta[1])
    if closest <= (state.route.waypoints[state.target].acceptance_m or settings.limits.acceptance_m):
        reason = "circle"
    elif x_e >= state.route.lengths_m[leg] or state.s_m >= state.course.waypoints_m[state.target]:
        reason = "along-track"
    else:
        return replace(state, closest_m=closest)
    passed = (*state.passed, Passage(len(state.passed), reason, closest, state.t_ns))
    state = replace(state, passed=passed, closest_m=math.inf, y_int_m=0.0)
    if state.target < len(points) - 1:
        return replace(state, target=state.target + 1)
    if settings.end == "drift":
        return replace(state, phase="done", settled_ns=state.t_ns)
    if settings.steering == "los":
        state = replace(state, course=hold_point(*points[-1], state.end_psi_rad, settings.limits), s_m=0.0)
    return replace(state, phase="station")


def update_miss(state: GuidanceState, eta: Sequence[float]) -> GuidanceState:
    """The miss distance of the last waypoint passed, should the boat still come closer to it."""
    behind = state.target - 1 if state.phase == "leg" else -1
    if state.route is None or behind == 0 or not state.passed:
        return state
    last = state.passed[-1]
    miss = math.dist((eta[0], eta[1]), state.route.points[behind])
    if miss >= last.miss_m:
        return state
    return replace(state, passed=(*state.passed[:-1], replace(last, miss_m=miss)))


def settle(state: GuidanceState, settings: GuidanceSettings, eta: Sequence[float]) -> GuidanceState:
    """station -> done once the boat has stayed at the end of a path; a plain hold never ends."""
    if state.phase != "station" or state.course is None or state.route is None:
        return state
    north, east, _ = state.course.at(state.course.length_m)
    off = abs(ssa(eta[2] - state.end_psi_rad)) > math.radians(settings.settle_deg)
    if off or math.dist((eta[0], eta[1]), (north, east)) > settings.settle_m:
        return replace(state, settled_ns=None)
    since = state.t_ns if state.settled_ns is None else state.settled_ns
    done = (state.t_ns - since) * 1e-9 >= settings.settle_s
    return replace(state, settled_ns=since, phase="done" if done else "station")
