"""Residuals of the structured fit and their exact Jacobian by CasADi alone, as one writes them without machine code.

One step of Runge-Kutta propagates the sensitivities S = dx/dv, v = [node; q]:

    S_{k+1} = (dF/dx) S_k + dF/dv,        de/dv = (de/dx) S + (de/dv at fixed x)

all derivatives by `jacobian`. `mapaccum` chains the step over a window, `map` evaluates all windows. Forces come from
`ThrustHistory` with their derivatives by dead time and lag; in v these two are increments on the present values.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from companion.core.geometry.frames import point_acceleration, point_position, point_velocity
from companion.core.model.integrate import eta_dot, rk4_step
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import configuration_matrix
from sim.fitting.engine.linearise import HUBER
from sim.fitting.engine.model import N_HULL, symbolic_model
from sim.fitting.engine.noise import BIAS_AX, BIAS_AY, BIAS_R, LATENT, OFFSET, WANDER, L, Noise
from sim.fitting.engine.parameters import Parameters
from sim.fitting.engine.thrust.fitted import adjustable
from sim.fitting.engine.windows import Windows


@dataclass(frozen=True)
class CasadiBoat:
    """Expressions of one boat. v (L + P,): node, then q. `forces` (3 n,): at a gain of one, by dead time, by lag."""

    parameters: Parameters
    model: StructuredModel
    B: np.ndarray
    v: ca.SX

    @classmethod
    def of(cls, parameters: Parameters) -> CasadiBoat:
        """Raises ValueError for a boat with adjustable pitch."""
        if adjustable(parameters.vessel):
            raise ValueError("the peer knows no adjustable pitch")
        v = ca.SX.sym("v", L + len(parameters.names))
        q = v[L:]
        model = symbolic_model(parameters.vessel, ca.vertcat(q[:N_HULL], q[parameters.terms]))
        return cls(parameters, model, configuration_matrix(parameters.vessel), v)

    @property
    def n(self) -> int:
        """Number of thrusters."""
        return self.B.shape[1]

    def nu_dot(self, x: ca.SX, forces: ca.SX) -> ca.SX:
        """Acceleration, latent one included (3,)."""
        q, n, at = self.v[L:], self.n, self.parameters.thrusters
        f = forces[:n] + forces[n : 2 * n] * q[at.stop] + forces[2 * n :] * q[at.stop + 1]
        return self.model.nu_dot(x[:3], x[3:], self.B @ (q[at] * f)) + self.v[LATENT]

    def step(self, x: ca.SX, forces: ca.SX, h: ca.SX) -> ca.SX:
        """x after h: Runge-Kutta; `forces` at its start, middle and end."""

        def rate(x: ca.SX, forces: ca.SX) -> ca.SX:
            return ca.vertcat(eta_dot(x[:3], x[3:]), self.nu_dot(x, forces))

        start, middle, end = ca.vertsplit(forces, 3 * self.n)
        return rk4_step(rate, x, h, (start, middle, end))

    def imu(self, x: ca.SX, forces: ca.SX, fade: ca.SX, y: ca.SX, noise: Noise) -> ca.SX:
        """Predicted minus measured heading (not yet as innovation), rate and specific force, over their sigmas (4,)."""
        v, nd, r = self.v, self.nu_dot(x, forces), x[5]
        imu = self.parameters.vessel.sensors.imu
        a_x, a_y = point_acceleration(x[3:], nd, (imu.x_m, imu.y_m))
        said = ca.vertcat(x[2] + v[OFFSET] + fade * v[WANDER], r + v[BIAS_R], a_x + v[BIAS_AX], a_y + v[BIAS_AY])
        return (said - y) / ca.DM(noise.white)

    def tag(self, x: ca.SX, forces: ca.SX, since: ca.SX, place: ca.SX, middle: np.ndarray, noise: Noise) -> ca.SX:
        """Predicted minus measured place (2,), as the root of Huber's cost. `since` the step, latency included."""
        q, at = self.v[L:], self.parameters.thrusters.stop + 2
        nd, arm, age = self.nu_dot(x, forces), q[at + 1 : at + 3], since - q[at]
        velocity = ca.vertcat(*point_velocity(x[3:], arm))
        acceleration = ca.vertcat(*point_acceleration(x[3:], nd, arm))
        away = ca.vertcat(*point_position(x[:3], arm + age * velocity + age**2 / 2 * acceleration)) - middle
        e = (away + ca.reshape(q[self.parameters.warp], 2, 2).T @ away + middle - place) / noise.fix_m
        size = ca.sqrt(ca.fmax(ca.sumsqr(e), HUBER**2))
        return e * ca.sqrt(2 * HUBER * size - HUBER**2) / size


@dataclass(frozen=True)
class Chained:
    """Functions of one problem, for all windows and positions at once.

    path   (x0, v, forces, [h fade y]) -> x after each step, e;   whole -> x, S (6 A), e, the cells of de/dv
    fix    (x, v, forces, [since place]) -> e;                    fix_whole: with S after x -> e, de/dv (2 C)

    active  (A,) columns of v that the motion depends on
    cells   row and column of the possible nonzeros of de/dv
    """

    path: ca.Function
    whole: ca.Function
    fix: ca.Function
    fix_whole: ca.Function
    active: np.ndarray
    cells: tuple[np.ndarray, np.ndarray]


def chained(windows: Windows, parameters: Parameters, noise: Noise) -> Chained:
    """Build the functions of a problem. Errors as of `CasadiBoat.of`."""
    boat, (W, K) = CasadiBoat.of(parameters), windows.size
    v, n = boat.v, 3 * boat.n
    x, forces, measured, known = (ca.SX.sym(*s) for s in (("x", 6), ("forces", 3 * n), ("told", 6), ("known", 3)))
    x_next = boat.step(x, forces, measured[0])
    e = boat.imu(x, forces[:n], measured[1], measured[2:], noise)
    at_tag = boat.tag(x, forces[:n], known[0], known[1:], windows.fixes.place_m.mean(axis=0), noise)
    by_v = ca.jacobian(x_next, v)
    active = np.union1d(np.arange(6), np.array(by_v.sparsity().get_col()))
    columns = active.tolist()
    S = ca.SX.sym("S", 6, len(active))

    def carried(of: ca.SX) -> ca.SX:
        """Its derivative to v with x following by S."""
        rows = ca.jacobian(of, v)
        rows[:, columns] += ca.jacobian(of, x) @ S
        return rows

    S_next, rows = ca.densify(ca.jacobian(x_next, x) @ S + by_v[:, columns]), carried(e)
    plain = ca.Function("step", [x, v, forces, measured], ca.cse([x_next, e]))
    whole = ca.Function("step", [x, S, v, forces, measured], ca.cse([x_next, S_next, e, rows.nz[:]]))
    fix = ca.Function("fix", [x, v, forces[:n], known], [at_tag])
    fix_rows = ca.vec(ca.densify(carried(at_tag)))
    fix_whole = ca.Function("fix", [x, ca.vec(S), v, forces[:n], known], ca.cse([at_tag, fix_rows]))
    count, pattern = len(windows.fixes.t_s), rows.sparsity()
    return Chained(
        path=_window(plain, K, None).map(W),
        whole=_window(whole, K, np.eye(6, len(active))).map(W),
        fix=fix.map(count),
        fix_whole=fix_whole.map(count),
        active=active,
        cells=(np.array(pattern.row()), np.array(pattern.get_col())),
    )


def _window(step: ca.Function, K: int, S0: np.ndarray | None) -> ca.Function:
    """K steps of one window from its node, with sensitivities from S0 on where these are asked for."""
    carries = 1 if S0 is None else 2
    x, v = ca.MX.sym("x", 6), ca.MX.sym("v", step.size1_in(carries))
    forces, measured = ca.MX.sym("forces", step.size1_in(carries + 1), K), ca.MX.sym("told", 6, K)
    begin = [x] if S0 is None else [x, ca.DM(S0)]
    found = list(step.mapaccum("window", K, carries)(*begin, ca.repmat(v, 1, K), forces, measured))
    if S0 is not None:
        found[1] = ca.reshape(found[1], S0.size, K)
    return ca.Function("window", [x, v, forces, measured], found)
