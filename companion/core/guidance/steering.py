"""References for heading and speed, one tick on: along the course, or by LOS on the straight leg (the paper's law)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from companion.core.geometry.frames import near, ssa
from companion.core.guidance.path import SHORTEST_LEG_M, crab_angle, ilos_rate, los_heading
from companion.core.guidance.progress import GuidanceState
from companion.core.guidance.reference import GuidanceSettings, ReferenceTrack, Walker, turn

BACK_M = 0.5
"""How far the projection may fall back in one step (assumed)."""
AHEAD_M = 0.3
"""How far it may jump ahead beyond twice the way at the present speed (assumed)."""


def reference_track(state: GuidanceState, settings: GuidanceSettings, nu: Sequence[float]) -> ReferenceTrack:
    """The course to follow, with the heading at its end, the ILOS integral and the crab angle of now."""
    assert state.course is not None, "idle guidance has no course"
    beta = crab_angle(nu[0], nu[1]) if settings.crab and state.phase == "leg" else 0.0
    return ReferenceTrack(state.course, state.end_psi_rad, settings, state.y_int_m, beta)


def advance(
    state: GuidanceState, settings: GuidanceSettings, eta: Sequence[float], nu: Sequence[float], dt_s: float
) -> GuidanceState:
    """Projection, ILOS integral, and the references for heading and speed, `dt_s` after the last step."""
    if state.phase == "leg" and settings.steering == "los":
        return _steer_los(state, settings, eta, nu, dt_s)
    track, course = reference_track(state, settings, nu), state.course
    assert course is not None, "idle guidance does not advance"
    if state.phase == "leg":
        ahead = AHEAD_M + 2 * max(nu[0], state.u_ref_m_s) * dt_s
        s = course.follow(eta[0], eta[1], state.s_m, BACK_M, ahead)
        s = course.beyond_corner(s, SHORTEST_LEG_M)  # at the crawl a boat may stand before it for good
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
