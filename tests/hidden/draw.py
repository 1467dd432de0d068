"""A case from a nonce and its number: kind, causes, boat, rates, pilots, imperfections; the true world of each log."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.hidden.effects.catalogue import CATALOGUE, CLASHES, MEDIUM, SMALL, effect_id
from tests.hidden.effects.effect import Effect, Params, deviation
from tests.hidden.effects.imperfections import add_imperfections
from tests.hidden.effects.outside import OUTSIDE
from tests.hidden.names import FAMILIES
from tests.hidden.plant.boats import boat
from tests.hidden.plant.foreign import add_foreign, passable_names
from tests.hidden.plant.pilot import PILOTS
from tests.hidden.plant.world import World

BLOCK = (
    ("none",) * 3 + ("small",) * 4 + ("medium",) * 6 + ("two",) * 2 + ("three",) + ("outside",) * 2 + ("variant",) * 2
)
"""Kinds in every twenty cases, in shuffled order."""

UWB_HZ = {5: 0.6, 1: 0.2, 10: 0.2}
OTHER_S = 240.0  # length of the held-out and the reference log
IMU_HZ = {30: 0.7, 20: 0.15, 40: 0.15}


@dataclass(frozen=True)
class Cause:
    """One effect that is in a case. `deviation`: its size in the unit of `smallest`."""

    id: str
    family: str
    params: Params
    deviation: float
    smallest: float
    variant: str | None = None


@dataclass
class Case:
    """A drawn case: `base` is what is believed, `world` how it is, `calm` how it was before the causes came."""

    nonce: str
    index: int
    kind: str
    causes: list[Cause]
    outside: dict[str, Any] | None
    base: World
    world: World
    calm: World
    imperfections: dict[str, float]
    pilots: list[str]
    train_s: float
    other_s: float
    with_reference: bool
    as_csv: bool
    passable: list[str]
    seed: np.random.SeedSequence = field(repr=False)

    def open_rng(self) -> np.random.Generator:
        """Randomness of the logs: the same however often it is asked for."""
        return np.random.default_rng(self.seed)


def rng_of(*words: object) -> np.random.Generator:
    """A generator whose seed is the hash of these words."""
    return np.random.default_rng(_seed(*words))


def _seed(*words: object) -> np.random.SeedSequence:
    digest = hashlib.sha256(":".join(map(str, words)).encode()).digest()
    return np.random.SeedSequence(int.from_bytes(digest[:16], "big"))


def kind_of(nonce: str, index: int) -> str:
    """Kind of a case: each block of twenty is the same, shuffled."""
    block, place = divmod(index, len(BLOCK))
    return str(rng_of(nonce, "kinds", block).permutation(BLOCK)[place])


def _turn(nonce: str, index: int, kind: str, forced: bool) -> int:
    """How many cases of this kind came before."""
    return index if forced else sum(kind_of(nonce, i) == kind for i in range(index))


def _dealt(nonce: str, kind: str, turn: int, cards: list) -> Any:
    """Card `turn` of a deck shuffled anew each time it is used up: all come equally often."""
    deal, place = divmod(turn, len(cards))
    return cards[int(rng_of(nonce, "deck", kind, deal).permutation(len(cards))[place])]


def draw(nonce: str, index: int, *, kind: str | None = None, uwb_hz: int | None = None, family: str | None = None,
         train_s: float | None = None, medium: tuple[float, float] = MEDIUM,
         foreign: bool = False) -> Case:  # fmt: skip
    """Case `index` of `nonce`. `kind`, `family` and `uwb_hz` fix what would be drawn. Raises KeyError.

    `foreign`: the same case on a plant of another structure (plant/foreign.py).
    """
    chosen = kind or kind_of(nonce, index)
    turn = _turn(nonce, index, chosen, kind is not None)
    rng = rng_of(nonce, index, chosen)
    rate = uwb_hz or int(rng.choice(list(UWB_HZ), p=list(UWB_HZ.values())))
    base = boat(rng, float(rate), float(rng.choice(list(IMU_HZ), p=list(IMU_HZ.values()))))
    causes, outside = [], None
    if chosen in ("small", "medium", "variant"):
        causes = [_single(nonce, chosen, turn, rng, base, family, medium)]
    elif chosen in ("two", "three"):
        causes = _several(2 if chosen == "two" else 3, rng, base)
    world = base.copy()
    believed = [(c.family, c.params) for c in causes]
    imperfections = add_imperfections(world, rng, believed)
    if foreign:
        add_foreign(world, rng_of(nonce, index, "foreign"), believed)
    calm = world.copy()
    for cause in causes:
        effect = CATALOGUE[cause.family]
        (effect.variants[cause.variant] if cause.variant else effect.apply)(world, cause.params)
    if chosen == "outside":
        kinds = [o for o in OUTSIDE if family in (None, o.name)]
        entry = _dealt(nonce, chosen, turn, kinds)
        params = entry.make(world, rng, float(rng.uniform(1.0, 1.7)))
        outside = {"name": entry.name, "depends_on": list(entry.depends_on), "params": params}
    return Case(
        nonce=nonce,
        index=index,
        kind=chosen,
        causes=causes,
        outside=outside,
        base=base,
        world=world,
        calm=calm,
        imperfections=imperfections,
        pilots=[str(rng.choice(list(PILOTS), p=(0.5, 0.2, 0.1, 0.1, 0.1))) for _ in range(4)],
        train_s=train_s or float(rng.choice([300, 300, 300, 360, 420])),
        other_s=OTHER_S if train_s is None else min(OTHER_S, train_s),
        with_reference=bool(rng.uniform() < 0.5),
        as_csv=bool(rng.uniform() < 0.25),
        passable=passable_names(base, calm) if foreign else [],
        seed=_seed(nonce, index, chosen, "logs"),
    )


def _single(nonce: str, kind: str, turn: int, rng: np.random.Generator, base: World, family: str | None,
            medium: tuple[float, float]) -> Cause:  # fmt: skip
    if kind == "variant":
        cards = [(f, v) for f in FAMILIES for v in CATALOGUE[f].variants if family in (None, f)]
        name, variant = _dealt(nonce, kind, turn, cards)
        return _cause(CATALOGUE[name], rng, base, medium, variant)
    cards = [f for f in FAMILIES if not (kind == "small" and CATALOGUE[f].fixed)]
    name = family or _dealt(nonce, kind, turn, cards)
    return _cause(CATALOGUE[name], rng, base, SMALL if kind == "small" else medium)


def _several(count: int, rng: np.random.Generator, base: World) -> list[Cause]:
    while True:
        families = [str(f) for f in rng.choice(FAMILIES, count, replace=False)]
        if all(len(clash & set(families)) < 2 for clash in CLASHES):
            return [_cause(CATALOGUE[f], rng, base, MEDIUM) for f in families]


def _cause(effect: Effect, rng: np.random.Generator, base: World, sizes: tuple[float, float],
           variant: str | None = None) -> Cause:  # fmt: skip
    """A size even in its logarithm between `sizes` smallest ones."""
    size = effect.smallest * float(np.exp(rng.uniform(*np.log(sizes))))
    params = effect.draw(rng, size, base)
    return Cause(
        effect_id(effect.family, params), effect.family, params, deviation(effect, params), effect.smallest, variant
    )


def named_truth(case: Case) -> list[Cause]:
    """Causes worth naming: those drawn, and any imperfection that reaches its smallest size (none does by design)."""
    return [c for c in case.causes if c.deviation >= c.smallest]
