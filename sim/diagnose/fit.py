"""Maximum a posteriori of nodes and parameters with some effects believed in, and the evidence for others beside them.

Every parameter of the catalogue has a normal prior round nil: wide where its effect is believed in, else its tolerance
band, half the smallest size worth a name, so that many tiny imperfections do not add up to a false one. One
linearisation with all columns gives, with the nodes eliminated, H and b of all parameters; then the log evidence of any
set m of effects is a matter of a small matrix,

    log p(data | m) = const + 1/2 b^T (H + L_m)^-1 b - 1/2 log det(H + L_m) + 1/2 log det L_m

(L_m: prior precisions), which is exact as far as the logs are linear in the parameters (Laplace).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.diagnose.effect import Effect
from sim.diagnose.linear import Lineariser, Point
from sim.diagnose.physics import Physics, Theta
from sim.identify.structured.chain import Chain
from sim.identify.structured.noise import STATE, Noise
from sim.identify.structured.start import first_nodes

PINNED = 1e6  # times its own curvature: a parameter that is held at a limit


@dataclass(frozen=True)
class Reduced:
    """All parameters with the nodes eliminated: Hessian H (P, P) and b = -gradient (P,) of the data at theta0 (P,).

    `constant`: what the log evidence has beside [nats].
    """

    H: np.ndarray
    b: np.ndarray
    theta0: np.ndarray
    constant: float

    def evidence(self, sigma: np.ndarray) -> float:
        """Log evidence [nats] with prior sigmas (P,)."""
        precision = 1 / sigma**2
        A, b = self.H + np.diag(precision), self.b - precision * self.theta0
        factor = np.linalg.cholesky(A)
        half = np.linalg.solve(factor, b)
        value = self.constant - 0.5 * float(precision @ self.theta0**2) + 0.5 * float(half @ half)
        return value - float(np.log(np.diag(factor)).sum()) - float(np.log(sigma).sum())

    def without(self, gone: slice) -> Reduced:
        """The same with the parameters at `gone` held at nil."""
        rest = np.delete(np.arange(len(self.b)), np.arange(len(self.b))[gone])
        back = -self.theta0[gone]
        moved = self.b[gone] @ back - 0.5 * back @ self.H[gone, gone] @ back
        b = self.b[rest] - self.H[np.ix_(rest, np.arange(len(self.b))[gone])] @ back
        return Reduced(self.H[np.ix_(rest, rest)], b, self.theta0[rest], self.constant + float(moved))

    def estimate(self, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (P,) and covariance (P, P) with prior sigmas (P,)."""
        precision = 1 / sigma**2
        C = np.linalg.inv(self.H + np.diag(precision))
        return self.theta0 + C @ (self.b - precision * self.theta0), C


class Fit:
    """The logs, the catalogue, and steps towards the best nodes and parameters."""

    def __init__(self, physics: Physics, effects: Sequence[Effect], noise: Noise):
        self.physics, self.effects, self.noise = physics, tuple(effects), noise
        self.lineariser = Lineariser(physics)
        self.z0 = first_nodes(physics.windows, physics.parameters)
        self._first = np.flatnonzero(physics.windows.first)

    def sigma(self, chosen: Sequence[Effect], believed: frozenset[str]) -> np.ndarray:
        """Prior sigmas of the parameters of `chosen`, (P,)."""
        return np.concatenate(
            [
                [p.prior for p in e.parameters] if e.id in believed or e.family == "base" else e.tolerance()
                for e in chosen
            ]
        )

    def point(self, theta: Theta, z: np.ndarray, chosen: Sequence[Effect], before: Point | None = None) -> Point:
        """Linearised at theta, z."""
        state = before.state if before else None
        return self.lineariser.point(self.effects, theta, z, self.noise, chosen, state)

    def assembled(self, point: Point, noise: Noise) -> tuple[Chain, float, float]:
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

    def _off(self, z: np.ndarray) -> np.ndarray:
        off = z[self._first].copy()
        off[:, STATE] -= self.z0[self._first, STATE]
        return off

    def _prior_cost(self, rho: np.ndarray, sigma: np.ndarray, off: np.ndarray, start: np.ndarray) -> float:
        return 0.5 * float(((rho / sigma) ** 2).sum() + ((off / start) ** 2).sum())

    def reduced(self, point: Point, chosen: Sequence[Effect], noise: Noise | None = None) -> Reduced:
        """Nodes eliminated."""
        chain, cost, log_sigma = self.assembled(point, noise or self.noise)
        guard = 1 / self.sigma(chosen, frozenset()) ** 2
        chain.D += np.diag(guard)
        dz, dw, D, log_det = chain.solve()
        promised = -0.5 * float((chain.g * dz).sum() + chain.d @ dw)
        b = D @ dw
        nodes = promised - 0.5 * float(b @ dw)
        return Reduced(D - np.diag(guard), b, flat(point.theta, chosen), nodes - cost - 0.5 * log_det - log_sigma)

    def solve(
        self,
        theta: Theta,
        z: np.ndarray,
        chosen: Sequence[Effect],
        believed: frozenset[str],
        *,
        steps: int = 12,
        tolerance: float = 0.3,
        before: Point | None = None,
    ) -> Point:
        """Gauss-Newton from theta, z with the parameters of `chosen` free. Stops at steps that promise little."""
        sigma = self.sigma(chosen, believed)
        lower, upper = (np.array([getattr(p, k) for e in chosen for p in e.parameters]) for k in ("lower", "upper"))
        point = self.point(theta, z, chosen, before)
        for _ in range(steps):
            moved, promised = self._step(point, chosen, sigma, (lower, upper))
            point = moved
            if promised < tolerance:
                break
        return point

    def _step(
        self, point: Point, chosen: Sequence[Effect], sigma: np.ndarray, limits: tuple[np.ndarray, np.ndarray]
    ) -> tuple[Point, float]:
        now = flat(point.theta, chosen)
        plain, cost, _ = self.assembled(point, self.noise)
        plain.D += np.diag(1 / sigma**2)
        plain.d += now / sigma**2
        cost += 0.5 * float((now / sigma) @ (now / sigma))
        damping = 0.0
        for _ in range(6):
            chain = plain.copy()
            chain.D += damping * np.diag(1 / sigma**2)
            chain.A += damping * np.diag(1 / self.noise.node_start() ** 2)
            dz, dw, promised = _bounded(chain, now, limits)
            if promised < 1e-3:
                return point, promised
            theta = unflat(np.clip(now + dw, *limits), chosen)
            with np.errstate(all="ignore"):
                after = self._total(theta, point.z + dz, chosen, sigma, point)
            if after < cost:
                return self.point(theta, point.z + dz, chosen, point), promised
            damping = max(10 * damping, 1.0)
        return point, 0.0

    def _total(self, theta: Theta, z: np.ndarray, chosen: Sequence[Effect], sigma: np.ndarray, near: Point) -> float:
        data, _, rho = self.lineariser.cost(self.effects, theta, z, self.noise, near.state)
        now, ties = flat(theta, chosen), self.noise.tie(near.ties.span_s)[1]
        value = data + self._prior_cost(rho, ties, self._off(z), self.noise.node_start())
        return value + 0.5 * float((now / sigma) @ (now / sigma))


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
        chain = plain.copy()
        stiff = np.where(pinned, PINNED * np.maximum(np.diag(plain.D), 1.0), 0.0)
        chain.D += np.diag(stiff)
        chain.d -= stiff * (np.clip(now + dw, *limits) - now)
    promised = -float((plain.g * dz).sum() + plain.d @ dw)
    return dz, dw, promised / 2


def flat(theta: Theta, chosen: Sequence[Effect]) -> np.ndarray:
    """Parameters of `chosen` one after the other, (P,)."""
    return np.concatenate([theta.get(e.id, np.zeros(len(e.parameters))) for e in chosen])


def unflat(values: np.ndarray, chosen: Sequence[Effect]) -> dict[str, np.ndarray]:
    """The other way round; parameters that are all nil are left out."""
    theta, at = {}, 0
    for e in chosen:
        theta[e.id] = values[at : at + len(e.parameters)]
        at += len(e.parameters)
    return theta


def slices(chosen: Sequence[Effect]) -> dict[str, slice]:
    """Where each effect's parameters are."""
    found, at = {}, 0
    for e in chosen:
        found[e.id] = slice(at, at + len(e.parameters))
        at += len(e.parameters)
    return found
