"""The structured fit: parameters, nodes and noise of one boat from its runs.

Maximum a posteriori by Gauss-Newton on nodes and parameters together (multiple shooting with tied nodes). With no
latent force and tight ties it is output error over whole runs. With a latent force, whose size is chosen by the
evidence of the data (Laplace), it is the smoother that goes with the prediction-error likelihood: model and disturbance
share the blame for what is left, and intervals stay honest. White noise follows the residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize

from companion.core.vessel_file import VesselFile
from sim.identify.run import Run
from sim.identify.structured.chain import Chain
from sim.identify.structured.data import Windows, cut
from sim.identify.structured.linearise import Linearised, Problem
from sim.identify.structured.model import compile_model
from sim.identify.structured.noise import STATE, Noise, noise_of
from sim.identify.structured.parameters import Parameters, PriorSigmas
from sim.identify.structured.start import first_nodes

SLACK = (100.0, 10.0, 1.0)  # of the ties, by iteration: nodes first follow the data, then the model
LATENT_FLOOR = np.array([2e-3, 2e-3, 5e-4])  # N, N, N m: less is none
LATENT_START = np.array([0.3, 0.3, 0.1])
MAD_TO_SIGMA = 1.4826  # of a normal distribution
Say = Callable[[str, float], None]


@dataclass(frozen=True)
class Settings:
    """How to fit. `latent`: let a latent force explain what the model cannot. `overrides`: see Parameters."""

    window_s: float = 2.0
    latent: bool = True
    latent_time_s: float = 5.0
    iterations: int = 30
    tolerance_nats: float = 0.02
    threads: int = 1
    sigmas: PriorSigmas = PriorSigmas()
    overrides: Mapping[str, tuple[float | None, float]] = field(default_factory=dict)
    noise: Noise | None = None


@dataclass(frozen=True)
class Point:
    """Where a fit stands: w (P,), nodes (W, L), and the data's normal equations there."""

    w: np.ndarray
    z: np.ndarray
    at: Linearised


class Fit:
    """One problem, and the steps towards its solution."""

    def __init__(self, runs: Sequence[Run], vessel: VesselFile, settings: Settings):
        self.settings = settings
        self.parameters = Parameters(vessel, settings.sigmas, settings.overrides)
        self.windows: Windows = cut(runs, vessel, settings.window_s)
        W, K = self.windows.size
        self.problem = Problem(self.windows, self.parameters, compile_model(vessel, K, W, settings.threads))
        self.noise = replace(settings.noise or noise_of(vessel), latent_time_s=settings.latent_time_s)
        self._z0 = first_nodes(self.windows, self.parameters)
        self._first = np.flatnonzero(self.windows.first)

    def begin(self) -> Point:
        """At the priors' centres and the first guess of the nodes."""
        return self.point(self.parameters.prior[0], self._z0)

    def point(self, w: np.ndarray, z: np.ndarray) -> Point:
        """Linearise the data at w and z under the present noise."""
        return Point(w, z, self.problem.linearise(self.parameters.file_units(w), z, self.noise))

    def assemble(self, point: Point, noise: Noise) -> tuple[Chain, float, float]:
        """Normal equations in terms of w with ties and priors, their cost [nats], and sum log sigma of the nodes."""
        chain, ties = point.at.chain.copy(), point.at.ties
        _, sigma = noise.tie(ties.span_s)
        chain.add_ties(ties, sigma)
        chain.in_terms_of(self.parameters.jacobian(point.w))
        mean, spread = self.parameters.prior
        chain.D += np.diag(1 / spread**2)
        chain.d += (point.w - mean) / spread**2
        start, first = noise.node_start(), self._first
        off = point.z[first].copy()
        off[:, STATE] -= self._z0[first, STATE]
        chain.A[first] += np.diag(1 / start**2)
        chain.g[first] += off / start**2
        squares = ((ties.rho / sigma) ** 2).sum() + ((off / start) ** 2).sum() + (((point.w - mean) / spread) ** 2).sum()
        log_sigma = float(np.log(sigma).sum() + len(first) * np.log(start).sum())
        return chain, point.at.cost + 0.5 * float(squares), log_sigma

    def step(self, point: Point) -> tuple[Point, float]:
        """One step that lowers the cost, and what it promised [nats]; the same point where none is to be had."""
        plain, cost, _ = self.assemble(point, self.noise)
        _, spread = self.parameters.prior
        damping = 0.0
        for _ in range(8):
            chain = plain.copy()
            chain.D += damping * np.diag(1 / spread**2)
            chain.A += damping * np.diag(1 / self.noise.node_start() ** 2)
            dz, dw, _, _ = chain.solve()
            promised = -0.5 * float((chain.g * dz).sum() + chain.d @ dw)
            if not promised > self.settings.tolerance_nats:
                return point, promised
            trial = self.point(point.w + dw, point.z + dz)
            after = self.assemble(trial, self.noise)[1]
            if np.isfinite(after) and (after < cost or self.noise.slack > SLACK[-1]):
                return trial, promised
            damping = max(10 * damping, 1.0)
        return point, 0.0

    def evidence(self, point: Point, noise: Noise) -> float:
        """Log evidence of the linearised problem under `noise` [nats], up to a constant."""
        chain, cost, log_sigma = self.assemble(point, noise)
        dz, dw, D, log_det = chain.solve()
        promised = -0.5 * float((chain.g * dz).sum() + chain.d @ dw)
        return promised - cost - 0.5 * (log_det + float(np.linalg.slogdet(D)[1])) - log_sigma

    def tune_latent(self, point: Point, noise: Noise) -> Noise:
        """The latent force of greatest evidence: none, a tenth of the present one, or a simplex search round it."""
        now = np.maximum(noise.latent, LATENT_FLOOR)
        trials = [LATENT_FLOOR, 0.1 * now, now] if np.any(now > LATENT_FLOOR) else [LATENT_FLOOR, 0.1 * LATENT_START]

        def gain(sigma: np.ndarray) -> float:
            return self.evidence(point, with_latent(noise, sigma))

        gains = [gain(sigma) for sigma in trials]
        best = trials[int(np.argmax(gains))]
        if best is not LATENT_FLOOR:
            options = {
                "initial_simplex": np.log(best) + np.vstack([np.zeros(3), -1.0 * np.eye(3)]),
                "maxfev": 40,
                "fatol": 0.5,
                "xatol": 0.15,
            }
            best = np.exp(minimize(lambda v: -gain(np.exp(v)), np.log(best), method="Nelder-Mead", options=options).x)
        return with_latent(noise, best)


def with_latent(noise: Noise, sigma: np.ndarray) -> Noise:
    """The same noise with a latent force of these sigmas [N, N, N m], at least the floor's."""
    x, y, n = map(float, np.maximum(sigma, LATENT_FLOOR))
    return replace(noise, latent=(x, y, n))


def rescaled(noise: Noise, at: Linearised) -> tuple[Noise, float]:
    """White noise as the residuals show it (median absolute deviation), and the largest change as a factor - 1."""
    white = np.ones(4)
    for c in range(4):
        known = at.residuals[..., c]
        known = known[np.isfinite(known)]
        if len(known):
            white[c] = MAD_TO_SIGMA * np.median(np.abs(known))
    fix = float(MAD_TO_SIGMA * np.median(np.abs(at.fix_residuals)))
    change = float(np.abs(np.append(white, fix) - 1).max())
    return noise.scaled(np.maximum(white, 0.05), max(fix, 0.02)), change


def solve(fit: Fit, say: Say = lambda _text, _share: None) -> tuple[Point, int]:
    """From the start to convergence. Returns the point and how many steps it took."""
    settings, count = fit.settings, 0
    fit.noise = replace(fit.noise, slack=SLACK[0])
    if settings.latent:
        fit.noise = with_latent(fit.noise, LATENT_START)
    point = fit.begin()
    settled = False
    while count < settings.iterations:
        after, promised = fit.step(point)
        moved = after is not point
        point, count = after, count + 1
        say(f"step {count}: {promised:.2f} nats", min(1.0, count / 12))
        if count < len(SLACK):
            fit.noise = replace(fit.noise, slack=SLACK[count])
        elif settled and (not moved or promised < 0.5):
            break
        elif promised < 300 or not moved:
            fit.noise, settled = _retuned(fit, point)
            point = fit.point(point.w, point.z)
    return point, count


def _retuned(fit: Fit, point: Point) -> tuple[Noise, bool]:
    """Noise after a look at the residuals and the evidence; True when it hardly changed."""
    noise, change = rescaled(fit.noise, point.at)
    if fit.settings.latent:
        before = np.array(noise.latent)
        noise = fit.tune_latent(point, noise)
        change = max(change, float(np.abs(np.log(np.array(noise.latent) / before)).max()) / 5)
    return noise, change < 0.06

