"""The paper's 23-term Taylor (Abkowitz) model, with the interface of a vessel model.

    nu_dot = C phi(Delta u, v, r, t_x, t_y, t_n),  Delta u = u - 0.5          equation (4), Table 2

It is a reference to compare the paper with, not a simulator. Simulated with the printed coefficients:

- C_0 = 0: with zero thrust 0.5 m/s is an equilibrium; from rest with zero thrust the boat accelerates by itself,
  0.30 m/s after 5 s.
- Sway is unstable below 0.41 m/s. Constant thrust of 2 kgf diverges within 73 s, full thrust within 10 s,
  a moment of 0.3 kgf m within 66 s, and 94 % of runs of 60 s with random constant thrust within the limits.
- C_y = 0: sway force has no effect (no sway data was in the fit).

So `sim/studies/paper/validity.py` says where its own series still is one.
Units: t is in kgf and kgf m (the paper's thrust limits are kgf of the T200 at 16 V; C_x would mean 112 kg of
surge inertia were t in N, and 1.1 t in kgf: the paper does not settle it). The interface here takes N, N m.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from companion.core.constants import GRAVITY_M_S2
from sim.fitting.taylor import abkowitz_table as table

KGF_N = GRAVITY_M_S2
"""One kilogram-force [N], by definition."""

C = np.array([table.SURGE, table.SWAY, table.YAW])
"""Coefficients, shape (3, 23)."""


def regressor(nu: Any, t: Any) -> list[Any]:
    """phi, the 23 terms of equation (4); nu [m/s, m/s, rad/s], t = [t_x, t_y, t_n] [kgf, kgf, kgf m]."""
    du, v, r = nu[0] - table.NOMINAL_U_M_S, nu[1], nu[2]
    return [
        1.0, du, v, r, du**2, v**2, r**2, du * v, du * r, v * r, du**3, v**3, r**3, du**2 * v, du**2 * r,
        v**2 * du, v**2 * r, r**2 * du, r**2 * v, du * v * r, t[0], t[1], t[2],
    ]  # fmt: skip


@dataclass(frozen=True)
class AbkowitzModel:
    """The series as a vessel model. `coefficients` (3, 23): those of Table 2, or of another fit of the same terms.

    B (3, n) and the lag come from a vessel file: the paper gives neither the thrusters' places nor their dynamics.
    """

    B: np.ndarray
    lag_s: float
    coefficients: np.ndarray = field(default_factory=C.copy)
    slew_N_s: float | None = None
    is_linear_in_f: bool = field(default=True, init=False)
    actuators: None = field(default=None, init=False)

    def thrust(self, eta: Any, nu: Any, f: Any) -> Any:
        """tau = B f, shape (3,) [N, N, N m]."""
        del eta, nu
        return ca.mtimes(ca.DM(self.B), f)

    def nu_dot(self, eta: Any, nu: Any, tau: Any) -> Any:
        """Acceleration, shape (3,) [m/s^2, m/s^2, rad/s^2], from tau in N, N, N m."""
        del eta  # calm water: the pose does not matter
        phi = ca.vertcat(*regressor(nu, [tau[i] / KGF_N for i in range(3)]))
        return ca.mtimes(ca.DM(self.coefficients), phi)
