"""Guidance: which waypoint is next, where along the course the boat is, and what is asked for now.

    idle --start--> leg --last waypoint passed--> station --settled--> done        any --hold--> station

`step` advances the state by one tick; `horizon` lays the reference of the coming stages before an NMPC. Both
are pure. A waypoint is passed by its circle of acceptance or by along-track passage (x_e beyond its leg, or
the course rounded beyond its corner), so it may be missed but is never waited for or skipped: each Passage
says how and by how much. Station keeping starts when the last waypoint is passed: the reference runs out to
the end of the course by itself, slows to a stop, and stays; `done` goes on holding.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from companion.core.geometry.frames import near, rotate, ssa, unrotate
from companion.core.guidance.course import Course, hold_point, plan_course
from companion.core.guidance.path import SHORTEST_LEG_M, Path, Waypoint, crab_angle, ilos_rate, los_heading
from companion.core.guidance.reference import GuidanceSettings, ReferenceTrack, Walker, course_rows, los_rows, turn
from companion.core.messages import GuidanceReference

BACK_M = 0.5
"""How far the projection may fall back in one step (assumed)."""
AHEAD_M = 0.3
"""How far it may jump ahead beyond twice the way at the present speed (assumed)."""


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


IDLE = GuidanceState()


def start(
    path: Path,
    settings: GuidanceSettings,
    eta: Sequence[float],
    nu: Sequence[float],
    t_ns: int,
    *,
    end_heading_rad: float | None = None,
    passed: tuple[Passage, ...] = (),
) -> GuidanceState:
    """Begin `path` from where the boat is, or go on with it after the waypoints in `passed`.

    The first waypoint ahead is passed at once where the boat is within its circle; else a leg leads to it.
    The heading at the end is `end_heading_rad`, or that of the last leg, or the present one.
    """
    eta, nu = _floats(eta), _floats(nu)
    ahead, here = path.waypoints[len(passed) :], Waypoint(eta[0], eta[1])
    if ahead:
        miss = math.dist((here.north_m, here.east_m), (ahead[0].north_m, ahead[0].east_m))
        if miss <= max(ahead[0].acceptance_m or settings.limits.acceptance_m, SHORTEST_LEG_M):
            passed = (*passed, Passage(len(passed), "circle", miss, t_ns))
        else:
            ahead = (here, *ahead)
    route = Path(ahead or path.waypoints[-1:])
    angles = route.angles_rad or path.angles_rad
    end_psi = end_heading_rad if end_heading_rad is not None else angles[-1] if angles else eta[2]
    limits = settings.limits
    return GuidanceState(
        phase="leg" if route.lengths_m else "station",
        t_ns=t_ns,
        route=route,
        course=plan_course(route, limits) if route.lengths_m else hold_point(*route.points[0], end_psi, limits),
        passed=passed,
        end_psi_rad=end_psi,
        psi_ref_rad=eta[2],
        u_ref_m_s=max(nu[0], 0.0),
    )


def hold(
    settings: GuidanceSettings,
    eta: Sequence[float],
    nu: Sequence[float],
    t_ns: int,
    *,
    passed: tuple[Passage, ...] = (),
) -> GuidanceState:
    """Keep station here: at the present heading, where braking from U ends, U^2 / 2a ahead of the boat."""
    eta, nu = _floats(eta), _floats(nu)
    stretch_s = math.hypot(nu[0], nu[1]) / (2 * settings.limits.deceleration_m_s2)
    dn, de = rotate(eta[2], nu[0] * stretch_s, nu[1] * stretch_s)
    return GuidanceState(
        phase="station",
        t_ns=t_ns,
        course=hold_point(eta[0] + dn, eta[1] + de, eta[2], settings.limits),
        passed=passed,
        end_psi_rad=eta[2],
        psi_ref_rad=eta[2],
    )


def step(
    state: GuidanceState, settings: GuidanceSettings, eta: Sequence[float], nu: Sequence[float], t_ns: int
) -> tuple[GuidanceState, GuidanceReference]:
    """One tick: eta = [x y psi], nu = [u v r] at `t_ns` -> the next state and what is asked for now.

    psi may be wrapped or not: references come out within pi of it.
    """
    eta, nu = _floats(eta), _floats(nu)
    dt = max(t_ns - state.t_ns, 0) * 1e-9
    state = replace(state, t_ns=t_ns)
    if state.course is not None:
        state = _advance(state, settings, eta, nu, dt)
        state = _pass_waypoint(_keep_closest(state, eta), settings, eta)
        state = _settle(state, settings, eta)
    return state, _report(state, settings, eta, nu)


def horizon(
    state: GuidanceState,
    settings: GuidanceSettings,
    eta: Sequence[float],
    nu: Sequence[float],
    times_s: Sequence[float],
) -> np.ndarray:
    """References at `times_s` (first 0, increasing) after `step`: shape (len(times_s), 8), see `columns`.

    psi is continuous and starts within pi of `eta`'s. While idle: hold the present pose.
    """
    if state.phase == "leg" and state.route is not None and settings.steering == "los":
        leg = state.target - 1
        x_e, _ = state.route.errors(leg, eta[0], eta[1])
        angle, (n, e) = state.route.angles_rad[leg], state.route.points[leg]
        first = (n + x_e * math.cos(angle), e + x_e * math.sin(angle))
        return los_rows(first, angle, near(state.psi_ref_rad, eta[2]), state.u_ref_m_s, times_s)
    if state.course is None:
        state = replace(hold(settings, eta, (0.0, 0.0, 0.0), state.t_ns), phase="idle")
    track = _track(state, settings, nu)
    y_e = track.cross_track(state.s_m, eta[0], eta[1])
    walker = Walker(state.s_m, near(state.psi_ref_rad, eta[2]), state.u_ref_m_s, y_e)
    return course_rows(track, walker, times_s)


def _floats(values: Sequence[float]) -> tuple[float, ...]:
    """Plain floats, whatever the estimator counts in: messages and states carry no array scalars."""
    return tuple(map(float, values))


def _track(state: GuidanceState, settings: GuidanceSettings, nu: Sequence[float]) -> ReferenceTrack:
    assert state.course is not None, "idle guidance has no course"
    beta = crab_angle(nu[0], nu[1]) if settings.crab and state.phase == "leg" else 0.0
    return ReferenceTrack(state.course, state.end_psi_rad, settings, state.y_int_m, beta)


def _advance(
    state: GuidanceState, settings: GuidanceSettings, eta: Sequence[float], nu: Sequence[float], dt_s: float
) -> GuidanceState:
    """Projection, ILOS integral, and the references for heading and speed, `dt_s` after the last step."""
    if state.phase == "leg" and settings.steering == "los":
        return _steer_los(state, settings, eta, nu, dt_s)
    track, course = _track(state, settings, nu), state.course
    assert course is not None, "idle guidance does not advance"
    if state.phase == "leg":
        ahead = AHEAD_M + 2 * max(nu[0], state.u_ref_m_s) * dt_s
        s = course.follow(eta[0], eta[1], state.s_m, BACK_M, ahead)
    else:
        s = min(state.s_m + state.u_ref_m_s * dt_s, course.length_m)
    lead = max(-settings.lag_rad, min(settings.lag_rad, ssa(state.psi_ref_rad - eta[2])))
    y_e = track.cross_track(s, eta[0], eta[1])
    walker = turn(track, Walker(s, eta[2] + lead, state.u_ref_m_s, y_e), dt_s)
    return replace(
        state,
        s_m=s,
        psi_ref_rad=walker.psi_rad,
        u_ref_m_s=walker.u_m_s,
        y_int_m=_integrate(state, settings, y_e, dt_s),
    )


def _steer_los(
    state: GuidanceState, settings: GuidanceSettings, eta: Sequence[float], nu: Sequence[float], dt_s: float
) -> GuidanceState:
    """The paper's law on the straight leg: psi_d of LOS or ILOS, the leg's full speed."""
    assert state.route is not None, "a leg needs a route"
    leg = state.target - 1
    _, y_e = state.route.errors(leg, eta[0], eta[1])
    y_int = _integrate(state, settings, y_e, dt_s)
    beta = crab_angle(nu[0], nu[1]) if settings.crab else 0.0
    psi_d = los_heading(
        state.route.angles_rad[leg],
        y_e,
        settings.lookahead_m,
        kappa=settings.kappa,
        y_int_m=y_int,
        beta_rad=beta,
    )
    speed = state.route.waypoints[state.target].speed_m_s or settings.limits.cruise_m_s
    return replace(state, psi_ref_rad=near(psi_d, eta[2]), u_ref_m_s=speed, y_int_m=y_int)


def _integrate(state: GuidanceState, settings: GuidanceSettings, y_e_m: float, dt_s: float) -> float:
    """ILOS integral after `dt_s`; it stands still without ILOS and off the legs."""
    if settings.kappa == 0.0 or state.phase != "leg":
        return state.y_int_m
    return state.y_int_m + dt_s * ilos_rate(y_e_m, state.y_int_m, settings.lookahead_m, settings.kappa)


def _pass_waypoint(state: GuidanceState, settings: GuidanceSettings, eta: Sequence[float]) -> GuidanceState:
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
    if settings.steering == "los":
        state = replace(state, course=hold_point(*points[-1], state.end_psi_rad, settings.limits), s_m=0.0)
    return replace(state, phase="station")


def _keep_closest(state: GuidanceState, eta: Sequence[float]) -> GuidanceState:
    """The miss distance of the last waypoint passed, should the boat still come closer to it."""
    behind = state.target - 1 if state.phase == "leg" else -1
    if state.route is None or behind == 0 or not state.passed:
        return state
    last = state.passed[-1]
    miss = math.dist((eta[0], eta[1]), state.route.points[behind])
    if miss >= last.miss_m:
        return state
    return replace(state, passed=(*state.passed[:-1], replace(last, miss_m=miss)))


def _settle(state: GuidanceState, settings: GuidanceSettings, eta: Sequence[float]) -> GuidanceState:
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


def _report(
    state: GuidanceState, settings: GuidanceSettings, eta: Sequence[float], nu: Sequence[float]
) -> GuidanceReference:
    """What is asked for now. On a leg the errors are to that straight leg, else to the pose to hold.

    `leg` k leads from waypoint k of the mission to k + 1; -1 leads to waypoint 0.
    """
    n, e, angle = state.course.at(state.s_m) if state.course else (eta[0], eta[1], eta[2])
    if state.phase == "leg" and state.route is not None:
        leg = state.target - 1
        angle = state.route.angles_rad[leg]
        x_e, y_e = state.route.errors(leg, eta[0], eta[1])
    else:
        end_n, end_e, _ = state.course.at(state.course.length_m) if state.course else (n, e, angle)
        x_e, y_e = unrotate(angle, eta[0] - end_n, eta[1] - end_e)
    return GuidanceReference(
        t_ns=state.t_ns,
        phase=state.phase,
        leg=len(state.passed) - 1,
        waypoints_passed=len(state.passed),
        x_e_m=x_e,
        y_e_m=y_e,
        path_angle_rad=angle,
        psi_ref_rad=near(state.psi_ref_rad, eta[2]) if state.course else eta[2],
        u_ref_m_s=state.u_ref_m_s,
        north_ref_m=n,
        east_ref_m=e,
    )
