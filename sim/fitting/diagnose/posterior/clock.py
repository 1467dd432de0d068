"""One clock for several logs: what changes slowly goes on from one to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from companion.logs.runs.run import Run
from companion.logs.runs.splits import source_runs


@dataclass(frozen=True)
class LogClock:
    """Whole logs, and when the first row of each is [s]: parts of a log are on the clock with it.

    Nought is the first row of all logs that are fitted.
    """

    logs: tuple[Run, ...]
    begins_s: tuple[float, ...]

    @classmethod
    def of(cls, fitted: Sequence[Run], held_out: Sequence[Run] = ()) -> LogClock:
        """By the stamps, else one after the other. `held_out` move nothing of the others."""
        logs, both = source_runs(fitted), source_runs([*fitted, *held_out])
        begins = _stamps_s(logs) if _by_stamps(logs) else _in_turn_s(logs, 0.0)
        end = max(begin + log.duration_s for begin, log in zip(begins, logs, strict=True))
        later = _stamps_s(both)[len(logs) :] if _by_stamps(both) else _in_turn_s(both[len(logs) :], end)
        return cls(tuple(both), tuple(begin - min(begins) for begin in [*begins, *later]))

    def ahead_s(self, run: Run) -> float:
        """What to add to t_s of a log, or of a part of it [s]."""
        for log, begin_s in zip(self.logs, self.begins_s, strict=True):
            if log is run.whole:
                return begin_s - _first_s(log)
        raise ValueError(f"{run.meta.source}: part of no log of this clock")

    def start_s(self, run: Run) -> float:
        """When the first row of a log, or of a part of it, is [s]."""
        return _first_s(run) + self.ahead_s(run)


def _by_stamps(logs: Sequence[Run]) -> bool:
    """Whether stamps tell when each log was: they are of one clock, and nothing was measured in two logs at one time.

    Stamps since two boots may overlap, and logs without any do. Commands of before a part are in the part before, too.
    """
    measured = zip(_zeros_s(logs), (log.measured_s() for log in logs), strict=True)
    spans = sorted((zero_s + t_s[0], zero_s + t_s[-1]) for zero_s, t_s in measured)
    return len({log.meta.clock for log in logs}) == 1 and all(a[1] <= b[0] for a, b in pairwise(spans))


def _zeros_s(logs: Sequence[Run]) -> list[float]:
    """Stamps of t_s = 0, since that of the first."""
    return [(log.meta.zero_ns - logs[0].meta.zero_ns) * 1e-9 for log in logs]


def _stamps_s(logs: Sequence[Run]) -> list[float]:
    """Of the first row of each."""
    return [zero_s + _first_s(log) for zero_s, log in zip(_zeros_s(logs), logs, strict=True)]


def _in_turn_s(logs: Sequence[Run], begin_s: float) -> list[float]:
    return [begin_s + sum(log.duration_s for log in logs[:i]) for i in range(len(logs))]


def _first_s(run: Run) -> float:
    return float(run.table["t_s"][0])
