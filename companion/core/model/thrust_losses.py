"""Thrust lost to the water that moves past the thrusters; without it in a file, thrust is B f.

    f'_i = (f_i - k s(f_i) u_a,i) prod_j (1 - share_ij p(f_j) / f_max,j)

advance  u_a = (u_r - y r) cos a + (v_r + x r) sin a: speed of thruster i through the water along its azimuth a. With
         f = T_nn n |n| the loss T_nu |n| u_a of Fossen (2011), section 9, is k sqrt|f| u_a. s(f) = f^2 (f^2 + e^2)^-3/4
         is sqrt|f| but smooth, 0 at f = 0; k: `propulsion.advance_loss_sqrt_N_s_m`.
wash     thruster i lies in the jet of j (`propulsion.wash`), which leaves j against its thrust: p(f) = |f| while the
         jet points to i, else 0, smooth; f_max: the larger of j's force limits.

`f` is what the force map and the lag give, `f'` what reaches the hull. Zero force stays zero.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import Thruster, VesselFile

SMOOTH_N = 0.1
"""e: forces below which the root and the jet are rounded off; assumed: small beside any force that moves the boat."""


def has_thrust_losses(vessel: VesselFile) -> bool:
    """Whether the file has a loss by advance or by wash."""
    p = vessel.propulsion
    return p.advance_loss_sqrt_N_s_m != 0.0 or any(w.share for w in p.wash)


def apply_thrust_losses(vessel: VesselFile, nu_r: Any, f: Any) -> Any:
    """f' (n,) [N] of forces f (n,) at velocity nu_r through the water; CasADi expressions. Angles stay as they are."""
    out = [f[i] for i in range(len(vessel.controls))]
    if k := vessel.propulsion.advance_loss_sqrt_N_s_m:
        x, y, a = vessel.positions.T
        for i, force in enumerate(out[: len(x)]):
            u_a = (nu_r[0] - y[i] * nu_r[2]) * np.cos(a[i]) + (nu_r[1] + x[i] * nu_r[2]) * np.sin(a[i])
            out[i] = force - k * force**2 / (force**2 + SMOOTH_N**2) ** 0.75 * u_a
    number = {t.name: i for i, t in enumerate(vessel.thrusters)}
    for wash in vessel.propulsion.wash:
        behind, ahead = number[wash.behind], number[wash.ahead]
        source = vessel.thrusters[ahead]
        z = ca.fmax(jet_sign(source, vessel.thrusters[behind]) * f[ahead], 0.0)
        jet = z**2 / ca.sqrt(z**2 + SMOOTH_N**2)
        out[behind] *= ca.fmax(1 - wash.share * jet / max(source.force_max_N, -source.force_min_N), 0.0)
    return ca.vertcat(*out)


def jet_sign(source: Thruster, target: Thruster) -> int:
    """Sign of the force of `source` whose jet points to `target`: 1 where positive thrust blows at it."""
    a = np.deg2rad(source.azimuth_deg)
    along = (target.x_m - source.x_m) * np.cos(a) + (target.y_m - source.y_m) * np.sin(a)
    return 1 if along <= 0 else -1
