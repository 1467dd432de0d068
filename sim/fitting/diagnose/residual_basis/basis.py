"""Variables of the basis functions at a fitted point: means over windows, thruster forces within; their groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter, Scene, Values
from sim.fitting.diagnose.catalogue.parts import body_to_ned, hull_damping, ned_to_body
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.residual_basis.group import SIZES, FunctionGroup, function_group, window_means
from sim.fitting.engine.noise import LATENT, L

Functions = Mapping[str, np.ndarray]
"""Values of functions in all windows, (W,)."""
Factors = Mapping[str, np.ndarray]
"""Changes of the thruster forces at all nodes, (W, K + 1, n)."""


class Basis:
    """Variables at `point` on the W windows of K steps of `physics`, with n thrusters.

    x, psi, clock    (W, 6), (W,), (W,) mean state, heading [rad] and shared time [s] of each window
    f                (W, K + 1, n) thruster forces [N]
    turn, M          (3, 3) transposed inverse mass matrix, mass matrix
    accelerations    (W, K + 1, 3) by the model's forces in an inertial frame, body axes: nu_dot - d + [-r v, r u, 0]
    """

    def __init__(self, physics: EffectPhysics, point: LinearisationPoint):
        self.physics, self.point = physics, point
        self.names = [t.name for t in physics.vessel.thrusters]
        state = point.state
        self.W = len(state.x)
        self.x = self.mean(state.x)
        self.psi = self.x[:, 2]
        self.clock = self.mean(physics.clock_s[..., None])[:, 0]
        self.f = state.forces.f
        self.turn, self.M = state.M_inv.T, np.linalg.inv(state.M_inv)
        self.scene = physics.scene(state)
        own = state.nu_dot - point.z[:, None, LATENT]
        turning = state.x[..., 5:] * np.stack([-state.x[..., 4], state.x[..., 3], 0 * state.x[..., 3]], axis=2)
        self.accelerations = own + turning

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean over each window, (W, K or K + 1, c) -> (W, c)."""
        return window_means(self.physics, values)

    def axes(self, letters: str) -> list[np.ndarray]:
        """Unit accelerations (W, 3) in body axes by letter: X, Y, K (yaw) of the body, N, E over ground."""
        out = {}
        for i, letter in enumerate("XYK"):
            out[letter] = np.tile(np.eye(3)[i], (self.W, 1))
        for letter, ne in (("N", (1.0, 0.0)), ("E", (0.0, 1.0))):
            out[letter] = np.column_stack([*ned_to_body(self.psi, *ne), np.zeros(self.W)])
        return [out[letter] for letter in letters]

    def velocity(self) -> np.ndarray:
        """Velocity over ground, north and east, (W, 2) [m/s]."""
        return np.stack(body_to_ned(self.psi, self.x[:, 3], self.x[:, 4]), axis=1)

    @cached_property
    def water(self) -> list[np.ndarray]:
        """Accelerations (W, 3) by a current of 1 m/s to the north, and to the east."""

        def flow(p: Values, scene: Scene) -> np.ndarray:
            return np.broadcast_to(np.array([p["north"], p["east"]]), (*scene.t_s.shape, 2))

        parameters = tuple(EffectParameter(n, "m/s", 1.0, np.inf, SIZES["water"]) for n in ("north", "east"))
        effect = Effect("generic:flow", "generic", "", "", parameters, {"water": flow})
        out = self.physics.accelerations([effect], {}, self.point.state, [effect]).nodes
        return [self.mean(out[..., i]) for i in range(2)]

    @cached_property
    def damping(self) -> np.ndarray:
        """Accelerations by the hull's damping, (W, 3): -M^-1 D(nu_r) nu_r."""
        return -self.mean(hull_damping(self.physics.vessel, self.scene)) @ self.turn

    def on_nodes(
        self, name: str, words: tuple[str, ...], kind: str, entries: Sequence[int | np.ndarray], functions: Functions
    ) -> FunctionGroup:
        """Group of each function times each of `entries`: index of an entry of the node, or accelerations (W, 3)."""
        columns, names = [], []
        for key, value in functions.items():
            for i, entry in enumerate(entries):
                node = np.zeros((self.W, L))
                if isinstance(entry, int):
                    node[:, entry] = value
                else:
                    node[:, LATENT] = value[:, None] * entry
                columns.append(node)
                names.append(f"{key} {i}")
        return function_group(name, words, kind, names, np.stack(columns, axis=2))

    def of_thrust(
        self, name: str, words: tuple[str, ...], factors: Factors, kind: str = "share", mine: np.ndarray | float = 1.0
    ) -> FunctionGroup:
        """Group of changes `factors` (W, K + 1, n) [N] of the thruster forces, times `mine` (n,) (a mask)."""

        def thrust(p: Values, _scene: Scene, f: np.ndarray) -> np.ndarray:
            return f + mine * sum(v * factors[key] for key, v in p.items() if v)

        return function_group(name, words, kind, list(factors), hooks={"thrust": thrust})

    def of_force(self, name: str, words: tuple[str, ...], factors: Factors, kind: str = "share") -> FunctionGroup:
        """Group of body forces `factors` (W, K + 1, 3) [N, N, N m]."""

        def force(p: Values, scene: Scene) -> np.ndarray:
            return sum((v * factors[key] for key, v in p.items() if v), start=np.zeros((*scene.t_s.shape, 3)))

        return function_group(name, words, kind, list(factors), hooks={"force": force})

    def of_hull(self, name: str, words: tuple[str, ...], coefficients: Mapping[str, Sequence[str]]) -> FunctionGroup:
        """Group of relative changes of hull coefficients, by name of the function."""

        def hull(p: Values, c: Mapping[str, float]) -> Mapping[str, float]:
            return {**c, **{n: c[n] * (1 + v) for key, v in p.items() for n in coefficients[key]}}

        return function_group(name, words, "share", list(coefficients), hooks={"hull": hull})
