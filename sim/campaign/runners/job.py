"""What goes to a worker and what comes back. Light to import: a worker decides on threads before numpy is loaded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgspec

Figure = bool | int | float | str | None
"""None where a number would not be finite."""


class Work(msgspec.Struct, frozen=True, kw_only=True):
    """A case with all that it needs, so that it can be run anywhere.

    `texts`, `names`: of text files by role; `logs`: path and SHA-256 by role, read where the work is done.
    """

    kind: str
    id: str
    seed: int
    values: dict[str, Any]
    settings: Any
    texts: dict[str, str]
    names: dict[str, str]
    logs: dict[str, tuple[tuple[str, str], ...]]


class CaseOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """How a case went: `figures`, or `error` with its `trace`. The rest may differ from run to run.

    `program`: versions of what computed it; `seconds`: wall time; `begun_s`: on the machine's monotonic clock.
    """

    id: str
    figures: dict[str, Figure] = {}
    error: str = ""
    trace: str = ""
    program: dict[str, str] = {}
    begun_s: float = 0.0
    seconds: float = 0.0
    worker: str = ""


Runner = Callable[[Sequence[Work]], Iterator[CaseOutcome]]
"""Runs works in any order; gives each outcome as soon as it is there."""
DEATHS = 3
"""A case whose worker has died so often has failed; assumed."""


def died(work: Work) -> CaseOutcome:
    """Of a case that takes its workers with it."""
    return CaseOutcome(
        id=work.id, error=f"its worker died {DEATHS} times: killed, out of memory, or a crash in a library"
    )


class RunnerLost(Exception):
    """Nobody works any more; the text says why. What came before is kept."""
