"""A group of basis functions that are tested together, and its columns in the normal equations, in one of two ways.

hooks    an effect whose columns are secants as of any entry: functions that vary within a window
nodes    N (W, L, p): a function constant over a window acts as entries of its node do: a force as latent acceleration,
         a sensor error as offset or bias, a shift of the tag as position. Its columns follow from the chain (A, B, g)
         of the nodes: D = N^T A N, cross terms B^T N, d = N^T g.
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
    "force": 0.01,  # m/s^2, rad/s^2; all assumed: where a function begins to matter, as the catalogue's smallest sizes
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
    """Functions that are tested together.

    words     what they depend on, as in `depends_on` of findings, the most specific first
    effect    one parameter for each function; with hooks, or without where there are `nodes`
    nodes     (W, L, p) change of the nodes by one unit of each function
    """

    words: tuple[str, ...]
    effect: Effect
    nodes: np.ndarray | None = None

    def named(self) -> FunctionGroup:
        """The same without hooks and nodes, to save memory."""
        return replace(self, effect=replace(self.effect, hooks={}), nodes=None)

    def of_means(self, physics: EffectPhysics, point: LinearisationPoint, effects: Sequence[Effect]) -> FunctionGroup:
        """The same by nodes, with its mean acceleration over each window; hooks of groups act on the boat only.

        `effects`: those in theta of `point`.
        """
        if self.nodes is not None:
            return self
        a = physics.accelerations([*effects, self.effect], point.theta, point.state, [self.effect]).nodes
        nodes = np.zeros((len(a), L, a.shape[3]))
        nodes[:, LATENT] = window_means(physics, a.reshape(*a.shape[:2], -1)).reshape(len(a), 3, -1)
        return replace(self, nodes=nodes)


def window_means(physics: EffectPhysics, values: np.ndarray) -> np.ndarray:
    """Time-weighted mean over each window, (W, K or K + 1, c) -> (W, c); padding steps have length zero."""
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
    """Group with one parameter for each of `names`, all of the size of `kind` in `SIZES`; either `nodes` or `hooks`."""
    size = SIZES[kind]
    parameters = tuple(EffectParameter(n, "", size, size, size) for n in names)
    return FunctionGroup(words, Effect(f"generic:{name}", "generic", name, "", parameters, hooks or {}), nodes)


def append_groups(point: LinearisationPoint, groups: Sequence[FunctionGroup]) -> LinearisationPoint:
    """`point` with the columns of `groups` that have nodes appended to its normal equations."""
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
