"""What an effect is: how it is drawn, what it does to a world, how large it is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.hidden.plant.world import World

Params = dict[str, Any]
Draw = Callable[[np.random.Generator, float, World], Params]
Apply = Callable[[World, Params], None]


@dataclass(frozen=True)
class Effect:
    """One effect of the catalogue.

    `size` names the parameter, or two of which the root sum of squares, that carries the size: its distance from
    `neutral`, in units of `smallest`. `draw(rng, size, base)` gives the parameters for a size in that unit's own
    terms. `variants` do the same family with another functional form.
    """

    family: str
    size: tuple[str, ...]
    smallest: float
    draw: Draw
    apply: Apply
    variants: dict[str, Apply] = field(default_factory=dict)
    neutral: float = 0.0
    inverse: bool = False  # size is 1 / parameter
    fixed: bool = False  # there is only one size: a pair is swapped or not
    reported: tuple[str, ...] = ()  # parameters by which the size is told, where they are not `size`


def deviation(effect: Effect, params: Params) -> float:
    """Size of these parameters in the unit of `smallest`."""
    if effect.fixed:
        return effect.smallest * 4
    parts = [float(params[name]) - effect.neutral for name in effect.size]
    if effect.inverse:
        return 1.0 / float(params[effect.size[0]])
    return math.hypot(*parts)


def one(name: str, *, positive: bool = False, neutral: float = 0.0, down: float = 0.5) -> Draw:
    """One number: neutral plus or minus the size; minus with chance `down`."""

    def draw(rng: np.random.Generator, size: float, base: World) -> Params:
        sign = 1.0 if positive or rng.uniform() >= down else -1.0
        return {name: neutral + sign * size}

    return draw


def two(first: str, second: str) -> Draw:
    """Two numbers, the size in a direction drawn."""

    def draw(rng: np.random.Generator, size: float, base: World) -> Params:
        a = rng.uniform(0, 2 * np.pi)
        return {first: float(size * np.cos(a)), second: float(size * np.sin(a))}

    return draw


def heading(rng: np.random.Generator) -> float:
    """Any direction [deg]."""
    return float(rng.uniform(-180.0, 180.0))


def sets(part: str, **fields: str) -> Apply:
    """Set fields of world.<part> to parameters: sets("water", V_c="V_c_m_s")."""

    def apply(world: World, params: Params) -> None:
        target = getattr(world, part)
        for key, name in fields.items():
            setattr(target, key, params[name])

    return apply


def also(first: Apply, then: Callable[[World, Params], None]) -> Apply:
    """Both, in order."""

    def apply(world: World, params: Params) -> None:
        first(world, params)
        then(world, params)

    return apply
