"""The 3-DOF manoeuvring model, written once in CasADi for plant, filter, NMPC and fits.

    M nu_r_dot + C(nu_r) nu_r + D(nu_r) nu_r = tau(nu_r, f) + tau_terms + tau_ext
    nu = nu_r + R(psi)^T V_c,   eta_dot = R(psi) nu

tau = B f of fixed thrusters; other actuators: `actuators`. In body axes (x forward, y starboard, z down) about the body
origin, which need not be the CG. M is symmetric (N_vdot = Y_rdot); C does no work; D + D^T >= 0 is checked on loading:
without thrust, in still water, T = nu^T M nu / 2 can only fall.   Source: Fossen (2011), chapters 6 and 8.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import unrotate
from companion.core.model import loads as term_registry
from companion.core.model.actuators.propulsion import ActuatorSet, channels_of, common, is_steered
from companion.core.model.thrust_losses import apply_thrust_losses, has_thrust_losses
from companion.core.model.thrusters import configuration_matrix

Coefficients = Mapping[str, Any]
NO_LIMIT = 1e9
"""Rate [1/s] of a channel that has no limit, beside others that have one."""


def coefficients(vessel: VesselFile) -> dict[str, float]:
    """Inertia and damping of a vessel file by name; any entry may be replaced by a CasADi symbol."""
    tables = (vessel.inertia, vessel.damping)
    return {k: getattr(t, k) for t in tables for k in t.__struct_fields__ if k != "source"}


def _mass_rows(c: Coefficients) -> list[list[Any]]:
    m, x_g, y_g = c["mass_kg"], c["x_g_m"], c["y_g_m"]
    m13 = -m * y_g
    m23 = m * x_g - c["Y_rdot_kg_m"]
    m33 = c["I_z_kg_m2"] + m * (x_g**2 + y_g**2) - c["N_rdot_kg_m2"]
    return [[m - c["X_udot_kg"], 0.0, m13], [0.0, m - c["Y_vdot_kg"], m23], [m13, m23, m33]]


def mass_matrix(vessel: VesselFile) -> np.ndarray:
    """M = M_RB + M_A about the body origin, shape (3, 3) [kg, kg m, kg m^2]."""
    return np.array(_mass_rows(coefficients(vessel)))


def linear_damping(vessel: VesselFile) -> np.ndarray:
    """D_L, shape (3, 3), positive diagonal."""
    d = vessel.damping
    return -np.array([[d.X_u_N_s_m, 0, 0], [0, d.Y_v_N_s_m, d.Y_r_N_s], [0, d.N_v_N_s, d.N_r_N_m_s]], dtype=float)


def coriolis_force(c: Coefficients, nu: Any) -> Any:
    """C(nu) nu, shape (3,): from the momentum p = M nu; nu^T C nu = 0 for every nu."""
    return ca.vertcat(*_coriolis(ca.mtimes(_matrix(_mass_rows(c)), nu), nu))


def _coriolis(p: Any, nu: Any) -> tuple[Any, Any, Any]:
    return -p[1] * nu[2], p[0] * nu[2], p[1] * nu[0] - p[0] * nu[1]


def inertial_force(M: np.ndarray, nu: Any, nu_dot: Any) -> tuple[Any, Any, Any]:
    """M nu_dot + C(nu) nu of a constant M (3, 3), as its components: numbers, arrays or expressions."""
    p, p_dot = ([sum(m * v for m, v in zip(row, of, strict=True)) for row in M] for of in (nu, nu_dot))
    X, Y, N = _coriolis(p, nu)
    return p_dot[0] + X, p_dot[1] + Y, p_dot[2] + N


def damping_force(c: Coefficients, nu: Any) -> Any:
    """D(nu) nu, shape (3,) [N, N, N m]: linear with yaw-sway coupling, plus quadratic."""
    return -ca.vertcat(*hull_drag(c, nu))


def hull_drag(c: Coefficients, nu: Any) -> tuple[Any, Any, Any]:
    """-D(nu) nu as its components, numbers, arrays or expressions: the force of the water on the hull."""
    u, v, r = nu[0], nu[1], nu[2]
    return (
        c["X_u_N_s_m"] * u + c["X_uu_N_s2_m2"] * abs(u) * u,
        c["Y_v_N_s_m"] * v + c["Y_r_N_s"] * r + c["Y_vv_N_s2_m2"] * abs(v) * v,
        c["N_v_N_s"] * v + c["N_r_N_m_s"] * r + c["N_rr_N_m_s2"] * abs(r) * r,
    )


def _matrix(rows: list[list[Any]]) -> Any:
    """Rows of numbers or symbols as one CasADi matrix."""
    return ca.vertcat(*(ca.horzcat(*row) for row in rows))


@dataclass(frozen=True)
class StructuredModel:
    """The model above for one vessel. `c` and `term_values` may hold symbols where a fit wants them.

    `t_s`: time since the beginning, for water that turns; None, where no clock is known: as at the beginning.
    """

    vessel: VesselFile
    c: Coefficients = field(default_factory=dict)
    term_values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    t_s: Any = None

    @classmethod
    def of(cls, vessel: VesselFile) -> StructuredModel:
        """Model with every number from the vessel file."""
        chosen = {name: term_registry.values(name, given) for name, given in vessel.terms.items()}
        return cls(vessel, coefficients(vessel), chosen)

    @property
    def B(self) -> np.ndarray:
        """Thruster configuration matrix, shape (3, n)."""
        return configuration_matrix(self.vessel)

    @property
    def lag_s(self) -> float | np.ndarray:
        """First-order lag of f [s]: of all channels, or (n,) where they differ."""
        return common([c.lag_s for c in channels_of(self.vessel)])

    @property
    def slew_N_s(self) -> float | np.ndarray | None:
        """How fast f can change at most [N/s, rad/s], of all channels or (n,); None: as fast as the lag lets it."""
        slews = [c.slew for c in channels_of(self.vessel)]
        if not any(slews):
            return None
        return common([NO_LIMIT if slew is None else slew for slew in slews])

    @property
    def is_linear_in_f(self) -> bool:
        """Whether tau = B f: nothing turns, and water that moves past the thrusters does not weaken them."""
        return not (has_thrust_losses(self.vessel) or is_steered(self.vessel))

    @property
    def actuators(self) -> ActuatorSet | None:
        """Its actuators, where any of them is steered."""
        return ActuatorSet.of(self.vessel) if is_steered(self.vessel) else None

    def water_velocity(self, eta: Any) -> Any:
        """nu_c in body axes, shape (3,): the current of the terms."""
        north = east = 0.0
        for name, p in self.term_values.items():
            if flow := term_registry.REGISTRY[name].water_velocity:
                dn, de = flow(p, self.t_s)
                north, east = north + dn, east + de
        return ca.vertcat(*unrotate(eta[2], north, east), 0.0)

    def term_force(self, eta: Any, nu: Any) -> Any:
        """Sum of the terms' body forces, shape (3,) [N, N, N m]."""
        total = ca.vertcat(0.0, 0.0, 0.0)
        for name, p in self.term_values.items():
            if force := term_registry.REGISTRY[name].force:
                total += ca.vertcat(*force(p, self.vessel, eta, nu))
        return total

    def term_hull_force(self, nu_r: Any) -> Any:
        """Sum of the terms' forces of the water on the hull, shape (3,) [N, N, N m]."""
        total = ca.vertcat(0.0, 0.0, 0.0)
        for name, p in self.term_values.items():
            if force := term_registry.REGISTRY[name].hull_force:
                total += ca.vertcat(*force(p, self.vessel, nu_r))
        return total

    def damping(self, eta: Any, nu_r: Any) -> Any:
        """D(nu_r) nu_r here, shape (3,): the file's damping, times the factors of the terms at this place."""
        force = damping_force(self.c, nu_r)
        for name, p in self.term_values.items():
            if factor := term_registry.REGISTRY[name].damping_factor:
                force = factor(p, eta) * force
        return force

    def thrust(self, eta: Any, nu: Any, f: Any) -> Any:
        """tau [N, N, N m] of the actuators' states f (n,) on the boat as it moves; f less `thrust_losses`."""
        if self.is_linear_in_f:
            return ca.mtimes(ca.DM(self.B), f)
        nu_r = nu - self.water_velocity(eta)
        if has_thrust_losses(self.vessel):
            f = apply_thrust_losses(self.vessel, nu_r, f, self.c.get("advance_loss_s_m"))
        if (actuators := self.actuators) is None:
            return ca.mtimes(ca.DM(self.B), f)
        return ca.mtimes(ca.DM(actuators.directions), actuators.components(nu_r, f))

    def nu_dot(self, eta: Any, nu: Any, tau: Any) -> Any:
        """Acceleration of the body velocities over ground, shape (3,) [m/s^2, m/s^2, rad/s^2]."""
        nu_c = self.water_velocity(eta)
        nu_r = nu - nu_c
        hull = self.term_hull_force(nu_r) - coriolis_force(self.c, nu_r) - self.damping(eta, nu_r)
        rhs = tau + self.term_force(eta, nu) + hull
        nu_r_dot = ca.mtimes(ca.inv(_matrix(_mass_rows(self.c))), rhs)
        return nu_r_dot + ca.vertcat(nu[2] * nu_c[1], -nu[2] * nu_c[0], 0.0)
