"""The fallback ladder: what to command the actuators when the plan is late, old or missing.

    plan          an ok plan no older than `plan_age_s`
    shifted_plan  the same plan, further along itself, up to `shifted_age_s`
    pd            heading, cross-track and surge by proportional-derivative laws, allocated within limits
    neutral       nothing to steer by: no forces

The PD law places both poles of every axis at -omega on the diagonal of M (x_e counts only on station):

    tau = -M_ii (omega^2 e + 2 omega e_dot),   X = M_11 (u_ref - u) / T_u + D_11(u_ref) u_ref  on a leg

Pure: age, estimate and reference are arguments; nothing is remembered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from companion.core.configuration.tables import Positive, Table
from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.allocation import allocate
from companion.core.geometry.frames import ssa, unrotate
from companion.core.guidance.reference_row import REACH_M, Column, path_errors
from companion.core.messages import PlanResult, StateEstimate
from companion.core.model.actuators.propulsion import control_limits
from companion.core.model.manoeuvring import mass_matrix

LARGEST = 1e6
"""No number of an estimate or a reference may be larger."""

Source = Literal["plan", "shifted_plan", "pd", "neutral"]


class FallbackSettings(Table, frozen=True, kw_only=True):
    """Ages and gains. All assumed, and tried in tests/companion/core/control/test_fallback.py."""

    plan_age_s: Positive = 0.15
    """A tick and a half at 10 Hz."""
    shifted_age_s: Positive = 1.0
    """Beyond this the boat is no longer where the plan thought."""
    omega_yaw_rad_s: Positive = 1.2
    omega_position_rad_s: Positive = 0.7
    surge_time_s: Positive = 1.5
    """T_u."""
    position_error_max_m: Positive = REACH_M
    """The PD law sees no larger error than this: a far path is approached, not jumped at."""


class FallbackCommand(NamedTuple):
    """Commands [N; angles rad], shape (n,), the rung they come from, and why no higher one."""

    f_n: np.ndarray
    source: Source
    reason: str


def command(
    plan: PlanResult | None,
    plan_age_s: float,
    estimate: StateEstimate | None,
    reference: Sequence[float] | None,
    vessel: VesselFile,
    *,
    step_s: float,
    settings: FallbackSettings,
    now: Sequence[float] | None = None,
    within_s: float = math.inf,
) -> FallbackCommand:
    """What to command next. `plan_age_s`: time since the instant that the plan's first state speaks of;
    `reference`: the row for now (`columns`); `step_s`: step of the plan; `now`: what is commanded, `within_s`: until
    the next command, for actuators that turn. Never NaN, always within limits.
    """
    f, why = _from_plan(plan, plan_age_s, step_s, vessel, settings)
    if f is not None:
        return FallbackCommand(f, "plan" if plan_age_s <= settings.plan_age_s else "shifted_plan", why)
    zero = np.zeros(len(vessel.controls))
    if estimate is None or estimate.health in ("initialising", "lost"):
        return FallbackCommand(zero, "neutral", f"{why}; no usable estimate")
    if reference is None:
        return FallbackCommand(zero, "neutral", f"{why}; no reference")
    pose = (estimate.north_m, estimate.east_m, estimate.psi_rad)
    numbers = (*pose, estimate.u_m_s, estimate.v_m_s, estimate.r_rad_s, *estimate.disturbance_n, *reference)
    if not (np.abs(numbers) <= LARGEST).all():
        return FallbackCommand(zero, "neutral", f"{why}; estimate or reference not finite, or beyond {LARGEST:g}")
    tau, nu = (
        pd_force(estimate, reference, vessel, settings),
        np.array([estimate.u_m_s, estimate.v_m_s, estimate.r_rad_s]),
    )
    f = allocate(tau, vessel, nu_r=nu, now=None if now is None else np.array(now), within_s=within_s)
    return FallbackCommand(f, "pd", why)


def _from_plan(
    plan: PlanResult | None, age_s: float, step_s: float, vessel: VesselFile, settings: FallbackSettings
) -> tuple[np.ndarray | None, str]:
    """Commands of the plan at its age, or None; and the reason."""
    if plan is None:
        return None, "no plan"
    if plan.status != "ok":
        return None, f"plan {plan.status}: {plan.reason}"
    if not 0.0 <= age_s <= settings.shifted_age_s:
        return None, f"plan is {age_s:.2f} s old"
    stage = math.floor(age_s / step_s + 1e-9)
    if stage >= len(plan.f_n) or len(plan.f_n[stage]) != len(vessel.controls):
        return None, "plan has no such stage"
    f = np.array(plan.f_n[stage], dtype=float)
    if not np.isfinite(f).all():
        return None, "plan is not finite"
    return np.clip(f, *control_limits(vessel)), f"plan is {age_s:.2f} s old"


def pd_force(
    estimate: StateEstimate, reference: Sequence[float], vessel: VesselFile, settings: FallbackSettings
) -> np.ndarray:
    """tau [N, N, N m] of the PD law above, before limits."""
    row = np.asarray(reference, dtype=float)
    M, d, c = np.diag(mass_matrix(vessel)), vessel.damping, settings
    u_ref, station, far = row[Column.U], row[Column.STATION], c.position_error_max_m
    psi, nu = estimate.psi_rad, np.array([estimate.u_m_s, estimate.v_m_s, estimate.r_rad_s])
    x_e, y_e = np.clip(path_errors(row, estimate.north_m, estimate.east_m), -far, far)
    ahead, side = unrotate(psi - row[Column.PATH_ANGLE], x_e, y_e)
    w = c.omega_position_rad_s
    along = (u_ref - nu[0]) / c.surge_time_s
    hold = -(w**2) * ahead - 2 * w * nu[0]
    drag = -(d.X_u_N_s_m + d.X_uu_N_s2_m2 * abs(u_ref)) * u_ref
    X = M[0] * ((1 - station) * along + station * hold) + drag
    Y = M[1] * (-(w**2) * side - 2 * w * (nu[1] - row[Column.V]))
    w = c.omega_yaw_rad_s
    N = M[2] * (-(w**2) * ssa(psi - row[Column.PSI]) - 2 * w * (nu[2] - row[Column.R]))
    return np.array([X, Y, N]) - np.asarray(estimate.disturbance_n, dtype=float)
