"""Fisher information on the parameters in recorded or planned logs, with the motion itself unknown.

    I = sum over runs of J^T R^-1 J with the nodes (states, biases, latent acceleration) eliminated, in terms of w
    C = (P_prior^-1 + I)^-1,      covariance of q:  T C T^T,  T = dq/dw

Runs do not share nodes, so information is additive over them. J and the elimination are those of the structured fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.engine.noise import STATE, L
from sim.fitting.engine.parameters import HULL, Parameters
from sim.fitting.engine.split import NamedLog, reject_overlap, split_at_pauses, usable
from sim.fitting.engine.windows import Windows
from sim.fitting.identify.result import UNDETERMINED
from sim.fitting.identify.structured_fit import FitSettings, StructuredFit, solve
from sim.fitting.wiring.levelling import levelled

TRUTH = tuple(f"true_{name}" for name in ("north_m", "east_m", "psi_rad", "u_m_s", "v_m_s", "r_rad_s"))
PLANNED = FitSettings(latent=False)
"""Settings for planned runs: they are simulated with the model itself, so there is no model error."""


@dataclass(frozen=True)
class Knowledge:
    """Knowledge of a vessel's parameters: precision of w (P, P), prior included, at the value w (P,)."""

    vessel: VesselFile
    precision: np.ndarray
    w: np.ndarray
    settings: FitSettings = PLANNED

    @classmethod
    def prior(cls, vessel: VesselFile, settings: FitSettings = PLANNED) -> Knowledge:
        """The prior of the vessel file, before any log."""
        mean, sigma = settings.parameters(vessel).prior
        return cls(vessel, np.diag(1 / sigma**2), mean, settings)

    def with_information(self, information: np.ndarray) -> Knowledge:
        """Knowledge after a run with this Fisher information (P, P)."""
        return Knowledge(self.vessel, self.precision + information, self.w, self.settings)

    @cached_property
    def parameters(self) -> Parameters:
        """Names of the parameters, and the maps between w and q."""
        return self.settings.parameters(self.vessel)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of w, (P, P)."""
        return np.linalg.inv(self.precision)

    @cached_property
    def share(self) -> np.ndarray:
        """Posterior over prior sigma of each w, (P,)."""
        return np.sqrt(np.diag(self.covariance)) / self.parameters.prior[1]

    @cached_property
    def value(self) -> np.ndarray:
        """Value q (P,) in file units."""
        return self.parameters.file_units(self.w)

    @cached_property
    def se(self) -> np.ndarray:
        """Standard error of q, (P,)."""
        T = self.parameters.jacobian(self.w)
        return np.sqrt(np.diag(T @ self.covariance @ T.T))

    @property
    def undetermined(self) -> np.ndarray:
        """Mask (P,) of the undetermined parameters: more than `UNDETERMINED` of the prior sigma is left."""
        return self.share > UNDETERMINED


def indices_of_interest(vessel: VesselFile) -> np.ndarray:
    """Indices of the parameters that manoeuvres are designed for: inertia, damping, gains, dead time, lag."""
    return np.arange(len(HULL) + len(vessel.thrusters) + 2)


def planned_information(run: Run, vessel: VesselFile, settings: FitSettings = PLANNED) -> np.ndarray:
    """Fisher information (P, P) of a noise-free run of the vessel file's own boat, at true states and parameters."""
    fit = StructuredFit([run], vessel, replace(settings, latent=False))
    z = np.zeros((fit.windows.size[0], L))
    z[:, STATE] = true_nodes(fit.windows, run)
    return _information(fit, fit.parameters.prior[0], z)


def recorded_knowledge(runs: Sequence[Run], vessel: VesselFile) -> Knowledge:
    """Knowledge from recorded runs, prepared as for any fit: a structured fit, and the information at its solution.

    Raises JobError, RunError or StructuredFitError (all ValueError) naming the run that cannot be used.
    """
    logs = levelled([usable(NamedLog(run.meta.source, run), vessel) for run in runs])
    reject_overlap(logs)
    fit = StructuredFit([piece for log in logs for piece in split_at_pauses(log.run)], vessel, FitSettings())
    point, _ = solve(fit)
    precision = fit.assemble(point, fit.noise)[0].solve()[2]
    return Knowledge(vessel, precision, point.w)


def _information(fit: StructuredFit, w: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Information (P, P) of the fit's data at w (P,) and nodes z (W, L): Hessian of w less the prior's."""
    chain = fit.assemble(fit.point(w, z), fit.noise)[0]
    _, sigma = fit.parameters.prior
    return chain.solve()[2] - np.diag(1 / sigma**2)


def true_nodes(windows: Windows, run: Run) -> np.ndarray:
    """True state at the start of each window, (W, 6), from the run's truth columns."""
    t, truth = run.samples(*TRUTH)
    truth[:, 2] = np.unwrap(truth[:, 2])
    return np.column_stack([np.interp(windows.t_s[:, 0], t, column) for column in truth.T])
