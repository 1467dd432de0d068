"""Trajectories of all windows, accelerations along them, and the feedback of hook forces on the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.fitting.diagnose.posterior.thrust import ThrusterForces


@dataclass(frozen=True)
class Accelerations:
    """Body accelerations [m/s^2, m/s^2, rad/s^2], at steps and between; a fourth axis may be P parameters.

    nodes         (W, K+1, 3, ..) at the steps of all windows
    mid_excess    (W, K, 3, ..) at the middle of each step beyond the mean of its ends
    """

    nodes: np.ndarray
    mid_excess: np.ndarray

    def times(self, step: np.ndarray) -> Accelerations:
        """Columns (.., P) times a step (P,) of the parameters."""
        return Accelerations(self.nodes @ step, self.mid_excess @ step)

    def plus(self, other: Accelerations) -> Accelerations:
        """The sum of both."""
        return Accelerations(self.nodes + other.nodes, self.mid_excess + other.mid_excess)


@dataclass(frozen=True)
class Feedback:
    """Linearised dependence of hook forces tau on the motion.

    slopes        (W, K+1, 3, 6) d(tau)/d[x y psi u v r]
    mass_ratio    (3, 3) M'^-1 M with M' = M - mean d(tau)/d(nu_dot)
    """

    slopes: np.ndarray
    mass_ratio: np.ndarray


@dataclass(frozen=True)
class WindowTrajectories:
    """Trajectories of all W windows at their K+1 steps, and what drove them.

    x             (W, K+1, 6) states [x y psi u v r]
    nu_dot        (W, K+1, 3)
    A             (W, K+1, 6, 6) d(x_dot)/dx
    M_inv         (3, 3) inverse mass matrix
    tau, water    (W, K+1, 3 or 3 + n) as `EffectPhysics.drive`, (W, K+1, 2) velocity beyond the file's [m/s]
    forces, hull  thruster forces before hooks [N]; (N_HULL,) coefficients
    feedback      of hook forces, already in A; None: none
    external      accelerations that were imposed, see `EffectPhysics.move`
    effect_ids    ids of the effects that were computed exactly
    """

    x: np.ndarray
    nu_dot: np.ndarray
    A: np.ndarray
    M_inv: np.ndarray
    tau: np.ndarray
    water: np.ndarray
    forces: ThrusterForces
    hull: np.ndarray
    feedback: Feedback | None
    external: Accelerations | None
    effect_ids: frozenset[str]

    def with_feedback(self, feedback: Feedback) -> WindowTrajectories:
        """The same with A[nu rows] = M'^-1 M (A + M^-1 d(tau)/dx): forces that depend on the motion."""
        A = self.A.copy()
        A[..., 3:, :] = feedback.mass_ratio @ (A[..., 3:, :] + self.M_inv @ feedback.slopes)
        return replace(self, A=A, feedback=feedback)
