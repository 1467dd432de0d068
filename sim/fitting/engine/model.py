"""The one vessel model with its coefficients as symbols, compiled for whole logs at once.

`rollout` integrates windows side by side; `rates` gives the accelerations and their Jacobians at many instants.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.integrate import eta_dot, rk4_step
from companion.core.model.manoeuvring import StructuredModel
from sim.fitting.engine.batched import Batch, Rollout
from sim.fitting.engine.parameters import HULL, fitted_terms

N_HULL = len(HULL)


def symbolic_model(vessel: VesselFile, q: ca.SX) -> StructuredModel:
    """Model of the vessel file with inertia and damping q[:12] (order of HULL) as symbols; fitted terms may follow.

    Added mass takes up what M says; mass and I_z stay as the file has them, which changes nothing of the motion.
    """
    base = StructuredModel.of(vessel)
    i = vessel.inertia
    c: dict[str, Any] = dict(base.c)
    c["X_udot_kg"] = i.mass_kg - q[0]
    c["Y_vdot_kg"] = i.mass_kg - q[1]
    c["N_rdot_kg_m2"] = i.I_z_kg_m2 + i.mass_kg * (i.x_g_m**2 + i.y_g_m**2) - q[2]
    c["Y_rdot_kg_m"] = i.mass_kg * i.x_g_m - q[3]
    c |= {name: q[k] for k, name in enumerate(HULL) if k >= 4}
    terms = {name: dict(given) for name, given in base.term_values.items()}
    free = fitted_terms(vessel) if q.numel() > N_HULL else ()
    for k, (name, p) in enumerate(free, N_HULL):
        terms[name][p.name] = q[k]
    return StructuredModel(vessel, c, terms)


@dataclass(frozen=True)
class CompiledModel:
    """Functions of one vessel file for windows of `steps` steps, `windows` of them.

    d: latent acceleration (3,) of a window, added to nu_dot.
    rollout  (x0, [p d], tau at start, middle and end of each step, h) -> x after each step
    rates    (x, p, tau, d) -> d(x_dot)/dx (6 x 6, column by column), d(nu_dot)/d[p tau] (3 x (12 + terms + 3)), nu_dot
    """

    rollout: Rollout
    rates: Batch
    steps: int
    windows: int


def compile_model(vessel: VesselFile, steps: int, windows: int) -> CompiledModel:
    """Build both functions for a problem of the given size."""
    size = N_HULL + len(fitted_terms(vessel))
    x, p, tau, d = ca.SX.sym("x", 6), ca.SX.sym("p", size), ca.SX.sym("tau", 3), ca.SX.sym("d", 3)
    model = symbolic_model(vessel, p)
    nu_dot = model.nu_dot(x[:3], x[3:], tau) + d
    x_dot = ca.vertcat(eta_dot(x[:3], x[3:]), nu_dot)
    A = ca.densify(ca.vec(ca.jacobian(x_dot, x)))
    G = ca.densify(ca.vec(ca.jacobian(nu_dot, ca.vertcat(p, tau))))
    rates = ca.Function("rates", [x, p, tau, d], ca.cse([A, G, nu_dot]))
    rate = ca.Function("rate", [x, p, tau, d], [x_dot])
    return CompiledModel(Rollout(_step(rate, size)), Batch(rates, windows * (steps + 1)), steps, windows)


def _step(rate: ca.Function, size: int) -> ca.Function:
    """(x, [p d], [tau start, middle, end], h) -> x after h: Runge-Kutta with the force as it is within the step."""
    x, p, taus, d, h = (ca.SX.sym(*s) for s in (("x", 6), ("p", size), ("taus", 9), ("d", 3), ("h", 1)))
    x_next: ca.SX = rk4_step(lambda s, tau: rate(s, p, tau, d), x, h, (taus[:3], taus[3:6], taus[6:]))
    return ca.Function("step", [x, ca.vertcat(p, d), taus, h], ca.cse([x_next]))
