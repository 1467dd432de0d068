"""An optimal control problem with limits on its controls, as expressions of one stage.

    min  sum_{k<N} |residual(x_k, c_k, p_k, q)|^2 + |last(x_N, p_N, q)|^2
    s.t. x_{k+1} = F(x_k, c_k, p_k, q),  c_min <= c_k <= c_max,  |c_k - f_k| <= rate_n

f: the states that follow the controls (forces, angles of servos), for the rate limit (ADR 5). The production
problem and the paper's are of this form; the real-time iteration (`rti`) solves it. Scheme: Diehl, Bock, Schloeder
(2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class Ocp:
    """Symbols x (nx,), c (nu,), p (of each stage) and q (constant over the horizon), expressions, limits.

    `following`: F; `jacobian`: dF/d[x c], shape (nx, nx + nu). `forces`: index of the first of the nu states f, or None
    where there is no rate limit. `rate_n` [unit of c]: one number, or (nu,). `scale` (nx,): gaps of equal importance,
    in the unit of each state.
    """

    stages: int
    x: ca.SX
    c: ca.SX
    p: ca.SX
    q: ca.SX
    following: ca.SX
    jacobian: ca.SX
    residual: ca.SX
    last: ca.SX
    c_min: np.ndarray
    c_max: np.ndarray
    scale: np.ndarray
    forces: int | None = None
    rate_n: float | np.ndarray = np.inf

    @property
    def rate(self) -> float | ca.DM:
        """`rate_n` for expressions."""
        return ca.DM(self.rate_n) if isinstance(self.rate_n, np.ndarray) else self.rate_n

    @property
    def nx(self) -> int:
        """Number of states."""
        return self.x.numel()

    @property
    def nu(self) -> int:
        """Number of controls."""
        return self.c.numel()
