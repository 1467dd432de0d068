"""The structured fit: parameters, nodes and noise of one boat from its runs, maximum a posteriori.

    minimise over w, z   cost of the data (`linearise`)
                         + 1/2 sum_w |z_{w+1} - f(z_w, q)|^2_{Q^-1}      ties: continuity between windows
                         + 1/2 |z_first - z0|^2_{P0^-1}                  prior of nodes that open a run
                         + 1/2 |w - w_prior|^2_{Sigma^-1}                prior of the parameters

by Gauss-Newton steps on nodes z and parameters w together (multiple shooting with softened continuity). The noise is
estimated in turn with them: white noise from the residuals, and the size of the latent acceleration by the evidence

    log p(data | noise) = -cost_min - 1/2 log det H - sum log sigma + constant        (Laplace's approximation)

Without latent acceleration and with tight ties this is output error over whole runs. With it the nodes are a smoother's
and the fit is that of a prediction-error method: model error counts as process noise, so that the intervals of the
parameters cover it.
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
from sim.fitting.engine.free_parameters import PriorSigmas
from sim.fitting.engine.initial_guess import initial_nodes
from sim.fitting.engine.linearise import FitProblem, Linearised
from sim.fitting.engine.model import compile_model
from sim.fitting.engine.noise import STATE, Noise, noise_of
from sim.fitting.engine.parameters import Parameters
from sim.fitting.engine.wind import OF_THE_DAY
from sim.fitting.engine.windows import CHANNELS, MAX_STEP_S, PSI, Windows, cut_windows
from sim.fitting.identify.white_noise import white_from_residuals

MEAN_STEP_S = 1.5 / RATE_HZ  # longest step where samples are means: beyond their period, so that jitter splits none
WINDOWS_S = (2.0, 0.5)  # window length [s]; the second is tried where the first leaves residuals that are not white
SLACK = (100.0, 10.0, 1.0)  # factor on sigma of the ties, by iteration: nodes first follow the data, then the model
LATENT_START, LATENT_FLOOR = 0.1, 1e-3  # shares of the rms of commanded force over inertia; the floor means none
ENOUGH = 0.5  # predicted decrease [nats] of a last step: about a fifth of a sigma of each parameter
READY = 0.5  # predicted decrease [nats per sample] below which residuals and linearisation are fit to set the noise by
FARTHEST = 4.0  # longest step, in sigmas of the prior: the linearisation does not reach further
DECADE = np.log(10.0)
LATENT_CEILING = 10.0  # times the rms of commanded force over inertia, at the file's gains: no boat's model is worse
SAME_WHITE, SAME_LATENT = 0.03, 0.3  # relative, logarithmic change of the noise that counts as none; assumed
SAME_SHARE = 0.1  # relative difference of what decimation leaves of two channels that counts as none; assumed
Say = Callable[[str, float], None]
"""Progress: text, and share that is done."""


@dataclass(frozen=True)
class FitSettings:
    """Options of a fit.

    horizon_s        multi-step output error over this horizon instead (`horizon`); None: only where no inertial sensor
                     was logged; 0: never
    window_s         window length; None: `WINDOWS_S`
    latent           estimate a latent acceleration for what the model cannot explain
    latent_time_s    its correlation time
    inertial_hz      heading, yaw rate and specific force are averaged to about this rate (`decimate`)
    iterations       most Gauss-Newton steps
    tolerance_nats   predicted decrease below which a step is not taken
    sigmas           priors of the parameters; `overrides`: see `Parameters`
    noise            sensor noise instead of that of the vessel file
    surroundings     current and wind, the same in all runs, too; unmeasured_imu: the IMU's lever arm and hard iron
    compass          whether the heading may be put right where the compass errs by how the boat is turned
    heading_offset_rad   how far off a heading may be all the time, instead of what is usual (`Noise.offset_rad`)
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
    surroundings: bool = False
    unmeasured_imu: bool = False
    heading_offset_rad: float | None = None
    compass: bool = True

    def parameters(self, vessel: VesselFile) -> Parameters:
        """What is fitted of this boat, with its priors."""
        return Parameters(vessel, self.sigmas, self.overrides, self.surroundings, self.unmeasured_imu)


UNMEASURED = FitSettings(
    sigmas=PriorSigmas(gain=0.3, arm_m=0.3), surroundings=True, unmeasured_imu=True, heading_offset_rad=0.2
)
"""Priors of a file that knows the length and the thrusters' places only; assumed."""


@dataclass(frozen=True)
class FitPoint:
    """One iterate: parameters w (P,), nodes z (W, L), and the data linearised there (`at`)."""

    w: np.ndarray
    z: np.ndarray
    at: Linearised


class StructuredFit:
    """One fit: its windows, parameters and present noise, and the steps towards the solution (`solve`)."""

    def __init__(self, runs: Sequence[Run], vessel: VesselFile, settings: FitSettings):
        fewer = [decimated(run, settings.inertial_hz) for run in runs]
        self.windows = _windows(fewer, vessel, settings.window_s or WINDOWS_S[0])
        if settings.surroundings and np.isfinite(self.windows.wind_m_s).all():
            settings = replace(settings, overrides={**settings.overrides, **OF_THE_DAY})
        self.settings, self.parameters = settings, settings.parameters(vessel)
        W, K = self.windows.size
        self.problem = FitProblem(self.windows, self.parameters, compile_model(vessel, K, W, settings.surroundings))
        self.command_rms = _command_rms(self.windows, vessel)
        noise = settings.noise or _of_means(noise_of(vessel), runs, fewer)
        off_rad = noise.offset_rad if settings.heading_offset_rad is None else settings.heading_offset_rad
        noise = replace(noise, latent_time_s=settings.latent_time_s, offset_rad=off_rad)
        self.stated = noise
        self.noise = with_latent(noise, (LATENT_START if settings.latent else LATENT_FLOOR) * self.command_rms)
        self._z0 = initial_nodes(self.windows, self.parameters)
        self._first = np.flatnonzero(self.windows.first)

    def begin(self) -> FitPoint:
        """The first iterate: parameters at the centres of their priors, nodes guessed from the measurements."""
        return self.point(self.parameters.prior[0], self._z0)

    def point(self, w: np.ndarray, z: np.ndarray) -> FitPoint:
        """The iterate at w (P,) and z (W, L): data linearised under the present noise."""
        return FitPoint(w, z, self.problem.linearise(self.parameters.file_units(w), z, self.noise))

    def again(self, point: FitPoint) -> FitPoint:
        """The same iterate, linearised anew because the noise has changed; the trajectories are kept."""
        q = self.parameters.file_units(point.w)
        return replace(point, at=self.problem.linearise(q, point.z, self.noise, point.at.motion))

    def assemble(self, point: FitPoint, noise: Noise) -> tuple[Chain, float, float]:
        """Normal equations in z and w with ties and priors, total cost [nats], and sum log sigma of ties and nodes."""
        # 1. Data and ties, in terms of w.
        chain, ties = point.at.chain.copy(), point.at.ties
        _, sigma = noise.tie(ties.span_s)
        chain.add_ties(ties, sigma)
        chain.in_terms_of(self.parameters.jacobian(point.w))
        mean, spread = self.parameters.prior
        # 2. Priors of the parameters.
        chain.D += np.diag(1 / spread**2)
        chain.d += (point.w - mean) / spread**2
        # 3. Priors of the nodes that open a run: states around the first guess, all else around 0.
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
        """One Gauss-Newton step that lowers the cost, and the decrease that was predicted [nats].

        Damped (Levenberg-Marquardt, in units of the priors) until the cost falls. Returns the same point where the
        predicted decrease is within tolerance, or where no step lowers the cost.
        """
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
                with np.errstate(all="ignore"):  # a trial may diverge; it is refused then
                    trial = self.point(point.w + dw, point.z + dz)
                    after = self.assemble(trial, self.noise)[1]
                if after < cost:
                    return trial, promised
            damping = max(10 * damping, 1.0)
        return point, 0.0

    def evidence(self, point: FitPoint, noise: Noise) -> float:
        """Log evidence of the linearised problem under `noise` [nats], up to a constant (module docstring)."""
        chain, cost, log_sigma = self.assemble(point, noise)
        dz, dw, D, log_det = chain.solve()
        promised = -0.5 * float((chain.g * dz).sum() + chain.d @ dw)
        return promised - cost - 0.5 * (log_det + float(np.linalg.slogdet(D)[1])) - log_sigma

    def tune_latent(self, point: FitPoint, noise: Noise) -> Noise:
        """The noise with the latent acceleration of greatest evidence, as far as the linearisation holds."""
        floor = LATENT_FLOOR * self.command_rms
        now = np.maximum(noise.latent, floor)

        def gain(log_share: np.ndarray) -> float:
            return self.evidence(point, with_latent(noise, np.maximum(now * np.exp(log_share), floor)))

        # 1. By decades, all axes together: down while the evidence grows; from the floor one decade up.
        best, most, at_floor = np.zeros(3), gain(np.zeros(3)), bool(np.all(now <= floor))
        away = np.full(3, DECADE if at_floor else -DECADE)
        while (value := gain(away)) > most:
            best, most = away, value
            if at_floor or np.all(now * np.exp(away) <= floor):
                break
            away = away - DECADE
        # 2. Where a decade less is no better: each axis by simplex search, within one decade to either side.
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
    """The noise with sigmas `sigma` (3,) of the latent acceleration [m/s^2, m/s^2, rad/s^2]."""
    x, y, n = map(float, sigma)
    return replace(noise, latent=(x, y, n))


def _windows(fewer: Sequence[Decimated], vessel: VesselFile, window_s: float) -> Windows:
    """Windows of the decimated logs; their steps may be longer where all samples are means."""
    step_s = MEAN_STEP_S if all(each.width_s for each in fewer) else MAX_STEP_S
    return cut_windows([each.run for each in fewer], vessel, window_s, max_step_s=step_s, means=fewer)


def _of_means(noise: Noise, runs: Sequence[Run], fewer: Sequence[Decimated]) -> Noise:
    """White noise of the means that decimation left, from that of single samples: by the root of their number."""
    logged, left = (
        [sum(len(run.samples(c)[0]) for run in some) for c in CHANNELS] for some in (runs, [f.run for f in fewer])
    )
    shares = [float(np.sqrt(n / of)) if of else 0.0 for n, of in zip(left, logged, strict=True)]
    # Channels of about the heading's rate have the heading's share: one sample more or less at an end is no difference.
    shares = [s if s and abs(s / shares[PSI] - 1) > SAME_SHARE else shares[PSI] for s in shares]
    psi, r, ax, ay = (share * sigma for share, sigma in zip(shares, noise.white, strict=True))
    return replace(noise, white=(psi, r, ax, ay))


def _command_rms(windows: Windows, vessel: VesselFile) -> np.ndarray:
    """Root mean square of commanded force over the file's inertia, (3,) [m/s^2, m/s^2, rad/s^2], at gains of one."""
    steady = np.concatenate([c.force_n for c in windows.commands]) @ configuration_matrix(vessel).T
    return np.maximum(np.sqrt((steady**2).mean(axis=0)) / np.diag(mass_matrix(vessel)), 1e-6)


def solve(fit: StructuredFit, say: Say = lambda _text, _share: None) -> tuple[FitPoint, int]:
    """Iterate from the start to convergence. Returns the last iterate and the number of steps.

    The noise of `fit` changes on the way: slack of the ties, white noise, latent acceleration.
    """
    settings, count = fit.settings, 0
    fit.noise = replace(fit.noise, slack=SLACK[0])
    point = fit.begin()
    settled = False
    while count < settings.iterations:
        after, promised = fit.step(point)
        moved = after is not point
        point, count = after, count + 1
        say(f"step {count}: {promised:.2f} nats", min(1.0, count / 8))
        # 1. First steps: tighten the ties.
        if count < len(SLACK):
            fit.noise = replace(fit.noise, slack=SLACK[count])
        # 3. Noise settled: until a step promises next to nothing.
        elif settled:
            if not moved or promised < ENOUGH:
                break
        # 2. Near the solution: estimate the noise after every step until it settles.
        elif promised < READY * fit.windows.samples() or not moved:
            before = fit.noise
            fit.noise, settled = _retuned(fit, point)
            if fit.noise == before and promised < ENOUGH:
                break
            if (fit.noise.white, fit.noise.fix_m) != (before.white, before.fix_m):
                point = fit.again(point)
    return point, count


def _retuned(fit: StructuredFit, point: FitPoint) -> tuple[Noise, bool]:
    """Noise estimated anew at `point`: white noise from the residuals, latent acceleration by the evidence.

    The flag is True where it hardly changed. White noise that hardly changed is kept, which saves a linearisation.
    """
    estimate, change = white_from_residuals(fit.noise, point.at, fit.stated)
    noise, same = (fit.noise, True) if change < SAME_WHITE else (estimate, False)
    if fit.settings.latent:
        before = np.array(noise.latent)
        noise = fit.tune_latent(point, noise)
        same &= float(np.abs(np.log(np.array(noise.latent) / before)).max()) < SAME_LATENT
    return noise, same
