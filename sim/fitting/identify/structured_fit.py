"""The structured fit: parameters, nodes and noise of one boat from its runs.

Maximum a posteriori by Gauss-Newton on nodes and parameters together (multiple shooting with tied nodes). With no
latent acceleration and tight ties it is output error over whole runs. With one, whose size is chosen by the
evidence of the data (Laplace), it is the smoother that goes with the prediction-error likelihood: model and disturbance
share the blame for what is left, and intervals stay honest. White noise follows the residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import configuration_matrix
from companion.logs.runs.decimate import RATE_HZ, Decimated, decimated
from companion.logs.runs.run import Run
from sim.fitting.engine.block_tridiagonal import Chain
from sim.fitting.engine.initial_guess import initial_nodes
from sim.fitting.engine.linearise import HUBER, FitProblem, Linearised
from sim.fitting.engine.model import compile_model
from sim.fitting.engine.noise import STATE, Noise, noise_of
from sim.fitting.engine.parameters import Parameters, PriorSigmas
from sim.fitting.engine.windows import MAX_STEP_S, Windows, cut_windows

MEAN_STEP_S = 1.5 / RATE_HZ  # of integration, where thrust is averaged as the samples are: a late sample splits no step
WINDOWS_S = (2.0, 0.5)  # the second where the first leaves residuals that are not white
SLACK = (100.0, 10.0, 1.0)  # of the ties, by iteration: nodes first follow the data, then the model
LATENT_START, LATENT_FLOOR = 0.1, 1e-3  # shares of the rms of commanded force over inertia; at the floor is none
ENOUGH = 0.5  # nats that a last step may promise: a fifth of a sigma of each parameter, about
READY = 0.5  # nats per sample: a step that promises less leaves a linearisation good enough to set the noise by
FARTHEST = 4.0  # sigmas of the prior that one step may go: further is beyond what the linearisation knows
DECADE = np.log(10.0)
Q90 = 1.644854  # 90 % of a normal distribution lie within so many sigmas
COLOURED = 0.2  # correlation of neighbouring residuals beyond which they count for fewer than they are
LATENT_CEILING = 10.0  # times the rms of commanded force over inertia, at the file's gains: more is no boat's model
SAME_WHITE, SAME_LATENT = 0.03, 0.3  # changes that ask for no further step: a share, a logarithm; assumed
FACTORS = (0.3, 10.0)  # of a stated noise: the residuals may say so much less, so much more; assumed
Say = Callable[[str, float], None]


@dataclass(frozen=True)
class FitSettings:
    """How to fit. `latent`: let a latent acceleration explain what the model cannot. `overrides`: see Parameters.

    `horizon_s`: multi-step output error instead (`horizon`), over so long; None: where no inertial sensor was logged;
    0: never. `inertial_hz`: faster heading, yaw rate and specific force are averaged to about this rate (`thin`).
    """

    horizon_s: float | None = None
    window_s: float | None = None
    latent: bool = True
    latent_time_s: float = 5.0
    inertial_hz: float = RATE_HZ
    iterations: int = 40
    tolerance_nats: float = 0.02
    sigmas: PriorSigmas = field(default_factory=PriorSigmas)
    overrides: Mapping[str, tuple[float | None, float]] = field(default_factory=dict)
    noise: Noise | None = None


@dataclass(frozen=True)
class FitPoint:
    """Where a fit stands: w (P,), nodes (W, L), and the data's normal equations there."""

    w: np.ndarray
    z: np.ndarray
    at: Linearised


class StructuredFit:
    """One problem, and the steps towards its solution."""

    def __init__(self, runs: Sequence[Run], vessel: VesselFile, settings: FitSettings):
        self.settings = settings
        self.parameters = Parameters(vessel, settings.sigmas, settings.overrides)
        fewer = [decimated(run, settings.inertial_hz) for run in runs]
        self.windows = _windows(fewer, vessel, settings.window_s or WINDOWS_S[0])
        W, K = self.windows.size
        self.problem = FitProblem(self.windows, self.parameters, compile_model(vessel, K, W))
        self.command_rms = _command_rms(self.windows, vessel)
        noise = settings.noise or _of_means(noise_of(vessel), runs, fewer)
        noise = replace(noise, latent_time_s=settings.latent_time_s)
        self.stated = noise
        self.noise = with_latent(noise, (LATENT_START if settings.latent else LATENT_FLOOR) * self.command_rms)
        self._z0 = initial_nodes(self.windows, self.parameters)
        self._first = np.flatnonzero(self.windows.first)

    def begin(self) -> FitPoint:
        """At the priors' centres and the first guess of the nodes."""
        return self.point(self.parameters.prior[0], self._z0)

    def point(self, w: np.ndarray, z: np.ndarray) -> FitPoint:
        """Linearise the data at w and z under the present noise."""
        return FitPoint(w, z, self.problem.linearise(self.parameters.file_units(w), z, self.noise))

    def again(self, point: FitPoint) -> FitPoint:
        """The same place under the present noise."""
        q = self.parameters.file_units(point.w)
        return replace(point, at=self.problem.linearise(q, point.z, self.noise, point.at.motion))

    def assemble(self, point: FitPoint, noise: Noise) -> tuple[Chain, float, float]:
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
        squares = (
            ((ties.rho / sigma) ** 2).sum() + ((off / start) ** 2).sum() + (((point.w - mean) / spread) ** 2).sum()
        )
        log_sigma = float(np.log(sigma).sum() + len(first) * np.log(start).sum())
        return chain, point.at.cost + 0.5 * float(squares), log_sigma

    def step(self, point: FitPoint) -> tuple[FitPoint, float]:
        """One step that lowers the cost, and what it promised [nats]; the same point where none is to be had."""
        plain, cost, _ = self.assemble(point, self.noise)
        _, spread = self.parameters.prior
        damping = 0.0
        for _ in range(8):
            chain = plain.damped(damping / self.noise.node_start() ** 2, damping / spread**2)
            dz, dw, _, _ = chain.solve()
            promised = -0.5 * float((chain.g * dz).sum() + chain.d @ dw)
            if promised <= self.settings.tolerance_nats:
                return point, promised
            if np.abs(dw / spread).max() < FARTHEST:
                with np.errstate(all="ignore"):  # a trial may run away: it is then refused
                    trial = self.point(point.w + dw, point.z + dz)
                    after = self.assemble(trial, self.noise)[1]
                if after < cost:
                    return trial, promised
            damping = max(10 * damping, 1.0)
        return point, 0.0

    def evidence(self, point: FitPoint, noise: Noise) -> float:
        """Log evidence of the linearised problem under `noise` [nats], up to a constant."""
        chain, cost, log_sigma = self.assemble(point, noise)
        dz, dw, D, log_det = chain.solve()
        promised = -0.5 * float((chain.g * dz).sum() + chain.d @ dw)
        return promised - cost - 0.5 * (log_det + float(np.linalg.slogdet(D)[1])) - log_sigma

    def tune_latent(self, point: FitPoint, noise: Noise) -> Noise:
        """The latent acceleration of greatest evidence, where linearisation holds.

        By decades, all axes together: down as long as each is better than the last, from the floor one up; where none
        is better, a simplex search within one.
        """
        floor = LATENT_FLOOR * self.command_rms
        now = np.maximum(noise.latent, floor)

        def gain(log_share: np.ndarray) -> float:
            return self.evidence(point, with_latent(noise, np.maximum(now * np.exp(log_share), floor)))

        best, most, at_floor = np.zeros(3), gain(np.zeros(3)), bool(np.all(now <= floor))
        away = np.full(3, DECADE if at_floor else -DECADE)
        while (there := gain(away)) > most:
            best, most = away, there
            if at_floor or np.all(now * np.exp(away) <= floor):
                break
            away = away - DECADE
        if not at_floor and not best.any():
            options = {
                "initial_simplex": np.vstack([np.zeros(3), -np.eye(3)]),
                "maxfev": 40,
                "fatol": 1.0,
                "xatol": 0.1,
            }
            within = [(-DECADE, DECADE)] * 3
            best = minimize(lambda v: -gain(v), np.zeros(3), method="Nelder-Mead", bounds=within, options=options).x
        return with_latent(noise, np.clip(now * np.exp(best), floor, LATENT_CEILING * self.command_rms))


def with_latent(noise: Noise, sigma: np.ndarray) -> Noise:
    """The same noise with a latent acceleration of these sigmas [m/s^2, m/s^2, rad/s^2]."""
    x, y, n = map(float, sigma)
    return replace(noise, latent=(x, y, n))


def _windows(fewer: Sequence[Decimated], vessel: VesselFile, window_s: float) -> Windows:
    """Logs with fewer inertial samples as windows."""
    step_s = MEAN_STEP_S if all(each.width_s for each in fewer) else MAX_STEP_S
    return cut_windows([each.run for each in fewer], vessel, window_s, max_step_s=step_s, means=fewer)


def _of_means(noise: Noise, runs: Sequence[Run], fewer: Sequence[Decimated]) -> Noise:
    """White noise of samples as that of their means."""
    logged, left = (sum(len(run.samples("psi_rad")[0]) for run in some) for some in (runs, [f.run for f in fewer]))
    share = float(np.sqrt(left / logged))
    psi, r, ax, ay = (share * sigma for sigma in noise.white)
    return replace(noise, white=(psi, r, ax, ay))


def _command_rms(windows: Windows, vessel: VesselFile) -> np.ndarray:
    """Root mean square of commanded force over inertia of the file [m/s^2, m/s^2, rad/s^2], at gains of one."""
    steady = np.concatenate([c.force_n for c in windows.commands]) @ configuration_matrix(vessel).T
    return np.maximum(np.sqrt((steady**2).mean(axis=0)) / np.diag(mass_matrix(vessel)), 1e-6)


def white_from_residuals(noise: Noise, at: Linearised, stated: Noise) -> tuple[Noise, float]:
    """White noise as the residuals show it, and the largest change as a factor - 1.

    From their 90 % quantile, which a few outliers do not move; within `FACTORS` of what the sensors are stated to have.
    Residuals that hang together by rho from one to the next say as much as a share (1 - rho) / (1 + rho) of them would
    (first-order autoregression): their sigma grows to match.
    """
    white = tuple(
        _bounded(now, at.residuals[..., c].ravel(), said)
        for c, (now, said) in enumerate(zip(noise.white, stated.white, strict=True))
    )
    fix = _bounded(noise.fix_m, at.fix_residuals, stated.fix_m)
    change = np.array([*white, fix]) / np.array([*noise.white, noise.fix_m]) - 1
    psi, r, ax, ay = white
    return replace(noise, white=(psi, r, ax, ay), fix_m=fix), float(np.abs(change).max())


def _bounded(sigma: float, whitened: np.ndarray, stated: float) -> float:
    """From residuals in order of time, (m,) or (m, 2)."""
    known = whitened[np.isfinite(whitened).reshape(len(whitened), -1).all(axis=1)]
    if not len(known):
        return sigma
    rho = lag1_correlation(known)
    share = np.sqrt((1 + rho) / (1 - rho)) if rho > COLOURED + 2 / np.sqrt(len(known)) else 1.0
    found = sigma * share * np.quantile(np.abs(known), 0.9) / Q90
    return float(np.clip(found, FACTORS[0] * stated, FACTORS[1] * stated))


def lag1_correlation(residuals: np.ndarray) -> float:
    """Of neighbours in time, (m,) or (m, 2), about zero; beyond HUBER sigmas they count as HUBER."""
    r = np.clip(residuals, -HUBER, HUBER)
    return float(np.clip((r[1:] * r[:-1]).sum() / max((r * r).sum(), 1e-12), -0.99, 0.99))


def solve(fit: StructuredFit, say: Say = lambda _text, _share: None) -> tuple[FitPoint, int]:
    """From the start to convergence. Returns the point and how many steps it took."""
    settings, count = fit.settings, 0
    fit.noise = replace(fit.noise, slack=SLACK[0])
    point = fit.begin()
    settled = False
    while count < settings.iterations:
        after, promised = fit.step(point)
        moved = after is not point
        point, count = after, count + 1
        say(f"step {count}: {promised:.2f} nats", min(1.0, count / 8))
        if count < len(SLACK):
            fit.noise = replace(fit.noise, slack=SLACK[count])
        elif settled:
            if not moved or promised < ENOUGH:
                break
        elif promised < READY * fit.windows.samples() or not moved:
            before = fit.noise
            fit.noise, settled = _retuned(fit, point)
            if fit.noise == before and promised < ENOUGH:
                break
            if (fit.noise.white, fit.noise.fix_m) != (before.white, before.fix_m):
                point = fit.again(point)
    return point, count


def _retuned(fit: StructuredFit, point: FitPoint) -> tuple[Noise, bool]:
    """Noise after a look at the residuals and the evidence; True when it hardly changed.

    White noise that hardly changed stays as it was, which saves a linearisation.
    """
    found, change = white_from_residuals(fit.noise, point.at, fit.stated)
    noise, same = (fit.noise, True) if change < SAME_WHITE else (found, False)
    if fit.settings.latent:
        before = np.array(noise.latent)
        noise = fit.tune_latent(point, noise)
        same &= float(np.abs(np.log(np.array(noise.latent) / before)).max()) < SAME_LATENT
    return noise, same
