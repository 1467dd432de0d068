"""Maximum a posteriori estimate of nodes and parameters with a set of active effects.

The fit minimises over nodes z (W, L) and parameters theta (P,) of the free effects

    1/2 |r(z, theta)|^2 (data, Huber on fixes) + 1/2 |rho / sigma_tie|^2 (continuity of windows) + priors   [nats]

Every parameter has a normal prior: wide where its effect is active, else its tolerance band round zero, so that many
tiny imperfections do not add up to a false cause.

An effect that multiplies readings by 1 + p scales the residuals' Jacobian by 1 + p as well, so that the determinant of
the nodes' Hessian grows by (1 + p)^(2 n), where n is the number of the nodes' degrees of freedom that these readings
determine (trace of P_w F_w: covariance times information). Its half, n log(1 + p), is part of the parameters' cost;
without it p is biased upwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.evidence import Prior, ReducedNormalEquations
from sim.fitting.diagnose.posterior.linear import LinearisationPoint, Lineariser
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues
from sim.fitting.diagnose.posterior.physics import PUSHES, EffectPhysics
from sim.fitting.diagnose.posterior.state import WindowTrajectories
from sim.fitting.engine.block_tridiagonal import Chain
from sim.fitting.engine.initial_guess import initial_nodes
from sim.fitting.engine.noise import LATENT, STATE, Noise

NEAR = 300.0  # predicted decrease [nats] below which only the active effects' columns are computed anew
PINNED = 1e6  # stiffness over its own curvature that holds a parameter at its limit


class PosteriorFit:
    """Gauss-Newton fits of the windows of `physics` with the catalogue `effects`; `noise` is the present noise card.

    `z0` (W, L): initial guess of the nodes; `degrees_of_freedom`: n by scaled reading, see the module.
    """

    def __init__(self, physics: EffectPhysics, effects: Sequence[Effect], noise: Noise):
        self.physics, self.effects, self.noise = physics, tuple(effects), noise
        self.lineariser = Lineariser(physics)
        self.z0 = initial_nodes(physics.windows, physics.parameters)
        self._first = np.flatnonzero(physics.windows.first)
        self.degrees_of_freedom: dict[str, float] = {}

    def prior(self, free: Sequence[Effect], active: frozenset[str]) -> Prior:
        """Prior of the parameters of `free`: wide for `active` ids, tolerance bands round zero for the others."""
        each = [e.wide_prior() if e.id in active else (e.tolerance(), np.zeros(len(e.parameters))) for e in free]
        return Prior(*(np.concatenate(one) for one in zip(*each, strict=True)))

    def point(
        self, theta: ParameterValues, z: np.ndarray, free: Sequence[Effect], before: LinearisationPoint | None = None
    ) -> LinearisationPoint:
        """Normal equations at (theta, z) with columns of `free`; `before`: a nearby point, where the motion starts."""
        state = self.physics.move(self.effects, theta, z, before.state if before else None)
        return self.lineariser.point(self.effects, theta, z, self.noise, free, state)

    def assembled(self, point: LinearisationPoint, noise: Noise) -> tuple[Chain, float, float]:
        """Chain of data, ties, node priors at `noise`; its cost without parameter priors [nats]; sum of log sigma."""
        chain = point.chain.copy()
        sigma = noise.tie(point.ties.span_s)[1]
        chain.add_ties(point.ties, sigma)
        start = noise.node_start()
        chain.A[self._first] += np.diag(1 / start**2)
        chain.g[self._first] += self._off(point.z) / start**2
        return chain, self.nodes_cost(point, noise), float(np.log(sigma).sum() + len(self._first) * np.log(start).sum())

    def nodes_cost(self, point: LinearisationPoint, noise: Noise) -> float:
        """Data, ties and node priors at `noise`, without parameter priors [nats]."""
        sigma, start = noise.tie(point.ties.span_s)[1], noise.node_start()
        return point.cost + self._prior_cost(point.ties.rho, sigma, self._off(point.z), start)

    def cost(self, point: LinearisationPoint, free: Sequence[Effect], prior: Prior) -> float:
        """The objective at `point` [nats]: data, ties, priors of nodes and parameters."""
        return self.nodes_cost(point, self.noise) + self._priors(point.theta, free, prior)[0]

    def _off(self, z: np.ndarray) -> np.ndarray:
        off = z[self._first].copy()
        off[:, STATE] -= self.z0[self._first, STATE]
        return off

    def _prior_cost(self, rho: np.ndarray, sigma: np.ndarray, off: np.ndarray, start: np.ndarray) -> float:
        return 0.5 * float(((rho / sigma) ** 2).sum() + ((off / start) ** 2).sum())

    def count_degrees_of_freedom(self, point: LinearisationPoint) -> None:
        """Set `degrees_of_freedom` at `point`: by kind of reading the sum over windows w of trace(P_w F_w)."""
        P = self.assembled(point, self.noise)[0].covariance()
        self.degrees_of_freedom = {name: float((P * share).sum()) for name, share in point.shares.items()}

    def _priors(self, theta: ParameterValues, free: Sequence[Effect], prior: Prior) -> tuple[float, np.ndarray]:
        """Parameter cost [nats], priors plus n log(1 + p) of scaled readings, and its gradient (P,)."""
        now = stack_parameters(theta, free)
        scaled, slope = self._scales(now, free)
        return prior.cost(now) + scaled, prior.slope(now) + slope

    def _scales(self, now: np.ndarray, free: Sequence[Effect]) -> tuple[float, np.ndarray]:
        """Sum of n log(1 + p) over effects that scale readings (one parameter each) [nats], and its gradient (P,)."""
        n = np.concatenate(
            [np.full(len(e.parameters), self.degrees_of_freedom.get(e.scaled_reading, 0.0)) for e in free]
        )
        return float(n @ np.log1p(np.where(n > 0, now, 0.0))), n / (1 + np.where(n > 0, now, 0.0))

    def nodes_evidence(self, point: LinearisationPoint, noise: Noise) -> float:
        """Log evidence of `noise` with the nodes eliminated and all parameters fixed [nats]."""
        return self.node_step(point, noise)[1]

    def node_step(self, point: LinearisationPoint, noise: Noise) -> tuple[np.ndarray, float]:
        """Gauss-Newton step of the nodes (W, L) with fixed parameters, and `nodes_evidence` [nats]."""
        chain = point.chain
        bare = Chain(chain.A, chain.next, chain.B[:, :, :0], chain.D[:0, :0], chain.g, chain.d[:0])
        ties = replace(point.ties, G=point.ties.G[:, :, :0])
        chain, cost, log_sigma = self.assembled(replace(point, chain=bare, ties=ties), noise)
        dz, log_det = chain.solve_nodes()
        return dz, -0.5 * float((chain.g * dz).sum()) - cost - 0.5 * log_det - log_sigma

    def reduced(
        self, point: LinearisationPoint, free: Sequence[Effect], noise: Noise | None = None
    ) -> ReducedNormalEquations:
        """Normal equations of the parameters of `free` at `point`, nodes eliminated; `noise`: default the fit's."""
        chain, cost, log_sigma = self.assembled(point, noise or self.noise)
        guard = self.prior(free, frozenset()).precision  # regularises the elimination; taken off again below
        chain.D += np.diag(guard)
        dz, dw, D, log_det = chain.solve()
        decrease = -0.5 * float((chain.g * dz).sum() + chain.d @ dw)
        b = D @ dw
        nodes = decrease - 0.5 * float(b @ dw)
        now = stack_parameters(point.theta, free)
        scaled, slope = self._scales(now, free)
        constant = nodes - cost - 0.5 * log_det - log_sigma - scaled
        return ReducedNormalEquations(D - np.diag(guard), b - slope, now, constant)

    def solve(
        self,
        theta: ParameterValues,
        z: np.ndarray,
        free: Sequence[Effect],
        active: frozenset[str],
        *,
        steps: int = 12,
        tolerance: float = 0.3,
        before: LinearisationPoint | None = None,
    ) -> LinearisationPoint:
        """Gauss-Newton from (theta, z), at most `steps` steps, until the predicted decrease is below `tolerance`."""
        return self.descend(theta, z, free, active, steps=steps, tolerance=tolerance, before=before)[0]

    def descend(
        self,
        theta: ParameterValues,
        z: np.ndarray,
        free: Sequence[Effect],
        active: frozenset[str],
        *,
        steps: int,
        tolerance: float,
        before: LinearisationPoint | None = None,
    ) -> tuple[LinearisationPoint, bool]:
        """As `solve`, and whether it converged: predicted decrease of the last step below `tolerance` [nats]."""
        prior = self.prior(free, active)
        lower, upper = (np.concatenate(each) for each in zip(*(e.limits() for e in free), strict=True))
        point, predicted = self.point(theta, z, free, before), np.inf
        for _ in range(steps):
            point, predicted = self._step(point, free, active, prior, (lower, upper))
            if predicted < tolerance:
                break
        return point, predicted < tolerance

    def _step(
        self,
        point: LinearisationPoint,
        free: Sequence[Effect],
        active: frozenset[str],
        prior: Prior,
        limits: tuple[np.ndarray, np.ndarray],
    ) -> tuple[LinearisationPoint, float]:
        """One damped Gauss-Newton step: the next point, and the predicted decrease of the objective [nats].

        1. Normal equations with the parameters' prior.  2. Bounded step.  3. Motion at the trial point.
        4. Accepted if the objective falls, else more Levenberg-Marquardt damping, at most six times.
        """
        now = stack_parameters(point.theta, free)
        plain, cost, _ = self.assembled(point, self.noise)
        priors, slope = self._priors(point.theta, free, prior)
        plain.D += np.diag(prior.precision)
        plain.d += slope
        cost += priors
        damping = 0.0
        for _ in range(6):
            chain = plain.damped(damping / self.noise.node_start() ** 2, damping * prior.precision)
            dz, dw, predicted = _bounded(chain, now, limits)
            if not predicted >= 1e-3:  # converged, or NaN: the motion diverged
                return point, 0.0
            theta = unstack_parameters(np.clip(now + dw, *limits), free)
            with np.errstate(all="ignore"):
                state = self._moved(theta, point.z + dz, free, active, point)
                after = self._total(theta, point.z + dz, free, prior, point, state)
            if after < cost:
                z, columns = point.z + dz, None
                if predicted < NEAR:
                    refreshed_effects = [e for e in free if e.id in active]
                    columns = self.lineariser.refreshed(
                        point.columns, self.effects, theta, state, free, refreshed_effects
                    )
                return self.lineariser.point(self.effects, theta, z, self.noise, free, state, columns), predicted
            damping = max(10 * damping, 1.0)
        return point, 0.0

    def _moved(
        self,
        theta: ParameterValues,
        z: np.ndarray,
        free: Sequence[Effect],
        active: frozenset[str],
        near: LinearisationPoint,
    ) -> WindowTrajectories:
        """Trajectories at (theta, z): exact for active, hull and nameable effects, the others by the columns of `near`.

        The accelerations of the others are those in the state of `near` plus columns times their change of parameters.
        """
        size = {e.id: max(e.size(t[e.id]) for t in (theta, near.theta) if e.id in t) for e in free if e.id in theta}
        exact = [e for e in free if e.id in active or "hull" in e.hooks or size.get(e.id, 0.0) >= 1]
        if any(not PUSHES.isdisjoint(e.hooks) for e in exact):  # these forces may depend on the whole water velocity
            exact += [e for e in free if "water" in e.hooks and e not in exact]
        ids = {e.id for e in exact}
        small = [{i: values for i, values in t.items() if i not in ids} for t in (theta, near.theta)]
        d = near.z[:, LATENT]
        before = self.physics.remainder(exact, near.theta, near.state, d)
        imposed = before.plus(near.columns.a.times(stack_parameters(small[0], free) - stack_parameters(small[1], free)))
        return self.physics.move(exact, theta, z, near.state, imposed, near.state.feedback)

    def _total(
        self,
        theta: ParameterValues,
        z: np.ndarray,
        free: Sequence[Effect],
        prior: Prior,
        near: LinearisationPoint,
        state: WindowTrajectories,
    ) -> float:
        """The objective [nats] at a trial point (theta, z) near `near`, where the boat moves as in `state`."""
        data, rho = self.lineariser.cost(self.effects, theta, z, self.noise, state)
        ties = self.noise.tie(near.ties.span_s)[1]
        nodes = self._prior_cost(rho, ties, self._off(z), self.noise.node_start())
        return data + nodes + self._priors(theta, free, prior)[0]


def _bounded(
    chain: Chain, now: np.ndarray, limits: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, float]:
    """Steps of nodes and parameters within the parameters' limits, and the predicted decrease [nats].

    A parameter that would leave its limits is pinned at the limit by a stiff spring and the system solved again.
    """
    plain, pinned = chain, np.zeros(len(now), dtype=bool)
    for _ in range(4):
        dz, dw, _, _ = chain.solve()
        out = (now + dw < limits[0] - 1e-12) | (now + dw > limits[1] + 1e-12)
        if not (out & ~pinned).any():
            break
        pinned |= out
        stiff = np.where(pinned, PINNED * np.maximum(np.diag(plain.D), 1.0), 0.0)
        pulled = plain.d - stiff * (np.clip(now + dw, *limits) - now)
        chain = replace(plain, D=plain.D + np.diag(stiff), d=pulled)
    predicted = -float((plain.g * dz).sum() + plain.d @ dw)
    return dz, dw, predicted / 2


def stack_parameters(theta: ParameterValues, free: Sequence[Effect]) -> np.ndarray:
    """Stacked parameters (P,) of the effects `free`; zeros where theta has none."""
    return np.concatenate([theta.get(e.id, np.zeros(len(e.parameters))) for e in free])


def unstack_parameters(values: np.ndarray, free: Sequence[Effect]) -> dict[str, np.ndarray]:
    """By effect id, the parameters in a stacked vector `values` (P,)."""
    theta, at = {}, 0
    for e in free:
        theta[e.id] = values[at : at + len(e.parameters)]
        at += len(e.parameters)
    return theta
