"""The paper's closed loop on its own model (its Figures 11 to 18): LOS, waypoint switching, NMPC, RK4.

A waypoint is passed inside its circle of acceptance or beyond the end of its leg: with the circle alone one
may be missed and never switched. The plant is the model of the controller, without lag or disturbance; an
optional noise on what the controller is told stands for the estimator. The waypoints are assumed: the paper
shows its own only in a figure.

Results: without control cost and without noise the thrust saturates for seconds in a turn but does not
chatter; noise of an estimator makes it chatter from limit to limit. With two actions applied, pairs of
thrusters saw-tooth. Which pair depends on places and signs, which the paper does not print: C_y = 0 makes
fore and aft of one side equal here, so it is the outer side in a turn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from companion.core.geometry.frames import ssa
from companion.core.guidance.path import Path, Waypoint, los_heading
from companion.core.model.integrate import eta_dot, rk4
from sim.bench.controller.paper_problem import PAPER, PaperSettings
from sim.fitting.taylor.abkowitz import KGF_N, AbkowitzModel
from sim.studies.paper.nmpc import PaperNmpc
from sim.studies.paper.validity import outside

WAYPOINTS = ((4.0, 4.0), (4.0, 20.0), (20.0, 20.0), (20.0, 8.0), (10.0, 8.0))
"""(north, east) [m] in the 30 x 30 m basin: assumed."""
ACCEPTANCE_M = 1.0
LOOKAHEAD_M = 2.0
"""Assumed: about the boat's length, and a little more."""
NOISE = np.array([0.01, 0.02, 0.02, 0.01])
"""One sigma of white noise on [psi u v r] [rad, m/s, m/s, rad/s]: assumed, of an estimator at 10 Hz."""


@dataclass(frozen=True)
class PaperTrack:
    """One run, K ticks: t (K,) [s]; eta, nu (K, 3); thrust (K, n) [kgf]; y_e, psi_des (K,); leg (K,)."""

    t_s: np.ndarray
    eta: np.ndarray
    nu: np.ndarray
    c_kgf: np.ndarray
    y_e_m: np.ndarray
    psi_des_rad: np.ndarray
    leg: np.ndarray
    passed: int
    converged: float
    outside: float
    """Share of ticks outside the model's validity box."""


def run(
    model: AbkowitzModel,
    settings: PaperSettings = PAPER,
    *,
    waypoints: Sequence[tuple[float, float]] = WAYPOINTS,
    noise: np.random.Generator | None = None,
    longest_s: float = 300.0,
) -> PaperTrack:
    """Drive the waypoints from the first, along the first leg at 0.5 m/s, until the last is passed."""
    path = Path(tuple(Waypoint(north, east) for north, east in waypoints))
    plant, nmpc, h = _plant(model, settings.step_s), PaperNmpc(model, settings), settings.step_s
    x = np.array([*path.points[0], path.angles_rad[0], settings.u_des_m_s, 0.0, 0.0])
    leg, rows, solved, c = 0, [], [], np.zeros((1, model.B.shape[1]))
    for tick in range(round(longest_s / h)):
        leg = next_leg(path, leg, x)
        if leg == len(path.angles_rad):
            break
        y_e = path.errors(leg, x[0], x[1])[1]
        psi_des = x[2] + ssa(los_heading(path.angles_rad[leg], y_e, LOOKAHEAD_M) - x[2])
        if tick % settings.applied == 0:
            estimate = x[2:] + (noise.normal(size=4) * NOISE if noise else 0.0)
            plan = nmpc.plan(estimate[0], estimate[1:], psi_des)
            c = plan.c_kgf
            solved.append(plan.converged)
        action = c[tick % settings.applied]
        invalid = bool(outside(x[3:], model.B @ action * KGF_N))
        rows.append((tick * h, *x, *action, y_e, psi_des, leg, invalid))
        x = np.array(plant(x, action)).ravel()
    table = np.array(rows)
    t, eta, nu, c, tail = np.split(table, [1, 4, 7, table.shape[1] - 4], axis=1)
    return PaperTrack(
        t[:, 0], eta, nu, c, tail[:, 0], tail[:, 1], tail[:, 2].astype(int),
        passed=leg, converged=float(np.mean(solved)), outside=float(np.mean(tail[:, 3])),
    )  # fmt: skip


def next_leg(path: Path, leg: int, x: np.ndarray) -> int:
    """The leg to follow now: past every waypoint that is reached or lies behind."""
    while leg < len(path.angles_rad):
        x_e, _ = path.errors(leg, x[0], x[1])
        near = math.dist(path.points[leg + 1], x[:2]) <= ACCEPTANCE_M
        if not near and x_e < path.lengths_m[leg]:
            break
        leg += 1
    return leg


def _plant(model: AbkowitzModel, h: float) -> ca.Function:
    """(x, c [kgf]) -> x after `h` seconds; x = [x y psi u v r]."""
    x, c = ca.SX.sym("x", 6), ca.SX.sym("c", model.B.shape[1])
    tau = ca.mtimes(ca.DM(model.B), c) * KGF_N

    def rate(s: ca.SX) -> ca.SX:
        return ca.vertcat(eta_dot(s[:3], s[3:]), model.nu_dot(s[:3], s[3:], tau))

    return ca.Function("plant", [x, c], [rk4(rate, x, h)])


def metrics(track: PaperTrack) -> dict[str, float]:
    """Scores of one run; thrust in kgf. `legs`: 5 s and more after a switch."""
    since = np.array([t - track.t_s[track.leg == leg][0] for t, leg in zip(track.t_s, track.leg, strict=True)])
    legs = (since > 5.0) | (track.leg == 0)
    steps = np.diff(track.c_kgf, axis=0)
    return {
        "waypoints_passed": float(track.passed),
        "duration_s": float(track.t_s[-1]),
        "surge_mean_legs_m_s": float(np.mean(track.nu[legs, 0])),
        "surge_rms_error_legs_m_s": _rms(track.nu[legs, 0] - PAPER.u_des_m_s),
        "cross_track_rms_legs_m": _rms(track.y_e_m[legs]),
        "sway_max_m_s": float(np.abs(track.nu[:, 1]).max()),
        "thrust_rms_kgf": _rms(track.c_kgf),
        "thrust_step_rms_kgf": _rms(steps),
        "thrust_reversals_share": _reversals(steps),
        "converged_share": track.converged,
        "outside_validity_share": track.outside,
    }


def _reversals(steps: np.ndarray) -> float:
    """Share of thrust steps that undo a part of the one before: 0 is smooth, 1 a saw-tooth. Steps above 0.02."""
    large = (np.abs(steps[1:]) > 0.02) & (np.abs(steps[:-1]) > 0.02)
    return float(np.sum((steps[1:] * steps[:-1] < 0) & large) / max(1, np.sum(large)))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def variants() -> dict[str, tuple[PaperSettings, bool]]:
    """The paper's cases and the two that explain them: settings, and whether the estimate is noisy."""
    no_cost = replace(PAPER, s_c=0.0)
    return {
        "paper": (PAPER, False),
        "no_control_cost": (no_cost, False),
        "two_actions": (replace(PAPER, applied=2), False),
        "paper_noisy": (PAPER, True),
        "no_control_cost_noisy": (no_cost, True),
    }


def evidence(model: AbkowitzModel, seed: int = 1) -> dict[str, dict[str, float]]:
    """Metrics of every variant. About 5 s a variant."""
    return {
        name: metrics(run(model, settings, noise=np.random.default_rng(seed) if noisy else None))
        for name, (settings, noisy) in variants().items()
    }
