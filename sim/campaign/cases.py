"""From a campaign to its cases, each named by the hash of all that its figures depend on. Pure.

    cases = grid x seeds;    a draw of a case = f(seed, key)

Draws depend on seed and key alone: points of the grid are compared under the same draws, and more seeds or grid points
leave the cases that were there as they were. One more key is of all cases, with draws as they were, and names all anew.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from sim.campaign.dotted_keys import Value, of_head
from sim.campaign.file import LARGEST, Campaign, Draw, Settings

FORM = {"missions": 2, "identify": 2, "diagnose": 2}
"""Raised when figures of a kind come to mean something else: then what was kept is no longer taken for done."""


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """One run. `values`: by dotted key, without those of files and settings, which `files` and `settings` have."""

    id: str
    seed: int
    values: dict[str, Value]
    files: dict[str, tuple[str, ...]]
    settings: Settings
    shown: dict[str, Value]
    """What tells it from others: every key of set, grid and draw, files as text."""


def expand(campaign: Campaign, digests: Mapping[str, str]) -> list[Case]:
    """All cases, sorted by id. `digests`: SHA-256 of each file's content by its path as the campaign has it.

    Raises ValueError naming a setting that cannot be.
    """
    axes = [[(key, value) for value in values] for key, values in sorted(campaign.grid.items())]
    cases = [
        _case(campaign, seed, dict(point), digests) for point in itertools.product(*axes) for seed in campaign.seeds
    ]
    return sorted(cases, key=lambda case: case.id)


def drawn(draw: Draw, seed: int, key: str) -> Value:
    """What `key` is in the cases of `seed`."""
    word = int.from_bytes(hashlib.sha256(key.encode()).digest()[:8])
    rng = np.random.default_rng([seed, word])
    if draw.choice:
        return draw.choice[int(rng.integers(len(draw.choice)))]
    if draw.normal:
        return float(rng.normal(*draw.normal))
    if draw.uniform:
        return float(rng.uniform(*draw.uniform))
    low, high = draw.log_uniform or (1.0, 1.0)
    return min(max(float(np.exp(rng.uniform(np.log(low), np.log(high)))), low), high)


def _case(campaign: Campaign, seed: int, point: dict[str, Any], digests: Mapping[str, str]) -> Case:
    every = dict(sorted({**campaign.set, **point, **{k: drawn(d, seed, k) for k, d in campaign.draw.items()}}.items()))
    chosen = {role: (v,) if isinstance(v, str) else tuple(v) for role, v in of_head(every, "files").items()}
    files = dict(sorted({**campaign.files, **chosen}.items()))
    settings = settings_of(campaign, every)
    values = {k: v for k, v in every.items() if k.split(".")[0] not in ("files", campaign.kind)}
    content = [
        FORM[campaign.kind],
        campaign.kind,
        msgspec.to_builtins(settings),
        seed,
        {key: _plain(value) for key, value in values.items()},
        {role: [digests[path] for path in paths] for role, paths in files.items()},
    ]
    name = hashlib.sha256(msgspec.json.encode(content, order="sorted")).hexdigest()[:16]
    shown = {k: " + ".join(v) if isinstance(v, tuple) else v for k, v in every.items()}
    return Case(id=name, seed=seed, values=values, files=files, settings=settings, shown=shown)


def _plain(value: Value) -> Value:
    """A whole number as such, also where fractions beside it made it one: 4.0 and 4 are the same case."""
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) <= LARGEST else value


def settings_of(campaign: Campaign, values: Mapping[str, Any]) -> Settings:
    """The kind's settings with those values put in. Raises ValueError naming the key."""
    overrides = of_head(values, campaign.kind)
    try:
        return msgspec.convert({**msgspec.to_builtins(campaign.settings), **overrides}, type(campaign.settings))
    except msgspec.ValidationError as error:
        raise ValueError(f"{campaign.kind}.{', '.join(overrides)}: {error}") from None
