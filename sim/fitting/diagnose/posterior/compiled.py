"""The vessel model compiled for all windows at once: rollout, state derivative with Jacobians, sensitivities.

    x = [x y psi u v r] (NED position, heading, body velocity),   x_dot = f(x, p, tau, water) + [0 0 0 d]

p (N_HULL,): hull coefficients; tau: body force [N, N, N m]; water (2,): velocity over ground [m/s]; d (3,): latent
acceleration [m/s^2, m/s^2, rad/s^2].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import unrotate
from companion.core.model.integrate import eta_dot, rk4_step
from companion.core.model.manoeuvring import StructuredModel
from sim.fitting.engine.batched import Batch, Rollout
from sim.fitting.engine.model import N_HULL, body_force, push_size, symbolic_model


@dataclass(frozen=True)
class MovingWaterModel(StructuredModel):
    """The model in water that moves over ground with `flow` (north, east) [m/s] on top of the file's current."""

    flow: Any = None

    def water_velocity(self, eta: Any) -> Any:
        """Water velocity of StructuredModel plus R^T(psi) flow, body axes (3,)."""
        return super().water_velocity(eta) + ca.vertcat(*unrotate(eta[2], self.flow[0], self.flow[1]), 0.0)


class CompiledWindows(NamedTuple):
    """Compiled functions.

    rollout   x at all steps of all windows
    rates     at every step A = d(x_dot)/dx (6, 6), M^-1 (3, 3), nu_dot (3,)
    slopes    at every step d(nu_dot)/dp, d(nu_dot)/d(water), d(nu_dot)/df of the thruster forces f appended to tau
    M_inv     M^-1 (3, 3) of coefficients p
    """

    rollout: Rollout
    rates: Batch
    slopes: Batch
    M_inv: ca.Function


def compile_windows(vessel: VesselFile, steps: int, windows: int) -> CompiledWindows:
    """Compile for `windows` windows of `steps` steps each.

    tau is the body force (3,); where the file's thrusters lose thrust to moving water, the n thruster forces f are
    appended, the model adds B (f_lossy(nu_r) - f), and `slopes` has their columns.
    """
    tau = ca.SX.sym("tau", push_size(vessel))
    x, p, d = ca.SX.sym("x", 6), ca.SX.sym("p", N_HULL), ca.SX.sym("d", 3)
    water = ca.SX.sym("water", 2)
    base = symbolic_model(vessel, p)
    model = MovingWaterModel(base.vessel, base.c, base.term_values, flow=water)
    nu_dot = model.nu_dot(x[:3], x[3:], body_force(model, x, tau))
    x_dot = ca.vertcat(eta_dot(x[:3], x[3:]), nu_dot + d)

    def flat(expression: Any) -> ca.SX:
        return ca.densify(ca.vec(expression))

    by_tau = ca.jacobian(nu_dot, tau)
    A, M_inv = flat(ca.jacobian(x_dot, x)), flat(by_tau[:, :3])
    rates = ca.Function("rates", [x, p, tau, water, d], ca.cse([A, M_inv, nu_dot + d]))
    slopes = [flat(ca.jacobian(nu_dot, p)), flat(ca.jacobian(nu_dot, water)), flat(by_tau[:, 3:])]
    slope = ca.Function("slope", [x, p, tau, water], ca.cse(slopes))
    rate = ca.Function("rate", [x, p, tau, water, d], [x_dot])
    nodes = windows * (steps + 1)
    inverse = ca.Function("M_inv", [x, p, tau, water], [by_tau[:, :3]])
    rest = [ca.DM.zeros(s) for s in (tau.numel(), 2)]
    q = ca.SX.sym("q", N_HULL)
    M_inv = ca.Function("M_inv_of", [q], [inverse(ca.DM.zeros(6), q, *rest)])
    return CompiledWindows(Rollout(_step(rate, tau.numel())), Batch(rates, nodes), Batch(slope, nodes), M_inv)


def _step(rate: ca.Function, pushes: int) -> ca.Function:
    """Runge-Kutta 4 step: (x, [p d], [tau at start, middle, end], [water at start, end], h) -> x after h."""
    sizes = (("x", 6), ("p", N_HULL), ("taus", 3 * pushes), ("flow", 4), ("d", 3), ("h", 1))
    x, p, taus, flow, d, h = (ca.SX.sym(*s) for s in sizes)
    start, middle, end = ca.vertsplit(taus, pushes)
    here, there = flow[:2], flow[2:]
    half = (here + there) / 2
    inputs = ((start, here), (middle, half), (end, there))
    x_next: ca.SX = rk4_step(lambda s, tau_water: rate(s, p, *tau_water, d), x, h, inputs)
    return ca.Function("step", [x, ca.vertcat(p, d), taus, flow, h], ca.cse([x_next]))
