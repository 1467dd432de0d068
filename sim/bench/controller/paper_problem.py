"""The paper's NMPC, exactly: preset "paper". For comparison, not for the boat.

    min  sum_{k=0}^{N-1} 2 (u_k - 0.5)^2 + 1 (psi_k - psi_des)^2 + 1 (v_k - 0)^2 + s_c sum_i c_i,k^2     (9a)
    s.t. x_{k+1} = F(x_k, c_k) (Table 2),  -4.0793 <= c <= 5.1536 kgf                                  (9b)

N = 10 steps of 0.1 s, psi_des constant over the horizon, CasADi nlpsol with IPOPT. Position does not enter:
x = [psi u v r]. Source: section 5.1 of the paper. Its choices that it does not print are assumed: multiple
shooting, Runge-Kutta of order 4, IPOPT's default settings, and the last solution as the next first guess.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from companion.core.control.ocp import Ocp
from companion.core.model.integrate import rk4
from sim.fitting.taylor.abkowitz import KGF_N, AbkowitzModel


@dataclass(frozen=True)
class PaperSettings:
    """Section 5.1: weights, horizon, references, thrust limits [kgf]. `applied`: actions used of each plan."""

    s_u: float = 2.0
    s_psi: float = 1.0
    s_v: float = 1.0
    s_c: float = 0.001
    stages: int = 10
    step_s: float = 0.1
    u_des_m_s: float = 0.5
    v_des_m_s: float = 0.0
    c_min_kgf: float = -4.0793
    c_max_kgf: float = 5.1536
    applied: int = 1


PAPER = PaperSettings()
"""The preset."""


def paper_ocp(model: AbkowitzModel, s: PaperSettings = PAPER) -> Ocp:
    """The same problem as expressions of one stage, for the real-time iteration; p = psi_des [rad]."""
    nu = model.B.shape[1]
    x, c, psi_des = ca.SX.sym("x", 4), ca.SX.sym("c", nu), ca.SX.sym("psi_des")
    following = ca.cse(paper_advance(model, x, c, s.step_s))
    weighted = [(s.s_u, x[1] - s.u_des_m_s), (s.s_psi, x[0] - psi_des), (s.s_v, x[2] - s.v_des_m_s), (s.s_c, c)]
    return Ocp(
        s.stages, x, c, psi_des, ca.SX.sym("q", 0),
        following=following,
        jacobian=ca.jacobian(following, ca.vertcat(x, c)),
        residual=ca.vertcat(*(np.sqrt(weight) * residual for weight, residual in weighted)),
        last=ca.SX(1, 1),
        c_min=np.full(nu, s.c_min_kgf),
        c_max=np.full(nu, s.c_max_kgf),
        scale=np.ones(4),
    )  # fmt: skip


def paper_advance(model: AbkowitzModel, x: ca.SX, c: ca.SX, h: float) -> ca.SX:
    """[psi u v r] after `h` seconds of thrust c [kgf], without lag, as in the paper."""
    tau = ca.mtimes(ca.DM(model.B), c) * KGF_N
    return rk4(lambda y: ca.vertcat(y[3], model.nu_dot(None, y[1:4], tau)), x, h)
