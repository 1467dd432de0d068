"""Multi-step output error: minimise the errors of open-loop predictions over a horizon (`HORIZON_S`).

    minimise over w   1/2 sum_w sum_k huber((x_w(t_k; q) - measured) / sigma)^2 / (K OVERLAP)
                      + 1/2 |(w - prior) / spread|^2

x_w: the model's trajectory from the measured state at the start of window w; K: compared instants of a window; q: file
units of w. Solved by Gauss-Newton.

For logs of poses alone (motion capture, or UWB and compass without an IMU), and wherever it predicts better
(`chosen_fit`). Poses cannot separate sensor noise from model error at the scale of a second, and model error is
correlated over many seconds, so that a likelihood of short windows weights the data wrongly. This fit minimises what
the model will be used for, its prediction error. Measured states are those of the smoother (`engine.smoothing`), which
has no model. Errors are correlated within a window, so the K instants of a window count as one sample of each channel.
Intervals that follow from this covered 96 % on simulated logs; a sandwich estimator over blocks of time only 80 % (as
few blocks as parameters): docs/cse1.md.
Source: Ljung (1999), System Identification, section 3.2 (k-step predictors as models).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.apply_sensor_errors import calibrated
from companion.logs.runs.nearest import distance
from companion.logs.runs.run import Run
from sim.fitting.engine.jacobian_rows import sensitivities
from sim.fitting.engine.kernels.windows import X0_D
from sim.fitting.engine.linearise import HUBER
from sim.fitting.engine.model import compile_model
from sim.fitting.engine.motion import WindowIntegrator
from sim.fitting.engine.noise import STATE, L
from sim.fitting.engine.parameters import SENSORS, WARP, Parameters
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.engine.windows import StructuredFitError, Windows, begin_s, cut_windows

HORIZON_S = 15.0  # 10 and 20 s predict alike; chosen on the even blocks of cse1's random_run1 (docs/cse1.md)
OVERLAP = 3  # number of windows that each instant lies in
STEP_S = 0.05  # of integration; with 0.1 s a hull that is strongly damped in yaw at speed (30 /s) runs away
EVERY_S = 0.5  # between the instants at which errors are compared
KNOWN_S = 0.5  # states further than this from every position sample are not compared: the smoother extrapolates there
FIRST_SHARE = 0.3  # first guess of sigma, as a share of the change of state over the horizon
ENOUGH = 0.05  # predicted decrease [nats] of a last step
FARTHEST = 3.0  # longest step, in sigmas of the prior
HELD = (*SENSORS, *WARP)
"""Parameters that are held at the file's values: poses do not determine them."""
CHANNELS = ("north", "east", "psi", "u", "v", "r")
Say = Callable[[str, float], None]


@dataclass(frozen=True)
class HorizonTarget:
    """States to predict: from x0 (W, 6), `measured` (W, m, 6) at the steps `at` (m,) of each window, NaN if unknown."""

    windows: Windows
    x0: np.ndarray
    at: np.ndarray
    measured: np.ndarray


def horizon_target(runs: Sequence[Run], vessel: VesselFile, horizon_s: float = HORIZON_S) -> HorizonTarget:
    """Overlapping windows of all runs, with the smoother's states [x y psi u v r].

    Of `vessel`: its sensors and its thrusters' map, so that one target serves fits with different terms.
    """
    offsets = tuple(k * horizon_s / OVERLAP for k in range(OVERLAP))
    windows = cut_windows(runs, vessel, horizon_s, tied=False, offsets_s=offsets)
    usual_s = float(np.median(windows.h_s[windows.h_s > 0]))
    thin = max(1, round(STEP_S / usual_s))
    t_s = windows.t_s[:, ::thin]
    around_s = tuple(around[:, ::thin] for around in windows.around_s)
    windows = replace(windows, t_s=t_s, h_s=np.diff(t_s, axis=1), around_s=around_s)
    every = max(1, round(EVERY_S / (thin * usual_s)))
    at = np.arange(every, t_s.shape[1], every)
    x0, measured = np.zeros((len(t_s), 6)), np.zeros((len(t_s), len(at), 6))
    for i, run in enumerate(runs):
        smoothed = smooth(calibrated(run, vessel), SmootherNoise.of(vessel))
        states = np.hstack([smoothed.eta, smoothed.nu])
        fixes = run.samples("north_m", "east_m")[0]
        for span in windows.spans[i * OVERLAP : (i + 1) * OVERLAP]:
            x0[span] = _at(t_s[span, 0], smoothed.t_s, states)
            measured[span] = _at(t_s[span][:, at], smoothed.t_s, states)
            measured[span][distance(fixes, t_s[span][:, at]) > KNOWN_S] = np.nan
            measured[span][windows.h_s[span][:, at - 1] == 0] = np.nan  # beyond the window's end
    return HorizonTarget(windows, x0, at, measured)


def least_s(horizon_s: float) -> float:
    """Seconds with heading and commands that predicting `horizon_s` ahead takes: two windows of the latest series."""
    return horizon_s * (2 + (OVERLAP - 1) / OVERLAP)


def reaches(run: Run, horizon_s: float) -> bool:
    """Whether a run is long enough to predict `horizon_s` ahead in it."""
    return float(run.samples("psi_rad")[0][-1]) - begin_s(run) > least_s(horizon_s)


def _at(t_s: np.ndarray, known_s: np.ndarray, states: np.ndarray) -> np.ndarray:
    """`states` (k, n), known at `known_s` (k,), interpolated at `t_s`: (*t_s.shape, n)."""
    return np.stack([np.interp(t_s, known_s, column) for column in states.T], axis=-1)


@dataclass(frozen=True)
class HorizonPoint:
    """One iterate: w (P,), errors (W, m, 6), cost [nats], gradient by window `scores` (W, P), Hessian H (P, P)."""

    w: np.ndarray
    error: np.ndarray
    cost: float
    scores: np.ndarray
    H: np.ndarray


class HorizonFit:
    """One fit: windows, parameters, present sigmas of the errors, and the steps towards the solution (`solve`)."""

    def __init__(self, target: HorizonTarget, parameters: Parameters) -> None:
        self.target, windows = target, target.windows
        W, K = windows.size
        self.parameters = parameters
        self.move = WindowIntegrator(
            windows, parameters, compile_model(parameters.vessel, K, W, parameters.surroundings)
        )
        self._z = np.zeros((W, L))
        self._z[:, STATE] = self.target.x0
        self.sigma = error_sigma(FIRST_SHARE * (self.target.measured - self.target.x0[:, None]))

    def point(self, w: np.ndarray) -> HorizonPoint:
        """Errors, cost, gradient and Gauss-Newton Hessian at w; cost inf where a window runs away."""
        # 1. Errors of the predictions, and their Huber weights.
        q, goal = self.parameters.file_units(w), self.target
        motion = self.move(q, self._z)
        error = motion.x[:, goal.at] - goal.measured
        known = np.isfinite(goal.measured)
        if not np.isfinite(error[known]).all():  # it runs away: no step may end here
            return HorizonPoint(w, error, np.inf, np.zeros((len(error), len(w))), np.eye(len(w)))
        z = np.where(known, error, 0.0) / self.sigma
        size = np.abs(z)
        root = np.sqrt(np.minimum(1.0, HUBER / np.maximum(size, 1e-9)) / (len(goal.at) * OVERLAP))
        # 2. Jacobian of the weighted errors by w: dx/dq dq/dw.
        S = sensitivities(motion.A, motion.pushes, goal.windows.h_s)[:, goal.at, :, X0_D:]
        J = np.zeros((*S.shape[:3], len(w)))
        J[..., self.parameters.moving] = S
        J = (J @ self.parameters.jacobian(w)) * (known * root / self.sigma)[..., None]
        J = J.reshape(len(J), -1, len(w))
        scores = (J.swapaxes(1, 2) @ (root * z).reshape(len(J), -1, 1))[..., 0]
        # 3. Cost and Hessian with the priors.
        mean, spread = self.parameters.prior
        rho = np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2)
        cost = 0.5 * float(rho.sum()) / (len(goal.at) * OVERLAP) + 0.5 * float((((w - mean) / spread) ** 2).sum())
        H = (J.swapaxes(1, 2) @ J).sum(axis=0) + np.diag(1 / spread**2)
        return HorizonPoint(w, error, cost, scores, H)

    def step(self, point: HorizonPoint) -> tuple[HorizonPoint, float]:
        """One damped Gauss-Newton step that lowers the cost, and the decrease that was predicted [nats].

        The same point where no step lowers the cost.
        """
        mean, spread = self.parameters.prior
        gradient, damping = point.scores.sum(axis=0) + (point.w - mean) / spread**2, 0.0
        for _ in range(8):
            dw = -np.linalg.solve(point.H + damping * np.diag(1 / spread**2), gradient)
            promised = -0.5 * float(gradient @ dw)
            if np.abs(dw / spread).max() < FARTHEST:
                with np.errstate(all="ignore"):  # a trial may diverge; it is refused then
                    trial = self.point(point.w + dw)
                if trial.cost < point.cost:
                    return trial, promised
            damping = max(10 * damping, 1.0)
        return point, 0.0

    def covariance(self, point: HorizonPoint) -> np.ndarray:
        """Covariance of w, (P, P): inverse of the Hessian, in which a window counts as one sample of each channel."""
        return np.linalg.inv(point.H)


def solve(fit: HorizonFit, most: int, say: Say) -> tuple[HorizonPoint, int]:
    """Iterate from the priors' centres to convergence, `most` steps at most. Returns the last iterate and their number.

    Near a solution the sigmas are estimated from the errors, until they hardly change. Raises StructuredFitError where
    the vessel file's own numbers run away.
    """
    point, count, settled = fit.point(fit.parameters.prior[0]), 0, False
    if point.cost == np.inf:
        name = fit.parameters.vessel.name
        raise StructuredFitError(
            f"{name}: with these commands the model of the vessel file runs away within a window; look at its damping "
            "and terms, which act too strongly for steps of "
            f"{float(fit.target.windows.h_s.max()):.2g} s"
        )
    while count < most:
        point, promised = fit.step(point)
        count += 1
        say(f"step {count}: {promised:.2f} nats", min(1.0, count / 15))
        if settled and promised < ENOUGH:
            break
        if not settled and (promised < 1.0 or count > most // 2):
            sigma = error_sigma(point.error)
            settled = bool(np.abs(np.log(sigma / fit.sigma)).max() < 0.05) or count > most // 2
            fit.sigma = sigma
            point = fit.point(point.w)
    return point, count


def error_sigma(error: np.ndarray) -> np.ndarray:
    """Sigma of each channel (6,): root mean square of the known errors, clipped at their 90 % quantile.

    Both axes of position share one.
    """
    size = np.abs(error).reshape(-1, 6)
    size = size[np.isfinite(size).all(axis=1)]
    sigma = np.sqrt((np.minimum(size, np.quantile(size, 0.9, axis=0)) ** 2).mean(axis=0))
    sigma[:2] = np.sqrt((sigma[:2] ** 2).mean())
    return np.maximum(sigma, 1e-6)


def with_tag_fixed(parameters: Parameters) -> Parameters:
    """The parameters with the tag's latency, place and warp fixed (`HELD`)."""
    fixed = dict.fromkeys(HELD, (None, 0.0))
    return replace(parameters, overrides={**fixed, **(parameters.overrides or {})})
