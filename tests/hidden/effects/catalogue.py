"""The catalogue as this author sees it: every family once; ids; apply by id."""

from __future__ import annotations

from tests.hidden.effects import environment, hull, propulsion, sensors
from tests.hidden.effects.effect import Effect, Params
from tests.hidden.names import FAMILIES, canonical, family
from tests.hidden.plant.world import World

CATALOGUE: dict[str, Effect] = {
    e.family: e
    for e in (*environment.EFFECTS, *propulsion.EFFECTS, *hull.EFFECTS,
              *sensors.EFFECTS)
}  # fmt: skip
assert tuple(CATALOGUE) == FAMILIES

SMALL, MEDIUM = (1.5, 2.0), (3.0, 5.0)
"""Sizes in smallest nameable ones; drawn evenly in their logarithm."""

CLASHES = (
    {"current", "turning_current"},
    {"wind", "gusty_wind"},
    {"thruster_gain", "thruster_fouling", "swapped_pair"},
    {"common_loss", "hull_fouling"},
)
"""Families of which a case holds at most one: together they would be another member of the set."""


def effect_id(name: str, params: Params) -> str:
    """Id of an effect with these parameters: with the thruster where it has one."""
    if "thruster" in params:
        return f"{name}:{params['thruster']}"
    if "thrusters" in params:
        return canonical(f"{name}:{'+'.join(params['thrusters'])}")
    return name


def apply_named(world: World, name: str, params: Params) -> None:
    """Put the effect with this id into a world. Raises KeyError for an unknown id or a missing parameter."""
    effect = CATALOGUE[family(name)]
    tail = name.partition(":")[2]
    if family(name) in ("thruster_gain", "thruster_fouling"):
        params = params | {"thruster": tail}
    elif family(name) == "swapped_pair":
        params = {"thrusters": tail.split("+")}
    elif family(name) == "payload":
        params = {"share": params["mass_kg"] / world.hull.m} | params
    elif family(name) == "tether":
        params = {"x_t_m": -0.6} | params
    effect.apply(world, params)
