"""Thrust lost to the water that moves past the thrusters; without it in a file, thrust is B f.

First `effects.wash`, then `effects.advance_loss`. `f` is what the force map and the lag give, `f'` what reaches the
hull. Zero force stays zero.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.effects.advance_loss import advanced
from companion.core.model.effects.wash import jets, washed


def has_thrust_losses(vessel: VesselFile) -> bool:
    """Whether the file has a loss by advance or by wash."""
    p = vessel.propulsion
    return bool(p.advance_loss_s_m or p.advance_loss_sqrt_N_s_m or any(w.share for w in p.wash))


def apply_thrust_losses(vessel: VesselFile, nu_r: Any, f: Any, loss_s_m: Any = None) -> Any:
    """f' (n,) [N] of forces f (n,) at velocity nu_r through the water; CasADi expressions. Angles stay as they are.

    `loss_s_m`: the loss by advance of a file that states one, where a fit looks for it; None: the file's.
    """
    p, n = vessel.propulsion, len(vessel.thrusters)
    k_s_m = p.advance_loss_s_m if loss_s_m is None else loss_s_m
    out = washed([f[i] for i in range(n)], jets(vessel))
    if p.advance_loss_s_m or p.advance_loss_sqrt_N_s_m:
        out = advanced(out, vessel.positions, nu_r, k_s_m, p.advance_loss_sqrt_N_s_m)
    out += [f[i] for i in range(n, len(vessel.controls))]
    return ca.vertcat(*out)
