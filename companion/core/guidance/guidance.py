"""Guidance: which waypoint is next, where along the course the boat is, and what is asked for now.

    idle --start--> leg --last waypoint passed--> station --settled--> done        any --hold--> station

`step` advances the state by one tick; `horizon` lays the reference of the coming stages before an NMPC. Both
are pure. A waypoint is passed by its circle of acceptance or by along-track passage (x_e beyond its leg, or
the course rounded beyond its corner), so it may be missed but is never waited for or skipped: each Passage
says how and by how much. Station keeping starts when the last waypoint is passed: the reference runs out to
the end of the course by itself, slows to a stop, and stays; `done` goes on holding. A boat that cannot keep station
(`GuidanceSettings.end` is `drift`) is done when the last waypoint is passed, at the start as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from companion.core.geometry.frames import near, rotate, unrotate
from companion.core.guidance.course import hold_point, plan_course
from companion.core.guidance.path import SHORTEST_LEG_M, Path, Waypoint
from companion.core.guidance.progress import GuidanceState, Passage, pass_waypoint, settle, update_miss
from companion.core.guidance.reference import GuidanceSettings, Walker, course_rows, los_rows, within_reach
from companion.core.guidance.steering import advance, reference_track
from companion.core.messages import GuidanceReference

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
    angles = path.angles_rad or route.angles_rad  # of the mission, wherever this start is given
    end_psi = end_heading_rad if end_heading_rad is not None else angles[-1] if angles else eta[2]
    limits, at_end = settings.limits, "done" if settings.end == "drift" else "station"
    return GuidanceState(
        phase="leg" if route.lengths_m else at_end,
        t_ns=t_ns,
        route=route,
        course=plan_course(route, limits) if route.lengths_m else hold_point(*route.points[0], end_psi, limits),
        passed=passed,
        end_psi_rad=end_psi,
        psi_ref_rad=eta[2],
        u_ref_m_s=max(nu[0], 0.0),
        settled_ns=None if route.lengths_m or at_end == "station" else t_ns,
    )


def hold(
    settings: GuidanceSettings,
    eta: Sequence[float],
    nu: Sequence[float],
    t_ns: int,
    *,
    passed: tuple[Passage, ...] = (),
    is_clear: Callable[[float, float], bool] = lambda north_m, east_m: True,
) -> GuidanceState:
    """Keep station here: at the present heading, where braking from U ends, U^2 / 2a ahead of the boat.

    Where that place is not clear of fences (`is_clear`), where the boat is: it then brakes as hard as it can.
    """
    eta, nu = _floats(eta), _floats(nu)
    stretch_s = math.hypot(nu[0], nu[1]) / (2 * settings.limits.deceleration_m_s2)
    dn, de = rotate(eta[2], nu[0] * stretch_s, nu[1] * stretch_s)
    if not is_clear(eta[0] + dn, eta[1] + de):
        dn, de = 0.0, 0.0
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
        state = advance(state, settings, eta, nu, dt)
        state = pass_waypoint(update_miss(state, eta), settings, eta)
        state = settle(state, settings, eta)
    return state, _report(state, settings, eta, nu)


def horizon(
    state: GuidanceState,
    settings: GuidanceSettings,
    eta: Sequence[float],
    nu: Sequence[float],
    times_s: Sequence[float],
) -> np.ndarray:
    """References at `times_s` (first 0, increasing) after `step`: shape (len(times_s), 8), see `columns`.

    psi is continuous and starts within pi of `eta`'s. While idle: hold the present pose. A boat that is far away is
    led back by `within_reach`.
    """
    if state.phase == "leg" and state.route is not None and settings.steering == "los":
        leg = state.target - 1
        x_e, _ = state.route.errors(leg, eta[0], eta[1])
        angle, (n, e) = state.route.angles_rad[leg], state.route.points[leg]
        first = (n + x_e * math.cos(angle), e + x_e * math.sin(angle))
        rows = los_rows(first, angle, near(state.psi_ref_rad, eta[2]), state.u_ref_m_s, times_s)
        return within_reach(rows, eta)
    if state.course is None:
        state = replace(hold(settings, eta, (0.0, 0.0, 0.0), state.t_ns), phase="idle")
    track = reference_track(state, settings, nu)
    y_e = track.cross_track(state.s_m, eta[0], eta[1])
    walker = Walker(state.s_m, near(state.psi_ref_rad, eta[2]), state.u_ref_m_s, y_e)
    return within_reach(course_rows(track, walker, times_s), eta)


def _floats(values: Sequence[float]) -> tuple[float, ...]:
    """Plain floats, whatever the estimator counts in: messages and states carry no array scalars."""
    return tuple(map(float, values))


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
