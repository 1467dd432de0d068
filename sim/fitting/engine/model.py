"""The vessel model with its coefficients as symbols, compiled for all windows of a fit at once.

    eta_dot = R(psi) nu,    M nu_dot + C(nu) nu + D(nu) nu = tau + terms,    nu_dot of the fit = that + d

x = [x y psi u v r] in NED and body axes, SI units; tau = B f [N, N, N m]; d (3,): latent acceleration of the window.
Where the file's thrusters lose thrust to moving water, the n forces f [N] follow tau, and B (f_lossy(nu_r) - f) is
added: f' of `companion.core.model.thrust_losses`, with the file's azimuths.
The equations are those of `companion.core.model.manoeuvring` (Fossen), the same as in plant, filter and controller.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.integrate import eta_dot, rk4_step
from companion.core.model.loads import values as load_values
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrust_losses import has_thrust_losses
from sim.fitting.engine.batched import Batch, Rollout
from sim.fitting.engine.free_parameters import PROPULSION, fitted_terms
from sim.fitting.engine.parameters import HULL
from sim.fitting.engine.wind import INPUTS, takes_wind

N_HULL = len(HULL)
TINY = 1e-12


def symbolic_model(
    vessel: VesselFile, q: ca.SX, surroundings: bool = False, wind: ca.SX | None = None
) -> StructuredModel:
    """Model of the vessel file with inertia and damping q[:12] (order of `HULL`) as symbols; fitted terms may follow.

    `wind`: `INPUTS` of the window (`engine.wind`). M fixes only the sum of rigid body and added mass: mass and I_z stay
    as in the file, added mass takes the rest.
    """
    base = StructuredModel.of(vessel)
    i = vessel.inertia
    c: dict[str, Any] = dict(base.c)
    c["X_udot_kg"] = i.mass_kg - q[0]
    c["Y_vdot_kg"] = i.mass_kg - q[1]
    c["N_rdot_kg_m2"] = i.I_z_kg_m2 + i.mass_kg * (i.x_g_m**2 + i.y_g_m**2) - q[2]
    c["Y_rdot_kg_m"] = i.mass_kg * i.x_g_m - q[3]
    c |= {name: q[k] for k, name in enumerate(HULL) if k >= 4}
    terms = {name: dict(values) for name, values in base.term_values.items()}
    free = fitted_terms(vessel) if q.numel() > N_HULL else ()
    for k, (name, p) in enumerate(free, N_HULL):
        (c if name == PROPULSION else terms[name])[p.name] = q[k]
    if surroundings:
        V_c, beta_c = _polar(q[-4], q[-3])
        terms["current"] = load_values("current", {"V_c_m_s": V_c, "beta_c_deg": beta_c})
    if wind is not None and wind.numel():
        comes = wind[:2] + (1 - wind[2]) * q[-2:] if surroundings else wind[:2]
        V_w, beta_w = _polar(comes[0], comes[1])
        steady = {"V_w_m_s": V_w, "beta_w_deg": beta_w, "gustiness": 0.0}
        terms["wind"] = load_values("wind", vessel.terms.get("wind", {})) | steady
    return StructuredModel(vessel, c, terms)


def _polar(north: ca.SX, east: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Size, and direction [deg]; with slopes at nothing, too."""
    north = north + TINY**0.5
    return ca.sqrt(north**2 + east**2 + TINY), ca.atan2(east, north) * (180 / ca.pi)


@dataclass(frozen=True)
class CompiledModel:
    """Compiled functions of one vessel file for `windows` windows of `steps` steps.

    p: inertia, damping and fitted terms, (12 + terms,), in file units, then the window's wind (`wind_inputs`).

    rollout  x0, [p d], pushes at start, middle and end of each step, h -> x after each step, by Runge-Kutta 4
    rates    x, p, push, d -> d(x_dot)/dx (6, 6) and d(nu_dot)/d[p push] (3, p + push), columns stacked; nu_dot
    push     tau (3,), or [tau f] (3 + n,): `push_size`
    """

    rollout: Rollout
    rates: Batch
    steps: int
    windows: int


def push_size(vessel: VesselFile) -> int:
    """Numbers of a push: tau (3), and the n forces f behind it where moving water weakens them."""
    return 3 + len(vessel.thrusters) * has_thrust_losses(vessel)


def body_force(model: StructuredModel, x: ca.SX, push: ca.SX) -> ca.SX:
    """tau (3,) at the state x of a push [tau] or [tau f]: with B (f_lossy(nu_r) - f) added."""
    tau, f = push[:3], push[3:]
    if f.numel():
        tau += model.thrust(x[:3], x[3:], f) - ca.mtimes(ca.DM(model.B), f)
    return tau


def compile_model(vessel: VesselFile, steps: int, windows: int, surroundings: bool = False) -> CompiledModel:
    """Compile both functions for a problem of the given size."""
    fitted = N_HULL + len(fitted_terms(vessel, surroundings))
    size = fitted + INPUTS * takes_wind(vessel, surroundings)
    x, p, d, push = (ca.SX.sym(*s) for s in (("x", 6), ("p", size), ("d", 3), ("push", push_size(vessel))))
    model = symbolic_model(vessel, p[:fitted], surroundings, p[fitted:])
    nu_dot = model.nu_dot(x[:3], x[3:], body_force(model, x, push)) + d
    x_dot = ca.vertcat(eta_dot(x[:3], x[3:]), nu_dot)
    A = ca.densify(ca.vec(ca.jacobian(x_dot, x)))
    G = ca.densify(ca.vec(ca.jacobian(nu_dot, ca.vertcat(p, push))))
    rates = ca.Function("rates", [x, p, push, d], ca.cse([A, G, nu_dot]))
    rate = ca.Function("rate", [x, p, push, d], [x_dot])
    rollout = Rollout(_step(rate, size, push.numel()))
    return CompiledModel(rollout, Batch(rates, windows * (steps + 1)), steps, windows)


def _step(rate: ca.Function, size: int, count: int) -> ca.Function:
    """(x, [p d], [push start, middle, end], h) -> x after h: Runge-Kutta with the force as it is within the step."""
    x, p, pushes, d, h = (ca.SX.sym(*s) for s in (("x", 6), ("p", size), ("pushes", 3 * count), ("d", 3), ("h", 1)))
    start, middle, end = ca.vertsplit(pushes, count)
    x_next: ca.SX = rk4_step(lambda s, push: rate(s, p, push, d), x, h, (start, middle, end))
    return ca.Function("step", [x, ca.vertcat(p, d), pushes, h], ca.cse([x_next]))
