"""A vessel as the text of a vessel file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import msgspec

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.load_vessel import load_vessel


def vessel_toml(vessel: VesselFile, comment: str = "") -> str:
    """A vessel file as TOML text. ValueError if the text does not load back as the same vessel."""
    data = msgspec.to_builtins(vessel)
    lines = [f"# {line}" for line in comment.splitlines()]
    lines += _table((), data)
    text = "\n".join(lines) + "\n"
    if load_vessel(text, name=vessel.name) != vessel:
        raise ValueError(f"{vessel.name}: the text does not load back as the vessel it was made from")
    return text


def _table(path: tuple[str, ...], data: Mapping[str, Any]) -> list[str]:
    """Lines of one TOML table: its own keys, then its tables, then its arrays of tables, each with its tables."""
    plain = {k: v for k, v in data.items() if v is not None and not isinstance(v, dict | list | tuple)}
    lists = {k: v for k, v in data.items() if isinstance(v, list | tuple)}
    lines = [f"\n[{'.'.join(path)}]"] if path and plain else []
    lines += [f"{k} = {_value(v)}" for k, v in plain.items()]
    for key, inner in data.items():
        if isinstance(inner, dict):
            lines += _table((*path, key), inner)
    for key, items in lists.items():
        for item in items:
            lines.append(f"\n[[{'.'.join((*path, key))}]]")
            lines += [f"{k} = {_value(v)}" for k, v in item.items() if v is not None and not isinstance(v, dict)]
            for name, inner in item.items():
                lines += _table((*path, key, name), inner) if isinstance(inner, dict) else []
    return lines


def _value(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool) else repr(value)
