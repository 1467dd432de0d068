"""Parameter values theta by effect id, and the secant steps of their Jacobian columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect, parameter_slices

ParameterValues = Mapping[str, np.ndarray]
"""theta: parameters (k,) by effect id; effects that are not in it are absent."""
NEARBY = 0.1  # secant step of a nonlinear effect over its present value


def values_by_name(
    effects: Sequence[Effect], theta: ParameterValues, *stages: str
) -> list[tuple[Effect, dict[str, float]]]:
    """The effects of `theta` that have a hook of `stages`, each with its parameters by name."""
    wanted = frozenset(stages)
    return [
        (e, {p.name: float(v) for p, v in zip(e.parameters, theta[e.id], strict=True)})
        for e in effects
        if e.id in theta and not wanted.isdisjoint(e.hooks)
    ]


@dataclass(frozen=True)
class SecantSteps:
    """Secant steps of one effect: values `now` (k,); by column of all free parameters a step (k,) of that one alone."""

    effect: Effect
    now: np.ndarray
    steps: dict[int, np.ndarray]


def secant_steps(free: Sequence[Effect], theta: ParameterValues) -> Iterator[SecantSteps]:
    """Secant steps of each effect of `free` at theta, backwards where a forward step would pass the upper limit."""
    for effect, columns in zip(free, parameter_slices(free).values(), strict=True):
        now = theta.get(effect.id, np.zeros(len(effect.parameters)))
        reaches = [
            NEARBY * abs(v) if effect.nonlinear and v else p.step for p, v in zip(effect.parameters, now, strict=True)
        ]
        signed = [r if v + r <= p.upper else -r for p, v, r in zip(effect.parameters, now, reaches, strict=True)]
        yield SecantSteps(effect, now, dict(zip(range(columns.start, columns.stop), np.diag(signed), strict=True)))


def including(effects: Sequence[Effect], effect: Effect) -> Sequence[Effect]:
    """`effects` with `effect` at the place it has in them, else at the end: hooks do not commute."""
    return effects if any(e.id == effect.id for e in effects) else [*effects, effect]
