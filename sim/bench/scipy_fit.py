"""The same problem the plain way, to compare times: scipy least_squares with finite differences.

Open-loop prediction of windows from measured states, which stay as they are: with the states of 70 windows free as well
each Jacobian would need some 440 simulations instead of 22.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.identify.structured_fit import FitSettings, StructuredFit

WINDOW_S = 20.0


@dataclass(frozen=True)
class PeerResult:
    """Parameters in file units (P,), time, and how many simulations of the whole run that took."""

    q: np.ndarray
    seconds: float
    simulations: int


def scipy_fit(run: Run, vessel: VesselFile, *, window_s: float = WINDOW_S, most: int = 30) -> PeerResult:
    """Fit with at most `most` Jacobians; the vessel file's noise weighs the residuals."""
    fit = StructuredFit([run], vessel, FitSettings(window_s=window_s, latent=False))
    fit.noise = replace(fit.noise, latent=(1e-9, 1e-9, 1e-9))
    start = fit.begin()
    mean, spread = fit.parameters.prior
    count = 0

    def residual(s: np.ndarray) -> np.ndarray:
        nonlocal count
        count += 1
        q = fit.parameters.file_units(mean + spread * s)
        motion = fit.problem.move(q, start.z)
        imu = fit.problem.imu.residual(motion, q, start.z, fit.noise)
        return np.concatenate(
            [imu[np.isfinite(imu)], fit.problem.tag.residual(fit.problem.tag.path(motion, q), q, fit.noise).ravel(), s]
        )

    began = time.perf_counter()
    found = least_squares(residual, np.zeros(len(mean)), jac="2-point", method="trf", loss="soft_l1", max_nfev=most)
    return PeerResult(fit.parameters.file_units(mean + spread * found.x), time.perf_counter() - began, count)
