"""Open-loop position errors of vessel files and Taylor series after 30 s, on an unseen log of a known boat.

All models start each window from the same state: the true one (exact), the smoother's, which has no vessel model
(smoothed), or the true one with errors of the size of the boat's filter (filter).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.engine.model import compile_model
from sim.fitting.engine.motion import WindowIntegrator
from sim.fitting.engine.noise import STATE, L
from sim.fitting.engine.parameters import Parameters, file_values
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.engine.windows import Windows, cut_windows
from sim.fitting.taylor.pipeline import held_commands
from sim.fitting.validate.models import TaylorSimulator
from sim.fitting.validate.protocol import STEP_S, Commands

HORIZON_S = 30.0
Start = Literal["exact", "smoothed", "filter"]
STARTS: tuple[Start, ...] = ("filter", "smoothed", "exact")
FILTER_SIGMA = (0.05, 0.05, 0.012, 0.02, 0.02, 0.005)
"""Of x y [m], psi [rad], u v [m/s], r [rad/s] as the project's filter knows them with UWB at 1 Hz: heading wander of
the vessel file, the rest as the main job's evidence finds it, rounded up."""
TRUTH = ("true_north_m", "true_east_m", "true_psi_rad", "true_u_m_s", "true_v_m_s", "true_r_rad_s")


def distances(
    unseen: Run,
    vessels: Mapping[str, VesselFile],
    taylor: Mapping[str, np.ndarray],
    start: Start,
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    """By model: distance [m] to the true position at the end of each window of `HORIZON_S`, (W,); inf if not finite.

    `taylor`: coefficients (3, 23) by name; forces by the thruster map of the vessel "file".
    """
    known = vessels["file"]
    windows = cut_windows([unseen], known, HORIZON_S)
    t, truth = unseen.samples(*TRUTH)
    truth[:, 2] = np.unwrap(truth[:, 2])
    x0 = _start(unseen, known, windows.t_s[:, 0], interpolated(windows.t_s[:, 0], t, truth), start, rng)
    end = interpolated(windows.t_s[:, -1], t, truth)[:, :2]
    structured = {name: _off(vessel_ends(windows, vessel, x0), end) for name, vessel in vessels.items()}
    series = {name: _off(_taylor_ends(unseen, windows, C, vessels["file"], x0), end) for name, C in taylor.items()}
    return structured | series


def vessel_ends(windows: Windows, vessel: VesselFile, x0: np.ndarray) -> np.ndarray:
    """Positions (W, 2) of the vessel file's model at the ends of the windows, from states `x0` (W, 6)."""
    W, K = windows.size
    z = np.zeros((W, L))
    z[:, STATE] = x0
    integrate = WindowIntegrator(windows, Parameters(vessel), compile_model(vessel, K, W))
    return integrate(file_values(vessel), z).x[:, -1, :2]


def _taylor_ends(unseen: Run, windows: Windows, C: np.ndarray, vessel: VesselFile, x0: np.ndarray) -> np.ndarray:
    """The same of a Taylor series with coefficients C (3, 23)."""
    begin, last = windows.t_s[:, 0], windows.t_s[:, -1]
    steps = np.round((last - begin) / STEP_S).astype(int)
    t = begin[:, None] + (np.arange(steps.max()) + 0.5) * STEP_S
    pwm, volts = held_commands(unseen, t.ravel())
    pwm = pwm.reshape(*t.shape, -1)
    states = TaylorSimulator("taylor", C, vessel).simulate(x0, Commands(pwm, volts.reshape(t.shape), pwm[:, :0]))
    return states[np.arange(len(steps)), steps, :2]


def _start(
    unseen: Run, vessel: VesselFile, t_s: np.ndarray, true: np.ndarray, start: Start, rng: np.random.Generator
) -> np.ndarray:
    """Initial states (W, 6) at `t_s` by the kind of `start`, from the true ones; headings on the branch of the true."""
    if start == "exact":
        return true
    if start == "filter":
        return true + rng.normal(size=true.shape) * np.array(FILTER_SIGMA)
    smoothed = smooth(unseen, SmootherNoise.of(vessel))
    x0 = interpolated(t_s, smoothed.t_s, np.hstack([smoothed.eta, smoothed.nu]))
    x0[:, 2] += 2 * np.pi * np.round((true[:, 2] - x0[:, 2]) / (2 * np.pi))
    return x0


def interpolated(t_s: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """`values` (k, n), known at `t` (k,), linearly interpolated at `t_s`."""
    return np.column_stack([np.interp(t_s, t, column) for column in values.T])


def _off(places: np.ndarray, end: np.ndarray) -> np.ndarray:
    far = np.hypot(*(places - end).T)
    return np.where(np.isfinite(far), far, np.inf)


def rms(distances_m: Sequence[float] | np.ndarray) -> float:
    """Root mean square; inf where one is."""
    with np.errstate(over="ignore"):
        return float(np.sqrt(np.mean(np.square(distances_m))))
