"""This process's own appetite: processor share and resident memory."""

from __future__ import annotations

import psutil

from companion.core.messages import ProcessStats

MEGABYTE = 1e6
PERIOD_NS = 1_000_000_000


class ProcessMeter:
    """A ProcessStats a second: share of one core since the last one [%], and resident memory [MB]."""

    def __init__(self, t_ns: int) -> None:
        self._process = psutil.Process()
        self._due_ns = t_ns + PERIOD_NS
        self._read_ns: int | None = None
        self._busy_s = self._busy()

    def step(self, t_ns: int) -> ProcessStats | None:
        """The next one, where it is due at `t_ns` [ns]; the first has no share yet: 0."""
        if t_ns < self._due_ns:
            return None
        busy_s, elapsed_s = self._busy(), 0.0 if self._read_ns is None else (t_ns - self._read_ns) * 1e-9
        share = 100.0 * (busy_s - self._busy_s) / elapsed_s if elapsed_s > 0 else 0.0
        self._due_ns, self._read_ns, self._busy_s = t_ns + PERIOD_NS, t_ns, busy_s
        return ProcessStats(t_ns=t_ns, cpu_percent=share, rss_mb=self._process.memory_info().rss / MEGABYTE)

    def _busy(self) -> float:
        times = self._process.cpu_times()
        return times.user + times.system
