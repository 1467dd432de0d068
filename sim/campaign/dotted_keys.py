"""Dotted keys: from nested tables to `weather.V_c_m_s`, and into a document of tables.

A step through a list of tables is the `name` of one of them: `vessel.thrusters.rear_port.gain`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

Value = bool | int | float | str


def flat(tables: Mapping[str, Any], where: str, leaf: Callable[[Any], bool]) -> dict[str, Any]:
    """Nested tables as one, by dotted key sorted. ValueError where what is no leaf is no table, or a key twice."""
    out: dict[str, Any] = {}
    for key, value in tables.items():
        if leaf(value):
            found = {key: value}
        elif isinstance(value, Mapping) and value:
            found = {f"{key}.{rest}": inner for rest, inner in flat(value, f"{where}.{key}", leaf).items()}
        else:
            expected = {"grid": "a list of values", "draw": "for example { uniform = [0.0, 1.0] }"}
            raise ValueError(f"{where}.{key}: expected {expected.get(where.partition('.')[0], 'a value')}")
        if twice := sorted(out.keys() & found.keys()):
            raise ValueError(f"{where}.{twice[0]}: is there twice, with quotation marks and without")
        out |= found
    return dict(sorted(out.items()))


def of_head(values: Mapping[str, Any], head: str) -> dict[str, Any]:
    """The values below `head`, by the rest of their keys."""
    return {key[len(head) + 1 :]: value for key, value in values.items() if key.startswith(f"{head}.")}


def applied(document: Mapping[str, Any], values: Mapping[str, Value]) -> dict[str, Any]:
    """A copy of `document` with values put in by dotted key. KeyError naming the step that leads nowhere."""
    out = copy.deepcopy(dict(document))
    for key, value in values.items():
        *steps, last = key.split(".")
        node: Any = out
        for i, step in enumerate(steps):
            node = _step(node, step, ".".join(steps[: i + 1]))
        if not isinstance(node, dict) or isinstance(node.get(last), dict | list):
            raise KeyError(f"{key}: is no single value")
        node[last] = value
    return out


def _step(node: Any, step: str, path: str) -> Any:
    if isinstance(node, list):
        named = {item.get("name"): item for item in node if isinstance(item, dict)}
        if step in named:
            return named[step]
        raise KeyError(f"{path}: nothing of that name; there are {', '.join(filter(None, named)) or 'none with names'}")
    if isinstance(node, dict):
        return node.setdefault(step, {})
    raise KeyError(f"{path}: is no table")
