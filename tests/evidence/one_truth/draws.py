"""Causes drawn from a seed: one of each family of the catalogue, of 1.5 to 5 times its smallest size worth a name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.vessel_edits.public_form import family

POSITIVE = ("wash", "cross_flow", "lag", "dead_time", "uwb_latency", "gnss_latency", "rate_limit", "dead_band")
"""Families with one sign: of the other a file has none (a jet that adds thrust, a latency below 0), or little."""


def families(effects: Sequence[Effect]) -> dict[str, list[Effect]]:
    """Entries that can be named, by family."""
    out: dict[str, list[Effect]] = {}
    for effect in effects:
        if effect.family != "base":
            out.setdefault(family(effect.name), []).append(effect)
    return out


def draw(entries: Sequence[Effect], rng: np.random.Generator) -> tuple[Effect, np.ndarray]:
    """One of the entries and values (k,) of its parameters: as the search finds them."""
    effect = entries[int(rng.integers(len(entries)))]
    if effect.all_or_nothing:
        return effect, effect.wide_prior()[1]
    sign = 1.0 if family(effect.name) in POSITIVE else None
    sizes = [
        p.smallest * rng.uniform(1.5, 5.0) * (sign or rng.choice([-1.0, 1.0]))
        if np.isfinite(p.smallest)
        else 0.5 * p.prior * rng.normal()
        for p in effect.parameters
    ]
    low, high = effect.limits()
    mirrored = [-v if not lo <= v <= hi else v for v, lo, hi in zip(sizes, low, high, strict=True)]
    return effect, np.clip(mirrored, low, high)
