"""Values of effects' parameters, and the steps by which their columns are taken."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from sim.diagnose.effect import Effect

Theta = Mapping[str, np.ndarray]
"""Parameters by effect id; effects that are not in it do nothing."""
NEARBY = 0.1  # of the value of a far effect that is believed in: how far its secant reaches


def values_of(effects: Sequence[Effect], theta: Theta, *stages: str) -> list[tuple[Effect, dict[str, float]]]:
    """Effects of `theta` that have one of the hooks, with their parameters by name."""
    wanted = frozenset(stages)
    return [
        (e, {p.name: float(v) for p, v in zip(e.parameters, theta[e.id], strict=True)})
        for e in effects
        if e.id in theta and not wanted.isdisjoint(e.hooks)
    ]


def secants(chosen: Sequence[Effect], theta: Theta) -> Iterator[tuple[Effect, np.ndarray, np.ndarray]]:
    """Each parameter in its turn: its effect, that effect's values now, and the step (of one parameter) to take."""
    for effect in chosen:
        now = theta.get(effect.id, np.zeros(len(effect.parameters)))
        for j, parameter in enumerate(effect.parameters):
            step = np.zeros(len(effect.parameters))
            reach = NEARBY * abs(now[j]) if effect.far and now[j] else parameter.step
            step[j] = reach if now[j] + reach <= parameter.upper else -reach
            yield effect, now, step


def among(effects: Sequence[Effect], effect: Effect) -> Sequence[Effect]:
    """`effects` with `effect`, where it is: which of two that scale the same number comes first matters."""
    return effects if any(e.id == effect.id for e in effects) else [*effects, effect]
