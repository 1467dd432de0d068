"""Maximum a posteriori of nodes and parameters with some effects believed in.

Every parameter of the catalogue has a normal prior round nil: wide where its effect is believed in, else its tolerance
band, half the smallest size worth a name, so that many tiny imperfections do not add up to a false one. What the logs
say of the others beside them: evidence.

An effect that multiplies readings by 1 + p makes the world look smaller the larger p is, and in a small world all
that nodes do costs less. The determinant of the nodes' block makes up for it: it has n log(1 + p) more, n being how
many of the nodes' degrees of freedom these readings settle. Without that term p comes out too large.
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

NEAR = 300.0  # nats: a step that promises less is so short that secants of all but the believed effects stay
PINNED = 1e6  # times its own curvature: a parameter that is held at a limit


class PosteriorFit:
    """The logs, the catalogue, and steps towards the best nodes and parameters."""

    def __init__(self, physics: EffectPhysics, effects: Sequence[Effect], noise: Noise):
        self.physics, self.effects, self.noise = physics, tuple(effects), noise
        self.lineariser = Lineariser(physics)
        self.z0 = initial_nodes(physics.windows, physics.parameters)
        self._first = np.flatnonzero(physics.windows.first)
        self.degrees_of_freedom: dict[str, float] = {}

    def prior(self, free: Sequence[Effect], active: frozenset[str]) -> Prior:
        """Of the parameters of `free`: tolerance bands round nil of what is not believed in."""
        each = [e.wide_prior() if e.id in active else (e.tolerance(), np.zeros(len(e.parameters))) for e in free]
        return Prior(*(np.concatenate(one) for one in zip(*each, strict=True)))

    def point(
        self, theta: ParameterValues, z: np.ndarray, free: Sequence[Effect], before: LinearisationPoint | None = None
    ) -> LinearisationPoint:
        """Linearised at theta, z; `before`: a point near it."""
        state = self.physics.move(self.effects, theta, z, before.state if before else None)
        return self.lineariser.point(self.effects, theta, z, self.noise, free, state)

    def assembled(self, point: LinearisationPoint, noise: Noise) -> tuple[Chain, float, float]:
        """Chain with ties and node priors, its cost [nats] without priors of parameters, sum of log sigma."""
        chain = point.chain.copy()
        sigma = noise.tie(point.ties.span_s)[1]
        chain.add_ties(point.ties, sigma)
        start = noise.node_start()
        off = self._off(point.z)
        chain.A[self._first] += np.diag(1 / start**2)
        chain.g[self._first] += off / start**2
        cost = point.cost + self._prior_cost(point.ties.rho, sigma, off, start)
        return chain, cost, float(np.log(sigma).sum() + len(self._first) * np.log(start).sum())

    def cost(self, point: LinearisationPoint, free: Sequence[Effect], prior: Prior) -> float:
        """What a fit makes least [nats]: data, ties, priors of nodes and parameters."""
        _, cost, _ = self.assembled(point, self.noise)
        return cost + self._priors(point.theta, free, prior)[0]

    def _off(self, z: np.ndarray) -> np.ndarray:
        off = z[self._first].copy()
        off[:, STATE] -= self.z0[self._first, STATE]
        return off

    def _prior_cost(self, rho: np.ndarray, sigma: np.ndarray, off: np.ndarray, start: np.ndarray) -> float:
        return 0.5 * float(((rho / sigma) ** 2).sum() + ((off / start) ** 2).sum())

    def count_degrees_of_freedom(self, point: LinearisationPoint) -> None:
        """How many degrees of freedom of the nodes each kind of reading settles: trace of P_w F_w over all nodes."""
        P = self.assembled(point, self.noise)[0].covariance()
        self.degrees_of_freedom = {name: float((P * share).sum()) for name, share in point.shares.items()}

    def _priors(self, theta: ParameterValues, free: Sequence[Effect], prior: Prior) -> tuple[float, np.ndarray]:
        """What the parameters cost by their priors and by n log(1 + p) of those that scale [nats]; its slope (P,)."""
        now = stack_parameters(theta, free)
        scaled, slope = self._scales(now, free)
        return prior.cost(now) + scaled, prior.slope(now) + slope

    def _scales(self, now: np.ndarray, free: Sequence[Effect]) -> tuple[float, np.ndarray]:
        """n log(1 + p) of all effects that scale readings [nats], and its slope (P,). They have one parameter each."""
        n = np.concatenate(
            [np.full(len(e.parameters), self.degrees_of_freedom.get(e.scaled_reading, 0.0)) for e in free]
        )
        return float(n @ np.log1p(np.where(n > 0, now, 0.0))), n / (1 + np.where(n > 0, now, 0.0))

    def nodes_evidence(self, point: LinearisationPoint, noise: Noise) -> float:
        """Log evidence [nats] of `noise` for the nodes alone, all parameters being as they are."""
        return self.node_step(point, noise)[1]

    def node_step(self, point: LinearisationPoint, noise: Noise) -> tuple[np.ndarray, float]:
        """Step of the nodes (W, L) with all parameters as they are, and the log evidence of `noise` for them [nats]."""
        chain = point.chain
        bare = Chain(chain.A, chain.next, chain.B[:, :, :0], chain.D[:0, :0], chain.g, chain.d[:0])
        ties = replace(point.ties, G=point.ties.G[:, :, :0])
        chain, cost, log_sigma = self.assembled(replace(point, chain=bare, ties=ties), noise)
        dz, log_det = chain.solve_nodes()
        return dz, -0.5 * float((chain.g * dz).sum()) - cost - 0.5 * log_det - log_sigma

    def reduced(
        self, point: LinearisationPoint, free: Sequence[Effect], noise: Noise | None = None
    ) -> ReducedNormalEquations:
        """Nodes eliminated."""
        chain, cost, log_sigma = self.assembled(point, noise or self.noise)
        guard = self.prior(free, frozenset()).precision
        chain.D += np.diag(guard)
        dz, dw, D, log_det = chain.solve()
        promised = -0.5 * float((chain.g * dz).sum() + chain.d @ dw)
        b = D @ dw
        nodes = promised - 0.5 * float(b @ dw)
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
        """Gauss-Newton from theta, z with the parameters of `free` free. Stops at steps that promise little."""
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
        """As `solve`, and whether the last step promised less than `tolerance` [nats]."""
        prior = self.prior(free, active)
        lower, upper = (np.concatenate(each) for each in zip(*(e.limits() for e in free), strict=True))
        point, promised = self.point(theta, z, free, before), np.inf
        for _ in range(steps):
            point, promised = self._step(point, free, active, prior, (lower, upper))
            if promised < tolerance:
                break
        return point, promised < tolerance

    def _step(
        self,
        point: LinearisationPoint,
        free: Sequence[Effect],
        active: frozenset[str],
        prior: Prior,
        limits: tuple[np.ndarray, np.ndarray],
    ) -> tuple[LinearisationPoint, float]:
        now = stack_parameters(point.theta, free)
        plain, cost, _ = self.assembled(point, self.noise)
        priors, slope = self._priors(point.theta, free, prior)
        plain.D += np.diag(prior.precision)
        plain.d += slope
        cost += priors
        damping = 0.0
        for _ in range(6):
            chain = plain.damped(damping / self.noise.node_start() ** 2, damping * prior.precision)
            dz, dw, promised = _bounded(chain, now, limits)
            if not promised >= 1e-3:  # or NaN: the motion was thrown out of bounds
                return point, 0.0
            theta = unstack_parameters(np.clip(now + dw, *limits), free)
            with np.errstate(all="ignore"):
                state = self._moved(theta, point.z + dz, free, active, point)
                after = self._total(theta, point.z + dz, free, prior, point, state)
            if after < cost:
                z, columns = point.z + dz, None
                if promised < NEAR:
                    anew = [e for e in free if e.id in active]
                    columns = self.lineariser.refreshed(point.columns, self.effects, theta, state, free, anew)
                return self.lineariser.point(self.effects, theta, z, self.noise, free, state, columns), promised
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
        """The motion at theta, z: small effects that are not believed in by the secants of a point near it."""
        size = {e.id: max(e.size(t[e.id]) for t in (theta, near.theta) if e.id in t) for e in free if e.id in theta}
        lively = [e for e in free if e.id in active or "hull" in e.hooks or size.get(e.id, 0.0) >= 1]
        if any(not PUSHES.isdisjoint(e.hooks) for e in lively):  # they may go by the motion through all of the water
            lively += [e for e in free if "water" in e.hooks and e not in lively]
        ids = {e.id for e in lively}
        small = [{i: values for i, values in t.items() if i not in ids} for t in (theta, near.theta)]
        d = near.z[:, LATENT]
        before = self.physics.remainder(lively, near.theta, near.state, d)
        given = before.plus(near.columns.a.times(stack_parameters(small[0], free) - stack_parameters(small[1], free)))
        return self.physics.move(lively, theta, z, near.state, given, near.state.feedback)

    def _total(
        self,
        theta: ParameterValues,
        z: np.ndarray,
        free: Sequence[Effect],
        prior: Prior,
        near: LinearisationPoint,
        state: WindowTrajectories,
    ) -> float:
        data, rho = self.lineariser.cost(self.effects, theta, z, self.noise, state)
        ties = self.noise.tie(near.ties.span_s)[1]
        nodes = self._prior_cost(rho, ties, self._off(z), self.noise.node_start())
        return data + nodes + self._priors(theta, free, prior)[0]


def _bounded(
    chain: Chain, now: np.ndarray, limits: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, float]:
    """Step that keeps parameters within limits: what would leave them is pinned there; and what it promises [nats]."""
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
    promised = -float((plain.g * dz).sum() + plain.d @ dw)
    return dz, dw, promised / 2


def stack_parameters(theta: ParameterValues, free: Sequence[Effect]) -> np.ndarray:
    """Parameters of `free` one after the other, (P,)."""
    return np.concatenate([theta.get(e.id, np.zeros(len(e.parameters))) for e in free])


def unstack_parameters(values: np.ndarray, free: Sequence[Effect]) -> dict[str, np.ndarray]:
    """The other way round; parameters that are all nil are left out."""
    theta, at = {}, 0
    for e in free:
        theta[e.id] = values[at : at + len(e.parameters)]
        at += len(e.parameters)
    return theta
