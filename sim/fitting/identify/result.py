"""Result of a structured fit: estimates with intervals, what the data leave undetermined, statistics of the residuals.

    C_w = H^-1 (posterior covariance of w),   C_q = T C_w T^T,   T = dq/dw

A parameter, or a direction in the space of w, counts as determined if the data reduce its prior sigma to at most
`UNDETERMINED` of itself.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.engine.block_tridiagonal import Chain
from sim.fitting.engine.free_parameters import unit_of
from sim.fitting.engine.noise import OFFSET
from sim.fitting.engine.parameters import Parameters
from sim.fitting.engine.wind import OF_THE_DAY
from sim.fitting.identify.horizon import CHANNELS as ERROR_NAMES
from sim.fitting.identify.horizon import HELD, HORIZON_S, HorizonFit, horizon_target, with_tag_fixed
from sim.fitting.identify.horizon import solve as solve_horizon
from sim.fitting.identify.structured_fit import WINDOWS_S, FitPoint, FitSettings, Say, StructuredFit, solve

Z95 = 1.959964
COLOURED = 0.2  # lag-1 correlation of whitened residuals from which the model misses something within a window
UNDETERMINED = 0.7  # posterior over prior sigma; above it the prior holds half of the information
INERTIAL = ("r_rad_s", "ax_m_s2", "ay_m_s2")
CHANNEL_NAMES = ("psi", "r", "ax", "ay")


class Estimate(msgspec.Struct, frozen=True, kw_only=True):
    """One parameter in file units: value, standard error, 95 % interval.

    `share_of_prior`: posterior over prior sigma of its w; `determined` if at most `UNDETERMINED`.
    """

    name: str
    value: float
    se: float
    ci95: tuple[float, float]
    unit: str
    share_of_prior: float
    determined: bool


class OpenDirection(msgspec.Struct, frozen=True, kw_only=True):
    """A combination of parameters that the data do not determine.

    `share_of_prior`: posterior over prior sigma along it. `parts`: change of each w, relative to the largest.
    """

    share_of_prior: float
    parts: dict[str, float]


class ResidualChannel(msgspec.Struct, frozen=True, kw_only=True):
    """Whitened residuals of one channel: number, estimated white `sigma`, rms over sigma, lag-1 correlation."""

    name: str
    count: int
    sigma: float
    rms: float
    lag1: float


class FitResult(msgspec.Struct, frozen=True, kw_only=True):
    """Result of `fit_structured`.

    covariance    (P, P) of the parameters in their order, file units
    latent        sigma of the latent acceleration of u_dot, v_dot [m/s^2], r_dot [rad/s^2]
    latent_share  the same over the rms of commanded force over inertia; 1e-3, the floor: none
    horizon_s     horizon of multi-step output error (then there is no latent acceleration); 0: fit of windows
    white         residuals are uncorrelated, or the intervals allow for it; else the intervals are too narrow
    heading_offset_rad  constant error of the heading, by all runs, each by what it tells
    samples       instants with inertial data or heading; fixes: positions
    iterations    Gauss-Newton steps; seconds: wall time
    """

    parameters: tuple[Estimate, ...]
    covariance: tuple[tuple[float, ...], ...]
    directions: tuple[OpenDirection, ...]
    channels: tuple[ResidualChannel, ...]
    latent: tuple[float, float, float]
    latent_share: tuple[float, float, float]
    window_s: float
    horizon_s: float = 0.0
    white: bool
    samples: int
    fixes: int
    iterations: int
    converged: bool
    seconds: float
    data_hashes: tuple[str, ...]
    vessel: str
    heading_offset_rad: float = 0.0

    @property
    def q(self) -> np.ndarray:
        """Values in the order of `Parameters.names`."""
        return np.array([p.value for p in self.parameters])

    @property
    def held(self) -> tuple[str, ...]:
        """Names of parameters that are held at the file's values: by the method, or a wind that was measured."""
        measured = (p.name for p in self.parameters if p.name in OF_THE_DAY and not p.value)
        return HELD if self.horizon_s else tuple(measured)

    def holds(self, head: str, value: float) -> bool:
        """Whether the intervals of all parameters whose names begin with `head` hold `value`."""
        return all(p.ci95[0] <= value <= p.ci95[1] for p in self.parameters if p.name.startswith(head))

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name; KeyError where there is none."""
        estimate = next((p for p in self.parameters if p.name == name), None)
        if estimate is None:
            raise KeyError(name)
        return estimate


def fit_structured(
    runs: Sequence[Run], vessel: VesselFile, settings: FitSettings | None = None, say: Say = lambda _text, _share: None
) -> FitResult:
    """Fit the model of `vessel` to runs. Raises StructuredFitError where a run cannot be used.

    Multi-step output error for logs without inertial sensors, else the fit of windows, which is repeated with shorter
    windows where the residuals are not white; one that does not converge takes the place of none that does.
    `say(text, share)` is called with progress.
    """
    began, settings = time.perf_counter(), settings or FitSettings()
    horizon_s = settings.horizon_s
    if horizon_s is None:
        horizon_s = 0.0 if any(run.known(c) for run in runs for c in INERTIAL) else HORIZON_S
    if horizon_s:
        result = _fit_horizon(runs, vessel, settings, horizon_s, say)
        return msgspec.structs.replace(result, seconds=time.perf_counter() - began)
    first, *finer = (settings.window_s,) if settings.window_s else WINDOWS_S
    result = _fit_once(runs, vessel, replace(settings, window_s=first), say)
    for window_s in finer:
        if not result.white:
            shorter = _fit_once(runs, vessel, replace(settings, window_s=window_s), say)
            result = shorter if shorter.converged or not result.converged else result
    return msgspec.structs.replace(result, seconds=time.perf_counter() - began)


def _fit_once(runs: Sequence[Run], vessel: VesselFile, settings: FitSettings, say: Say) -> FitResult:
    fit = StructuredFit(runs, vessel, settings)
    point, iterations = solve(fit, say)
    return fit_result(fit, point, iterations, runs)


def _fit_horizon(
    runs: Sequence[Run], vessel: VesselFile, settings: FitSettings, horizon_s: float, say: Say
) -> FitResult:
    """The result of multi-step output error."""
    parameters = with_tag_fixed(settings.parameters(vessel))
    fit = HorizonFit(horizon_target(runs, vessel, horizon_s), parameters)
    point, iterations = solve_horizon(fit, settings.iterations, say)
    C_w = fit.covariance(point)
    C_q, share = _spread_of(parameters, point.w, C_w)
    return FitResult(
        parameters=_estimates(parameters, parameters.file_units(point.w), C_q, share),
        covariance=tuple(tuple(map(float, row)) for row in C_q),
        directions=_directions(C_w, parameters.prior[1], parameters.names),
        channels=tuple(
            _channel(name, (point.error[..., i] / fit.sigma[i]).ravel(), float(fit.sigma[i]))
            for i, name in enumerate(ERROR_NAMES)
        ),
        latent=(0.0, 0.0, 0.0),
        latent_share=(0.0, 0.0, 0.0),
        window_s=horizon_s,
        horizon_s=horizon_s,
        white=True,
        samples=sum(len(run.samples("psi_rad")[0]) for run in runs),
        fixes=sum(len(run.samples("north_m", "east_m")[0]) for run in runs),
        iterations=iterations,
        seconds=0.0,
        converged=iterations < settings.iterations,
        data_hashes=tuple(run.data_hash for run in runs),
        vessel=parameters.vessel.name,
    )


def fit_result(fit: StructuredFit, point: FitPoint, iterations: int, runs: Sequence[Run]) -> FitResult:
    """The result at a converged iterate of the fit of windows."""
    parameters, chain = fit.parameters, fit.assemble(point, fit.noise)[0]
    C_w = np.linalg.inv(chain.solve()[2])
    C_q, share = _spread_of(parameters, point.w, C_w)
    channels = _channels(fit, point)
    return FitResult(
        parameters=_estimates(parameters, parameters.file_units(point.w), C_q, share),
        covariance=tuple(tuple(map(float, row)) for row in C_q),
        directions=_directions(C_w, parameters.prior[1], parameters.names),
        channels=channels,
        latent=fit.noise.latent,
        latent_share=_triple(np.array(fit.noise.latent) / fit.command_rms),
        window_s=fit.settings.window_s or 0.0,
        white=all(abs(c.lag1) < COLOURED + 2 / np.sqrt(c.count) for c in channels),
        samples=fit.windows.samples(),
        fixes=len(fit.windows.fixes.t_s),
        iterations=iterations,
        seconds=0.0,
        converged=iterations < fit.settings.iterations,
        data_hashes=tuple(run.data_hash for run in runs),
        vessel=parameters.vessel.name,
        heading_offset_rad=_heading_offset(fit, point, chain),
    )


def _heading_offset(fit: StructuredFit, point: FitPoint, chain: Chain) -> float:
    """Constant error of the heading [rad] by all runs, each by what it tells: a short one that hardly moves, nothing.

    sum (o / v) / (sum (1 / v - 1 / p) + 1 / p)     o, v: estimate and variance of a run; p: variance of the prior
    """
    first, prior = fit.windows.first, fit.noise.offset_rad**-2
    information = 1.0 / chain.covariance()[first, OFFSET, OFFSET]
    return float(point.z[first, OFFSET] @ information / (np.maximum(information - prior, 0.0).sum() + prior))


def _spread_of(parameters: Parameters, w: np.ndarray, C_w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of q (P, P) at w, and posterior over prior sigma of each w (P,)."""
    T = parameters.jacobian(w)
    return T @ C_w @ T.T, np.sqrt(np.diag(C_w)) / parameters.prior[1]


def _estimates(parameters: Parameters, q: np.ndarray, C_q: np.ndarray, share: np.ndarray) -> tuple[Estimate, ...]:
    """Estimates from q (P,), its covariance (P, P) and the shares of the prior (P,)."""
    positive = parameters.is_positive()
    estimates = []
    for i, name in enumerate(parameters.names):
        se = float(np.sqrt(C_q[i, i]))
        estimates.append(
            Estimate(
                name=name,
                value=float(q[i]),
                se=se,
                ci95=_interval(float(q[i]), se, bool(positive[i])),
                unit=unit_of(name),
                share_of_prior=float(share[i]),
                determined=bool(share[i] <= UNDETERMINED),
            )
        )
    return tuple(estimates)


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    x, y, n = map(float, values)
    return x, y, n


def _interval(value: float, se: float, positive: bool) -> tuple[float, float]:
    """95 % interval: symmetric in the logarithm for a parameter that keeps its sign, else symmetric."""
    if not positive or value == 0.0:
        return value - Z95 * se, value + Z95 * se
    low, high = sorted((value * np.exp(-Z95 * se / abs(value)), value * np.exp(Z95 * se / abs(value))))
    return float(low), float(high)


def _directions(C_w: np.ndarray, spread: np.ndarray, names: tuple[str, ...]) -> tuple[OpenDirection, ...]:
    """Undetermined principal axes of the posterior covariance in units of the prior, the widest first."""
    values, axes = np.linalg.eigh(C_w / np.outer(spread, spread))
    directions = []
    for value, axis in sorted(zip(values, axes.T, strict=True), key=lambda pair: -pair[0]):
        if np.sqrt(value) <= UNDETERMINED:
            break
        change = axis * spread
        change /= change[np.abs(axis).argmax()]
        order = [int(i) for i in np.argsort(-np.abs(axis)) if abs(axis[i]) > 0.01]
        parts = {names[i]: round(float(change[i]), 3) for i in order}
        directions.append(OpenDirection(share_of_prior=float(np.sqrt(value)), parts=parts))
    return tuple(directions)


def _channels(fit: StructuredFit, point: FitPoint) -> tuple[ResidualChannel, ...]:
    """Residual statistics of each channel of the fit of windows."""
    channels = []
    for i, name in enumerate(CHANNEL_NAMES):
        series = point.at.residuals[..., i].ravel()
        series = series[np.isfinite(series)]
        if len(series) > 2:
            channels.append(_channel(name, series, fit.noise.white[i]))
    for axis, name in enumerate(("fix_north", "fix_east")):
        channels.append(_channel(name, point.at.fix_residuals[:, axis], fit.noise.fix_m))
    return tuple(channels)


def _channel(name: str, series: np.ndarray, sigma: float) -> ResidualChannel:
    """Statistics of one channel from its whitened residuals in order of time; NaN are left out."""
    series = series[np.isfinite(series)]
    square = float(series @ series)
    lag1 = float(series[1:] @ series[:-1]) / square
    return ResidualChannel(
        name=name, count=len(series), sigma=sigma, rms=float(np.sqrt(square / len(series))), lag1=lag1
    )
