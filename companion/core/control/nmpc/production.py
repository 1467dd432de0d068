"""The production problem as expressions of one stage: `problem.build` gives the same to IPOPT and hpipm."""

from __future__ import annotations

import casadi as ca
import numpy as np

from companion.core.control.nmpc.effort import control_residual
from companion.core.control.nmpc.settings import Actuation, NmpcSettings
from companion.core.control.nmpc.stage import advance, advance_jacobian, state_residual
from companion.core.control.ocp import Ocp
from companion.core.geometry.fence import Fence
from companion.core.guidance.reference_row import COLUMNS
from companion.core.model.integrate import FORCES, VesselModel


def production(model: VesselModel, actuation: Actuation, s: NmpcSettings, fence: Fence | None = None) -> Ocp:
    """Symbols: x (6 + n,), c (n,), p = row of the reference (8,), q = disturbance (3,)."""
    n = model.B.shape[1]
    levels = fence.levels(ca.fmin) if fence else ()
    x, c = ca.SX.sym("x", 6 + n), ca.SX.sym("c", n)
    row, d = ca.SX.sym("row", len(COLUMNS)), ca.SX.sym("d", 3)
    following = ca.cse(advance(model, x, c, d, s.step_s))
    controls = control_residual(s, model, actuation, x, c, row, d)
    return Ocp(
        s.stages, x, c, row, d,
        following=following,
        jacobian=advance_jacobian(model, x, c, d, s.step_s),
        residual=ca.vertcat(state_residual(s, x, row, levels), controls),
        last=np.sqrt(s.terminal) * state_residual(s, x, row, levels),
        c_min=actuation.force_min_n,
        c_max=actuation.force_max_n,
        scale=np.r_[np.ones(6), np.full(n, actuation.equal_change)],
        forces=FORCES.start,
        rate_n=actuation.rate_limit_n_s * model.lag_s,
    )  # fmt: skip
