"""The motion that the commanded thrust makes of the model alone: a witness for heading, yaw rate and course.

    u, v      from model(eta, [u v r_filter], B f)        r        from model(eta, [u v]_filter and r, B f)

Each takes from the filter what it is no witness of: left to itself a slender hull turns broadside (Munk moment). Water
and wind are as the vessel file has them. One Runge-Kutta step a tick.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.estimation.filter_state import ETA, NU, FilterState
from companion.core.model.integrate import BufferedStep, rk4
from companion.core.model.manoeuvring import StructuredModel

AT_REST = (0.0, 0.0, 0.0)


class ModelMotion:
    """Constant parts for one vessel and period [s]."""

    def __init__(self, vessel: VesselFile, period_s: float):
        model = StructuredModel.of(vessel)
        eta, nu, f = ca.SX.sym("eta", 3), ca.SX.sym("nu", 3), ca.SX.sym("f", len(vessel.controls))
        after = rk4(lambda v: model.nu_dot(eta, v, model.thrust(eta, v, f)), nu, period_s)
        self._step = BufferedStep(ca.Function("motion", [eta, nu, f], [ca.densify(after)]))

    def step(
        self, nu: tuple[float, float, float], belief: FilterState | None, anew: bool = False
    ) -> tuple[float, float, float]:
        """[u v r] a period later, under the forces that the filter knows; at rest before it runs; `anew`: from what the
        filter has, for the forces known until now were wrong.
        """
        if belief is None:
            return AT_REST
        if anew:
            u, v, r = belief.x[NU].tolist()
            return u, v, r
        eta, filtered, f_n = belief.x[ETA], belief.x[NU], belief.f_n
        u, v, _ = self._step(eta, np.array([nu[0], nu[1], filtered[2]]), f_n).tolist()
        r = float(self._step(eta, np.array([filtered[0], filtered[1], nu[2]]), f_n)[2])
        return (u, v, r) if abs(u) + abs(v) + abs(r) < 1e3 else AT_REST
