"""Effects that the catalogue does not have, and what each depends on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.hidden.effects.effect import Params
from tests.hidden.plant.world import World

Make = Callable[[World, np.random.Generator, float], Params]


@dataclass(frozen=True)
class Outside:
    """`depends_on`: entries of names.DEPENDENCIES that are right answers; `make(world, rng, strength 1..1.7)`."""

    name: str
    depends_on: tuple[str, ...]
    make: Make


def _wall(world: World, rng: np.random.Generator, k: float) -> Params:
    world.odd.wall = 10.0 * k * float(rng.choice([-1, 1]))
    return {"F_N": world.odd.wall}


def _interaction(world: World, rng: np.random.Generator, k: float) -> Params:
    i, j = (int(x) for x in rng.choice(len(world.drive.thrusters), 2, replace=False))
    world.odd.interaction = (i, j, -0.35 * k)
    return {"thruster": i, "by": j, "k": -0.35 * k}


def _oscillation(world: World, rng: np.random.Generator, k: float) -> Params:
    world.odd.oscillation = (0.13 * k, float(rng.uniform(60, 140)))
    return {"share": world.odd.oscillation[0], "period_s": world.odd.oscillation[1]}


def _heading_drag(world: World, rng: np.random.Generator, k: float) -> Params:
    world.odd.heading_drag = (0.5 * k, float(rng.uniform(-180, 180)))
    return {"share": world.odd.heading_drag[0], "at_deg": world.odd.heading_drag[1]}


def _backlash(world: World, rng: np.random.Generator, k: float) -> Params:
    world.odd.backlash_us = 16.0 * k
    return {"half_width_us": world.odd.backlash_us}


def _magnet(world: World, rng: np.random.Generator, k: float) -> Params:
    place = 15 + rng.uniform(-4, 4, 2)
    world.odd.magnet = (8.0 * k * float(rng.choice([-1, 1])), float(place[0]), float(place[1]), 3.0)
    return dict(zip(("error_deg", "north_m", "east_m", "radius_m"), world.odd.magnet, strict=True))


def _lift(world: World, rng: np.random.Generator, k: float) -> Params:
    world.odd.lift = 5.0 * k * float(rng.choice([-1, 1]))
    return {"Y_uu_N_s2_m2": world.odd.lift}


def _gyre(world: World, rng: np.random.Generator, k: float) -> Params:
    world.odd.gyre = 0.010 * k * float(rng.choice([-1, 1]))
    return {"turn_rad_s": world.odd.gyre}


def _throttle(world: World, rng: np.random.Generator, k: float) -> Params:
    world.odd.throttle = (0.45 * k, 25.0)
    return {"share_per_100_N": world.odd.throttle[0], "above_N": 25.0}


OUTSIDE = (
    Outside("wall_attraction", ("position",), _wall),
    Outside("thruster_interaction", ("thruster", "load"), _interaction),
    Outside("thrust_oscillation", ("time",), _oscillation),
    Outside("heading_drag", ("heading",), _heading_drag),
    Outside("esc_backlash", ("thruster",), _backlash),
    Outside("magnetic_place", ("position",), _magnet),
    Outside("skeg_lift", ("speed",), _lift),
    Outside("gyre", ("position",), _gyre),
    Outside("esc_throttle", ("load", "thruster", "voltage"), _throttle),
)
