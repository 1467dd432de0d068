"""Values of effects' parameters, and the steps by which their columns are taken."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect, parameter_slices

ParameterValues = Mapping[str, np.ndarray]
"""Parameters by effect id; effects that are not in it do nothing."""
NEARBY = 0.1  # of the value of a far effect that is believed in: how far its secant reaches


def values_by_name(
    effects: Sequence[Effect], theta: ParameterValues, *stages: str
) -> list[tuple[Effect, dict[str, float]]]:
    """Effects of `theta` that have one of the hooks, with their parameters by name."""
    wanted = frozenset(stages)
    return [
        (e, {p.name: float(v) for p, v in zip(e.parameters, theta[e.id], strict=True)})
        for e in effects
        if e.id in theta and not wanted.isdisjoint(e.hooks)
    ]


@dataclass(frozen=True)
class SecantSteps:
    """Of one effect: its values `now`, and by column of all chosen parameters the step to take, each of one alone."""

    effect: Effect
    now: np.ndarray
    steps: dict[int, np.ndarray]


def secant_steps(free: Sequence[Effect], theta: ParameterValues) -> Iterator[SecantSteps]:
    """Each effect of `free` in its turn."""
    for effect, columns in zip(free, parameter_slices(free).values(), strict=True):
        now = theta.get(effect.id, np.zeros(len(effect.parameters)))
        reaches = [
            NEARBY * abs(v) if effect.nonlinear and v else p.step for p, v in zip(effect.parameters, now, strict=True)
        ]
        signed = [r if v + r <= p.upper else -r for p, v, r in zip(effect.parameters, now, reaches, strict=True)]
        yield SecantSteps(effect, now, dict(zip(range(columns.start, columns.stop), np.diag(signed), strict=True)))


def including(effects: Sequence[Effect], effect: Effect) -> Sequence[Effect]:
    """`effects` with `effect`, where it is: which of two that scale the same number comes first matters."""
    return effects if any(e.id == effect.id for e in effects) else [*effects, effect]
