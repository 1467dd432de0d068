"""What a pre-flight check says: one row a question, and the parameters of an autopilot however it spells them.

    ok        as it should be
    warning   may be meant so; read it
    refuse    do not start: the boat might not stop, or could not be driven at all

The rows are made in `autopilot` and `rules` (parameters), `link` and `boat` (observations).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import msgspec

Level = Literal["ok", "warning", "refuse"]

RENAMED: Mapping[str, str] = {"SYSID_MYGCS": "MAV_GCS_SYSID", "SYSID_THISMAV": "MAV_SYSID"}
"""Parameters of ArduPilot 4.6 that have another name from 4.7 (observed)."""
OLD_NAME: Mapping[str, str] = {new: old for old, new in RENAMED.items()}


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One line of the table. `why`: what depends on it; `fix`: what to do next, empty where nothing is to be done."""

    area: str
    name: str
    level: Level
    found: str
    needed: str
    why: str
    fix: str = ""


def worst(rows: Iterable[Row]) -> Level:
    """The gravest level among the rows; "ok" without any."""
    levels = {row.level for row in rows}
    return "refuse" if "refuse" in levels else "warning" if "warning" in levels else "ok"


@dataclass(frozen=True)
class ParameterSet:
    """An autopilot's parameters as far as they were read. Ask by the name of 4.6."""

    values: Mapping[str, float]

    def get(self, name: str) -> float | None:
        """Value of a parameter, None where it was not read."""
        return self.values.get(self.spelled(name))

    def spelled(self, name: str) -> str:
        """The name as this autopilot spells it."""
        new = RENAMED.get(name)
        return new if new is not None and name not in self.values and new in self.values else name

    def whole(self, name: str, default: int = 0) -> int:
        """Value as a whole number; `default` where it was not read."""
        value = self.get(name)
        return default if value is None else round(value)


def number(value: float | None) -> str:
    """A parameter's value as people write it."""
    return "not told" if value is None else f"{value:g}"


def numbers(values: Iterable[int]) -> str:
    """Whole numbers, runs of three and more joined: 1 2 3 4 8 -> "1-4 8"."""
    runs: list[list[int]] = []
    for value in sorted(set(values)):
        if runs and value == runs[-1][-1] + 1:
            runs[-1].append(value)
        else:
            runs.append([value])
    return " ".join(f"{run[0]}-{run[-1]}" if len(run) > 2 else " ".join(map(str, run)) for run in runs)
