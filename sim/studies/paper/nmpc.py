"""The paper's NMPC as the paper solves it: multiple shooting, CasADi nlpsol with IPOPT."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from sim.bench.controller.paper_problem import PAPER, PaperSettings, paper_advance
from sim.fitting.taylor.abkowitz import AbkowitzModel


class PaperPlan(NamedTuple):
    """Thrust (N, n) [kgf], cost, whether IPOPT converged, and its iterations."""

    c_kgf: np.ndarray
    cost: float
    converged: bool
    iterations: int


class PaperNmpc:
    """The problem of `paper_problem`, built once, solved from the last solution. One thread at a time."""

    def __init__(self, model: AbkowitzModel, settings: PaperSettings = PAPER):
        self._settings, self._nu = settings, model.B.shape[1]
        N, nu = settings.stages, self._nu
        X, U, p = ca.SX.sym("x", 4, N + 1), ca.SX.sym("c", nu, N), ca.SX.sym("p", 5)
        cost, gaps = 0, [X[:, 0] - p[:4]]
        for k in range(N):
            psi, u, v = X[0, k], X[1, k], X[2, k]
            cost += settings.s_u * (u - settings.u_des_m_s) ** 2 + settings.s_psi * (psi - p[4]) ** 2
            cost += settings.s_v * (v - settings.v_des_m_s) ** 2 + settings.s_c * ca.sumsqr(U[:, k])
            gaps.append(X[:, k + 1] - paper_advance(model, X[:, k], U[:, k], settings.step_s))
        nlp = {"x": ca.veccat(X, U), "f": cost, "g": ca.vertcat(*gaps), "p": p}
        options: dict[str, Any] = {
            "print_time": False,
            "error_on_fail": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
        }
        self._solver = ca.nlpsol("paper", "ipopt", nlp, options)
        free = np.full(4 * (N + 1), np.inf)
        self._low = np.concatenate([-free, np.full(nu * N, settings.c_min_kgf)])
        self._high = np.concatenate([free, np.full(nu * N, settings.c_max_kgf)])
        self._guess = np.zeros(self._low.size)

    def plan(self, psi_rad: float, nu: np.ndarray, psi_des_rad: float) -> PaperPlan:
        """Plan from heading [rad] and nu [m/s, m/s, rad/s]; psi_des is to be within pi of psi."""
        p = np.array([psi_rad, *nu, psi_des_rad])
        answer = self._solver(x0=self._guess, p=p, lbx=self._low, ubx=self._high, lbg=0.0, ubg=0.0)
        w, stats = np.array(answer["x"]).ravel(), self._solver.stats()
        self._guess = w if stats["success"] else np.zeros(w.size)
        c = w[4 * (self._settings.stages + 1) :].reshape(self._settings.stages, self._nu)
        return PaperPlan(c, float(answer["f"]), bool(stats["success"]), int(stats["iter_count"]))
