"""One clock for several logs, so that slow changes (a turning current, an onset) continue from one to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from companion.logs.runs.run import Run
from companion.logs.runs.splits import source_runs


@dataclass(frozen=True)
class LogClock:
    """Whole logs and the time of the first row of each [s]. Parts of a log share its offset.

    Time zero is the earliest first row of the fitted logs.
    """

    logs: tuple[Run, ...]
    begins_s: tuple[float, ...]

    @classmethod
    def of(cls, fitted: Sequence[Run], held_out: Sequence[Run] = ()) -> LogClock:
        """Clock by the logs' stamps where these are usable, else one log after the other.

        The order of the fitted logs does not depend on `held_out`.
        """
        logs, both = source_runs(fitted), source_runs([*fitted, *held_out])
        begins = _stamps_s(logs) if _by_stamps(logs) else _in_turn_s(logs, 0.0)
        end = max(begin + log.duration_s for begin, log in zip(begins, logs, strict=True))
        later = _stamps_s(both)[len(logs) :] if _by_stamps(both) else _in_turn_s(both[len(logs) :], end)
        return cls(tuple(both), tuple(begin - min(begins) for begin in [*begins, *later]))

    def ahead_s(self, run: Run) -> float:
        """Offset [s] to add to t_s of `run`, a log or a part of one. ValueError where it is part of no log."""
        for log, begin_s in zip(self.logs, self.begins_s, strict=True):
            if log is run.whole:
                return begin_s - _first_s(log)
        raise ValueError(f"{run.meta.source}: part of no log of this clock")

    def start_s(self, run: Run) -> float:
        """Time of the first row of `run`, a log or a part of one [s]."""
        return _first_s(run) + self.ahead_s(run)


def _by_stamps(logs: Sequence[Run]) -> bool:
    """Whether the stamps order the logs: one clock, and measurements of no two logs overlap.

    Stamps since two boots may overlap, and logs without stamps always do. Measurements are compared, not rows, since a
    part also holds the commands from before it.
    """
    measured = zip(_zeros_s(logs), (log.measured_s() for log in logs), strict=True)
    spans = sorted((zero_s + t_s[0], zero_s + t_s[-1]) for zero_s, t_s in measured)
    return len({log.meta.clock for log in logs}) == 1 and all(a[1] <= b[0] for a, b in pairwise(spans))


def _zeros_s(logs: Sequence[Run]) -> list[float]:
    """Stamp of t_s = 0 of each log relative to the first log [s]."""
    return [(log.meta.zero_ns - logs[0].meta.zero_ns) * 1e-9 for log in logs]


def _stamps_s(logs: Sequence[Run]) -> list[float]:
    """Stamp of the first row of each log relative to t_s = 0 of the first log [s]."""
    return [zero_s + _first_s(log) for zero_s, log in zip(_zeros_s(logs), logs, strict=True)]


def _in_turn_s(logs: Sequence[Run], begin_s: float) -> list[float]:
    """Start of each log where they follow one another from `begin_s` on [s]."""
    return [begin_s + sum(log.duration_s for log in logs[:i]) for i in range(len(logs))]


def _first_s(run: Run) -> float:
    return float(run.table["t_s"][0])
