"""One group of functions that are tried together, and the two ways in which they get into the normal equations.

As an effect with hooks, of which the engine makes columns as of any entry: what varies within a window. Or by `nodes`:
a function moves a whole window as the entries of its node do that stand for the same. A force is a latent acceleration
that is known but for its size, an error of heading, rate or specific force an offset or a bias, a shift of the tag the
position as the tag alone sees it. So these come from the normal equations that a fit has anyway.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter, Hook
from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.engine.block_tridiagonal import Chain
from sim.fitting.engine.noise import LATENT, STATE, L

SIZES = {
    "force": 0.01,  # m/s^2, rad/s^2; all assumed: where an effect begins to matter, as the catalogue's smallest sizes
    "share": 0.05,  # of thrust, of damping, of inertia
    "past": 0.3,  # of thrust, for what it was 0.1 s ago: 30 ms; of its rate: 0.3 s
    "mix": 0.1,  # of the thrust of two that change places
    "map": 0.15,  # of the largest thrust: a speed controller's trim of 2 us alone shifts it by up to a hundredth
    "water": 0.02,  # m/s
    "heading": np.radians(1.0),  # rad
    "place": 0.03,  # m
    "strain": 0.01,  # m/m
    "rate": 0.002,  # rad/s
    "accel": 0.02,  # m/s^2
}


@dataclass(frozen=True)
class FunctionGroup:
    """Functions that are tried together. `words`: what they depend on, as in `depends_on`, the most telling first.

    `effect`: one parameter each; `nodes` (W, L, p): what one unit of each does to the nodes, where it has no hooks.
    """

    words: tuple[str, ...]
    effect: Effect
    nodes: np.ndarray | None = None

    def named(self) -> FunctionGroup:
        """The same without its functions, which take room."""
        return replace(self, effect=replace(self.effect, hooks={}), nodes=None)

    def of_means(self, physics: EffectPhysics, point: LinearisationPoint, effects: Sequence[Effect]) -> FunctionGroup:
        """By nodes: what it does on the mean of each window, as if it did not vary within.

        Groups with hooks move the boat, never a sensor. `effects`: those at work at `point`.
        """
        if self.nodes is not None:
            return self
        a = physics.accelerations([*effects, self.effect], point.theta, point.state, [self.effect]).nodes
        nodes = np.zeros((len(a), L, a.shape[3]))
        nodes[:, LATENT] = window_means(physics, a.reshape(*a.shape[:2], -1)).reshape(len(a), 3, -1)
        return replace(self, nodes=nodes)


def window_means(physics: EffectPhysics, values: np.ndarray) -> np.ndarray:
    """Over each window, (W, K or K + 1, c) -> (W, c); steps that only fill a window up count nothing."""
    h_s = physics.windows.h_s
    return np.einsum("wk,wkc->wc", h_s, values[:, : h_s.shape[1]]) / h_s.sum(axis=1)[:, None]


def function_group(
    name: str,
    words: tuple[str, ...],
    kind: str,
    names: list[str],
    nodes: np.ndarray | None = None,
    hooks: Mapping[str, Hook] | None = None,
) -> FunctionGroup:
    """`kind`: of size, see `SIZES`; `names`: of the parameters. Either `nodes` or `hooks`."""
    size = SIZES[kind]
    parameters = tuple(EffectParameter(n, "", size, size, size) for n in names)
    return FunctionGroup(words, Effect(f"generic:{name}", "generic", name, "", parameters, hooks or {}), nodes)


def append_groups(point: LinearisationPoint, groups: Sequence[FunctionGroup]) -> LinearisationPoint:
    """`point` with the columns of `groups`, which have nodes, behind those that it has."""
    nodes = np.concatenate([g.nodes for g in groups if g.nodes is not None], axis=2)
    chain, ties = point.chain, point.ties
    pushed = chain.A @ nodes
    rows = nodes.reshape(-1, nodes.shape[2])
    cross = chain.B.reshape(len(rows), -1).T @ rows
    D = np.block([[chain.D, cross], [cross.T, rows.T @ pushed.reshape(rows.shape)]])
    d = np.concatenate([chain.d, rows.T @ chain.g.ravel()])
    G = ties.F[:, STATE, LATENT] @ nodes[ties.at, LATENT]
    return replace(
        point,
        chain=Chain(chain.A, chain.next, np.concatenate([chain.B, pushed], axis=2), D, chain.g, d),
        ties=replace(ties, G=np.concatenate([ties.G, G], axis=2)),
    )
