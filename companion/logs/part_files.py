"""Which files a log has: `NAME.mcap`, and its continuations `NAME.part1.mcap`, `NAME.part2.mcap`, ..."""

from __future__ import annotations

import re
from pathlib import Path


def part_path(path: Path, number: int) -> Path:
    """File of part `number` of the log that starts at `path`."""
    return path if number == 0 else path.with_name(f"{path.stem}.part{number}{path.suffix}")


def log_parts(path: Path) -> tuple[Path, ...]:
    """`path` and its continuations that exist, in order; of a continuation those after it."""
    found = _continuations(path, path.stem, 0)
    if not found and (itself := re.fullmatch(r"(.+)\.part(\d+)", path.stem)):
        found = _continuations(path, itself[1], int(itself[2]))
    return (path, *found)


def _continuations(path: Path, stem: str, after: int) -> list[Path]:
    """Parts of the log `stem` in the folder of `path` whose numbers are above `after`, in order; none without one."""
    pattern = re.compile(rf"{re.escape(stem)}\.part(\d+){re.escape(path.suffix)}")
    try:
        beside = list(path.parent.iterdir())
    except FileNotFoundError:
        return []
    found = [(int(match[1]), other) for other in beside if (match := pattern.fullmatch(other.name))]
    return [other for number, other in sorted(found) if number > after]
