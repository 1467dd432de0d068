"""How well the regression recovers the polynomial that made the data, for each source of the accelerations.

exact         the polynomial's own accelerations
differences   7-point differences of the exact speeds, with and without the samples next to a change of force
noise         exact accelerations with correlated errors, speeds with white errors
sensors       IMU at 30 Hz, UWB at 1 Hz and 10 cm, smoothed
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from scipy.signal import lfilter

from companion.core.constants import NEUTRAL_US
from companion.core.geometry.frames import wrapped
from companion.logs.runs.run import Run, RunMeta
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.taylor.abkowitz import C
from sim.fitting.taylor.differences import derivative
from sim.fitting.taylor.pipeline import paper_motion
from sim.fitting.taylor.regression import Samples, TaylorFit
from sim.studies.paper.polynomial_log import PolynomialLog

SENSORS = SmootherNoise(position_m=0.10, psi_rad=0.005, r_rad_s=0.005, accel_m_s2=0.05)
"""Noise of the sensors in `measured`: those of deploy/boats/aritra.toml, tag and IMU at the origin."""
IMU_PER_STEP = 3  # 30 Hz for a log at 10 Hz


@dataclass(frozen=True)
class Recovery:
    """One or several fits against the truth. `coverage`: share of coefficients inside their 95 % intervals.

    `worst_abs`, `median_rel` (of coefficients that are not 0): errors; `median_se_rel`: standard errors likewise.
    """

    worst_abs: float
    median_rel: float
    coverage: float
    median_se_rel: float
    samples: int


def recovery(fits: Iterable[TaylorFit], truth: np.ndarray = C) -> Recovery:
    """Score fits of data that `truth` (3, 23) made."""
    fits = list(fits)
    error = np.abs(np.array([fit.C for fit in fits]) - truth)
    inside = error <= np.array([fit.half_width() for fit in fits])
    rated = truth != 0
    se = np.array([fit.se_robust for fit in fits])
    return Recovery(
        worst_abs=float(error.max()),
        median_rel=float(np.median((error / np.abs(np.where(rated, truth, 1)))[:, rated])),
        coverage=float(inside.mean()),
        median_se_rel=float(np.median((se / np.abs(np.where(rated, truth, 1)))[:, rated])),
        samples=fits[0].n,
    )


def differenced(logs: Sequence[PolynomialLog], *, across_steps: bool) -> list[Samples]:
    """Exact speeds, 7-point differences; `across_steps` False: without samples whose stencil meets a force change."""
    out = []
    for log in logs:
        nu_dot = derivative(log.x[:, 3:], 1 / log.rate_hz)
        keep = np.ones(len(nu_dot), dtype=bool)
        if not across_steps:
            keep[:3] = keep[-3:] = False
            for at in np.flatnonzero(np.diff(log.t_kgf, axis=0).any(axis=1)) + 1:
                keep[max(at - 2, 0) : at + 3] = False
        out.append(Samples(log.x[keep, 3:], nu_dot[keep], log.t_kgf[keep], log.rate_hz))
    return out


def noisy(
    logs: Sequence[PolynomialLog], rng: np.random.Generator, nu_dot_sigma: float, nu_sigma: float, time_s: float = 0.5
) -> list[Samples]:
    """Accelerations with first-order Gauss-Markov errors of `time_s`, speeds with white errors."""
    out = []
    for log in logs:
        keep = np.exp(-1 / (log.rate_hz * time_s))
        white = rng.normal(0, nu_dot_sigma * np.sqrt(1 - keep**2), log.nu_dot.shape)
        white[0] /= np.sqrt(1 - keep**2)
        error = lfilter([1.0], [1.0, -keep], white, axis=0)
        nu = log.x[:, 3:] + rng.normal(0, nu_sigma, log.nu_dot.shape)
        out.append(Samples(nu, log.nu_dot + error, log.t_kgf, log.rate_hz))
    return out


def measured(log: PolynomialLog, rng: np.random.Generator, sensors: SmootherNoise = SENSORS) -> Run:
    """The log as measured by the boat's sensors: IMU at three times the rate of the log, positions at 1 Hz."""
    k, n = len(log.x), IMU_PER_STEP
    rate = log.rate_hz * n
    t = np.arange((k - 1) * n + 1) / rate
    grid = np.arange(k) / log.rate_hz
    x = np.column_stack([np.interp(t, grid, column) for column in log.x.T])
    nu_dot = np.repeat(log.nu_dot, n, axis=0)[: len(t)]  # within a step the force holds and little else changes
    u, v, r = x[:, 3:].T
    accel = np.column_stack([nu_dot[:, 0] - v * r, nu_dot[:, 1] + u * r])
    accel += rng.normal(0, sensors.accel_bias_m_s2, 2) + rng.normal(0, sensors.accel_m_s2, accel.shape)
    psi = x[:, 2] + rng.normal(0, sensors.psi_rad, len(t))
    gyro = r + rng.normal(0, sensors.gyro_bias_rad_s) + rng.normal(0, sensors.r_rad_s, len(t))
    place = x[:, :2] + rng.normal(0, sensors.position_m, (len(t), 2))
    place[np.arange(len(t)) % round(rate) != 0] = np.nan
    columns = {"t_s": t, "pwm_none": np.full(len(t), float(NEUTRAL_US)), "battery_v": np.full(len(t), 15.0)}
    columns |= {"psi_rad": wrapped(psi), "r_rad_s": gyro}
    columns |= {"ax_m_s2": accel[:, 0], "ay_m_s2": accel[:, 1], "north_m": place[:, 0], "east_m": place[:, 1]}
    return Run(pl.DataFrame(columns).fill_nan(None), RunMeta(source="the paper's polynomial"))


def through_sensors(logs: Sequence[PolynomialLog], rng: np.random.Generator, *, by: str = "smoother") -> list[Samples]:
    """Samples after sensors and smoothing, forces known; `by`: smoother, or paper (filter, Lanczos, differences)."""
    out = []
    for log in logs:
        run = measured(log, rng)
        motion = smooth(run, SENSORS, log.rate_hz) if by == "smoother" else paper_motion(run, SENSORS)
        out.append(Samples(motion.nu, motion.nu_dot, log.t_kgf[: len(motion.nu)], log.rate_hz))
    return out
