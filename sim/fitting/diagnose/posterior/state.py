"""Windows in motion, accelerations along them, and what the forces on them go by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.fitting.diagnose.posterior.thrust import ThrusterForces


@dataclass(frozen=True)
class Accelerations:
    """Of surge, sway and yaw: at nodes (W, K+1, 3, ..), and what mid-steps have beyond the mean of both ends

    (W, K, 3, ..); the rest may be parameters.
    """

    nodes: np.ndarray
    mid_excess: np.ndarray

    def times(self, step: np.ndarray) -> Accelerations:
        """Of a step (P,) of the parameters."""
        return Accelerations(self.nodes @ step, self.mid_excess @ step)

    def plus(self, other: Accelerations) -> Accelerations:
        """Both together."""
        return Accelerations(self.nodes + other.nodes, self.mid_excess + other.mid_excess)


@dataclass(frozen=True)
class Feedback:
    """Of forces on the motion that they depend on: slopes to x y psi u v r (W, K+1, 3, 6), and M'^-1 M (3, 3).

    M': M less the mean slope of the forces to u_dot v_dot r_dot.
    """

    slopes: np.ndarray
    mass_ratio: np.ndarray


@dataclass(frozen=True)
class WindowTrajectories:
    """All windows in motion: x (W, K+1, 6), nu_dot, A = d(x_dot)/dx, M^-1 (3, 3), and what drove them (`drive`).

    `feedback`: what the effects' forces add to A; `given`: accelerations that came from outside the effects, see
    `Physics.move`; `by`: ids of these.
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
        """As it moves where its forces depend on it."""
        A = self.A.copy()
        A[..., 3:, :] = feedback.mass_ratio @ (A[..., 3:, :] + self.M_inv @ feedback.slopes)
        return replace(self, A=A, feedback=feedback)
