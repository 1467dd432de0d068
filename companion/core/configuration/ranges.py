"""Keys of a file that nobody knows, and numbers beyond the range of their key: with the whole path and what was meant.

The range of a key stands where the key does, in its struct; this module walks over what was read beside those structs.
Bounds keep out what no small vessel (to 25 m and 100 t) and no basin can have, a slip of the decimal point most of all:
assumed, and generous.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import msgspec
from msgspec import inspect

from companion.core.configuration.spelling import did_you_mean

LARGEST = 1e300
"""TOML's whole numbers go on for ever; floats do not."""


def problems(data: object, kind: type[msgspec.Struct]) -> Iterator[str]:
    """What is wrong with keys and numbers in `data`, read for `kind`: `hull.draft_m: expected 0.005 to 5, found 9`,
    `hull.draught_m: unknown key; did you mean draft_m?`.
    """
    yield from _walk(data, _described(kind), "")


@cache
def _described(kind: type[msgspec.Struct]) -> inspect.Type:
    return inspect.type_info(kind)


def _walk(node: Any, kind: inspect.Type, path: str) -> Iterator[str]:
    match kind:
        case inspect.StructType() if isinstance(node, dict):
            yield from _walk_table(node, kind, path)
        case inspect.DictType() if isinstance(node, dict):
            for key, value in node.items():
                yield from _walk(value, kind.value_type, _join(path, key))
        case inspect.VarTupleType() | inspect.ListType() if isinstance(node, list):
            for i, value in enumerate(node):
                yield from _walk(value, kind.item_type, f"{path}[{i}]")
        case inspect.TupleType() if isinstance(node, list):
            for i, (value, of) in enumerate(zip(node, kind.item_types, strict=False)):
                yield from _walk(value, of, f"{path}[{i}]")
        case inspect.UnionType():
            yield from _walk_one_of(node, kind, path)
        case inspect.FloatType() | inspect.IntType() if isinstance(node, int | float) and not isinstance(node, bool):
            if not _within(node, kind):
                yield f"{path}: expected {_range(kind)}, found {_shown(node)}"


def _walk_table(node: dict[str, Any], kind: inspect.StructType, path: str) -> Iterator[str]:
    known = [field.encode_name for field in kind.fields]
    for key in sorted(node.keys() - {*known, kind.tag_field}) if kind.forbid_unknown_fields else ():
        yield f"{_join(path, key)}: unknown key{did_you_mean(key, known)}"
    for field in kind.fields:
        if field.encode_name in node:
            yield from _walk(node[field.encode_name], field.type, _join(path, field.encode_name))


def _walk_one_of(node: Any, kind: inspect.UnionType, path: str) -> Iterator[str]:
    """A union of tables goes by their tag; one of a number and nothing, or of number and text, by what fits."""
    tagged = [option for option in kind.types if isinstance(option, inspect.StructType) and option.tag_field]
    if tagged and isinstance(node, dict):
        key, tags = str(tagged[0].tag_field), [option.tag for option in tagged]
        if node.get(key, tags[0]) not in tags:
            yield f"{_join(path, key)}: expected {', '.join(map(str, tags))}, found {node[key]!r}"
    for option in kind.types:
        if isinstance(option, inspect.StructType):
            is_other = isinstance(node, dict) and option.tag_field and node.get(option.tag_field) != option.tag
            if not is_other:
                yield from _walk(node, option, path)
        else:
            yield from _walk(node, option, path)


def _within(value: float, kind: inspect.FloatType | inspect.IntType) -> bool:
    return (
        (kind.ge is None or value >= kind.ge)
        and (kind.le is None or value <= kind.le)
        and (kind.gt is None or value > kind.gt)
        and (kind.lt is None or value < kind.lt)
    )


def _range(kind: inspect.FloatType | inspect.IntType) -> str:
    """`0.1 to 30`, `more than 0 and at most 5`, `at least 0`."""
    if kind.ge is not None and kind.le is not None:
        return f"{kind.ge:g} to {kind.le:g}"
    names = (("at least", kind.ge), ("more than", kind.gt), ("at most", kind.le), ("less than", kind.lt))
    return " and ".join(f"{name} {bound:g}" for name, bound in names if bound is not None)


def _shown(value: float) -> str:
    return f"{value:g}" if abs(value) < LARGEST else "a number beyond all bounds"


def _join(path: str, key: object) -> str:
    return f"{path}.{key}" if path else str(key)
