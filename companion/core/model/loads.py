"""Optional model terms by name: effects that a boat may or may not have, usable wherever the model is.

A term is one entry of REGISTRY, with its equation, its parameters and what it adds (`effects.term`): one file each in
`effects`. Plant, filter, NMPC, fits and diagnosis call the same line. A vessel file switches one on with a table
`[terms.NAME]`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from companion.core.model.effects import cross_flow, current, shallow_zone, tether, waves, wind, yaw_moments
from companion.core.model.effects.term import Term

REGISTRY: dict[str, Term] = {
    term.name: term
    for term in (
        current.TERM,
        wind.TERM,
        waves.TERM,
        yaw_moments.SPEED_DAMPING,
        yaw_moments.MUNK_MOMENT,
        yaw_moments.ASYMMETRY,
        cross_flow.TERM,
        tether.TERM,
        shallow_zone.TERM,
    )
}


def problems(chosen: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """What is wrong with the `[terms.*]` tables of a vessel file, as `terms.current.x: ...`."""
    for name, values in chosen.items():
        if name not in REGISTRY:
            yield f"terms.{name}: no such term; there are {sorted(REGISTRY)}"
            continue
        known = {p.name: p for p in REGISTRY[name].parameters}
        if not str(values.get("source", "")).strip():
            yield f"terms.{name}.source: missing key"
        for key, value in values.items():
            if key == "source":
                continue
            if key not in known:
                yield f"terms.{name}.{key}: unknown key; there are {sorted(known)}"
            elif not isinstance(value, (int, float)):
                yield f"terms.{name}.{key}: expected a number"
            elif not known[key].lower <= value <= known[key].upper:
                yield f"terms.{name}.{key}: expected {known[key].lower} to {known[key].upper}, found {value}"


def values(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters of a term: those given, else the defaults."""
    return {p.name: given.get(p.name, p.default) for p in REGISTRY[name].parameters}
