"""Compass against course: whether the heading errs by how the boat is turned (hard iron), without a model.

    v / u = -(c + a cos psi + b sin psi)  +  k_0 r + k_1 r / u + k_2 / u  +  (V_e cos psi - V_n sin psi) / u

u, v: velocity over ground in the axes of the measured heading, smoothed without a model. A boat that makes way goes
about where it points: what of its drift follows the heading is the compass's. Turns (k_0, k_1: sideslip, lever arm of
the positions), a side force (k_2) and a current of each log's own (V_n, V_e) are free within their priors. Robust
regression (Huber 1964) on all logs at once; its covariance is that of the priors and the residuals' own by blocks
(sandwich), added, because blocks are few. A constant error c looks as a boat that pulls to one side, and is not told.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import polars as pl
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.apply_sensor_errors import calibrated
from companion.logs.runs.run import Run
from sim.fitting.engine.linearise import HUBER
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.wiring.record import SURE_NATS, WiringFinding

HARD_IRON = "compass:hard_iron"
"""Name of the finding."""
LEAST_M_S, STEEPEST = 0.4, 0.5
"""Rows are where the boat makes that much way, and drifts by no more than this share of it; assumed."""
STEP_S, BLOCK_S = 0.5, 10.0
PER_SAMPLE = 6.0  # rows that count as one: sway changes over seconds
LEAST = 30  # rows
LEAST_RAD = 0.03  # error of a row at least: sway of a boat that waves rock
SPREAD_RAD = 0.2  # sigma of c, a, b beforehand: a compass that is 11 degrees off is not rare; assumed
SLIP, ARM_M, SIDE_M_S, CURRENT_M_S = 1.0, 1.0, 0.1, 0.1  # sigmas of k_0, k_1, k_2 and of a current; assumed
SHARPEST_RAD = np.radians(2.5)  # sigma of the error from which on it is not told
INERTIAL = ("r_rad_s", "ax_m_s2", "ay_m_s2")
A, B = 4, 5
"""Places of a and b among the coefficients k_0 k_1 k_2 c a b."""


@dataclass(frozen=True)
class HardIron:
    """a, b [rad] of the heading's error a cos psi + b sin psi, their covariance (2, 2)."""

    a: float
    b: float
    covariance: np.ndarray

    @property
    def amplitude_rad(self) -> float:
        """Largest error."""
        return float(np.hypot(self.a, self.b))

    @property
    def nats(self) -> float:
        """Evidence that there is any: half the Mahalanobis distance from none."""
        both = np.array([self.a, self.b])
        return float(both @ np.linalg.solve(self.covariance, both)) / 2

    @property
    def sigma_rad(self) -> float:
        """Sigma of the less certain of both."""
        return float(np.sqrt(np.diag(self.covariance).max()))

    @property
    def is_clear(self) -> bool:
        """Whether it is told."""
        return self.nats >= SURE_NATS and self.sigma_rad <= SHARPEST_RAD

    def put_right(self, vessel: VesselFile) -> VesselFile:
        """The vessel file that knows of it."""
        imu = vessel.sensors.imu
        a, b = round(imu.hard_iron_cos_rad + self.a, 4), round(imu.hard_iron_sin_rad + self.b, 4)
        source = f"{imu.source}; hard iron by course over ground"
        imu = replace(imu, hard_iron_cos_rad=a, hard_iron_sin_rad=b, source=source)
        return replace(vessel, sensors=replace(vessel.sensors, imu=imu))


def compass_finding(runs: Mapping[str, Run], vessel: VesselFile) -> list[WiringFinding]:
    """What is told of the compass after all logs together: one finding or none. Here it is left as it is."""
    iron = hard_iron(list(runs.values()), vessel)
    if iron is None or not iron.is_clear:
        return []
    amplitude, sigma = np.degrees([iron.amplitude_rad, iron.sigma_rad])
    imu = iron.put_right(vessel).sensors.imu
    keys = f"hard_iron_cos_rad = {imu.hard_iron_cos_rad:.3f}, hard_iron_sin_rad = {imu.hard_iron_sin_rad:.3f}"
    finding = WiringFinding(
        name=HARD_IRON,
        text=f"the heading errs by up to {amplitude:.0f} (+- {2 * sigma:.0f}) degrees, by how the boat is turned",
        nats=round(iron.nats, 1),
        logs=tuple(runs),
        certain=False,
        advice=f"calibrate the compass where the boat sails, or have {keys} under [sensors.imu], as identify "
        "has where that predicts better",
    )
    return [finding]


def hard_iron(runs: list[Run], vessel: VesselFile) -> HardIron | None:
    """Estimate from all `runs`; None where none of them makes way for long enough."""
    # 1. Rows of all logs; a current of its own for each.
    parts = [_rows(run, vessel) for run in runs]
    if sum(len(y) for _, _, y, _ in parts) < LEAST:
        return None
    shared = np.vstack([X for X, _, _, _ in parts])
    currents = np.zeros((len(shared), 2 * len(parts)))
    first = 0
    for i, (_, current, y, _) in enumerate(parts):
        currents[first : first + len(y), 2 * i : 2 * i + 2] = current
        first += len(y)
    X, y = np.hstack([shared, currents]), np.concatenate([y for _, _, y, _ in parts])
    block = np.unique(np.concatenate([i + at * 1j for i, (_, _, _, at) in enumerate(parts)]), return_inverse=True)[1]
    prior = np.array([SLIP, ARM_M, SIDE_M_S, *[SPREAD_RAD] * 3, *[CURRENT_M_S] * currents.shape[1]])
    # 2. Robust regression: rows further off than Huber's limit weigh less.
    sigma, weight = 0.1, np.ones_like(y)
    for _ in range(20):
        W = (X * weight[:, None]).T / (sigma**2 * PER_SAMPLE)
        H = W @ X + np.diag(1 / prior**2)
        q = np.linalg.solve(H, W @ y)
        error = y - X @ q
        sigma = max(LEAST_RAD, 1.48 * float(np.median(np.abs(error))))
        weight = np.minimum(1.0, HUBER * sigma / np.maximum(np.abs(error), 1e-9))
    # 3. Covariance: H^-1 (H + sum of blocks' scores squared) H^-1.
    scores = np.zeros((block.max() + 1, len(q)))
    np.add.at(scores, block, X * (weight * error)[:, None] / (sigma**2 * PER_SAMPLE))
    inverse = np.linalg.inv(H)
    P = inverse @ (H + scores.T @ scores) @ inverse
    return HardIron(float(q[A]), float(q[B]), P[A : B + 1, A : B + 1])


def _rows(run: Run, vessel: VesselFile) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Columns of k_0 k_1 k_2 c a b (m, 6) and of the log's current (m, 2), v / u (m,), block (m,).

    Heading without the errors that the file states.
    """
    if np.ptp(run.measured_s()) < BLOCK_S:
        return np.zeros((0, 6)), np.zeros((0, 2)), np.zeros(0), np.zeros(0)
    blank = dict.fromkeys(INERTIAL, pl.lit(None, pl.Float64))  # an accelerometer's lean looks as sway
    noise = SmootherNoise.of(vessel)
    motion = smooth(calibrated(Run(run.table.with_columns(**blank), run.meta), vessel), noise, 1 / STEP_S)
    known = _is_near(motion.t_s, run.samples("north_m", "east_m")[0] - noise.latency_s)
    known &= _is_near(motion.t_s, run.samples("psi_rad")[0])
    u, v, r = motion.nu.T
    use = known & (np.abs(u) > LEAST_M_S) & (np.abs(v) < STEEPEST * np.abs(u))
    t_s, u, v, r, psi = (x[use] for x in (motion.t_s, u, v, r, motion.eta[:, 2]))
    c, s = np.cos(psi), np.sin(psi)
    shared = np.column_stack([r, r / u, 1 / u, -np.ones_like(u), -c, -s])
    return shared, np.column_stack([-s / u, c / u]), v / u, np.floor(t_s / BLOCK_S)


def _is_near(t_s: np.ndarray, samples_s: np.ndarray) -> np.ndarray:
    """Whether the next sample after each of `t_s` is near, (k,)."""
    return np.abs(samples_s[np.searchsorted(samples_s, t_s).clip(0, len(samples_s) - 1)] - t_s) < BLOCK_S / 4
