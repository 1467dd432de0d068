"""This process's own appetite: processor share and resident memory."""

from __future__ import annotations

import psutil

MEGABYTE = 1e6


class ProcessMeter:
    """Share of one core since the last reading [%], and resident memory now [MB]."""

    def __init__(self) -> None:
        self._process = psutil.Process()
        self._read_ns: int | None = None
        self._busy_s = self._busy()

    def read(self, t_ns: int) -> tuple[float, float]:
        """(cpu_percent, rss_mb); the first reading has no share yet: 0."""
        busy_s, elapsed_s = self._busy(), 0.0 if self._read_ns is None else (t_ns - self._read_ns) * 1e-9
        share = 100.0 * (busy_s - self._busy_s) / elapsed_s if elapsed_s > 0 else 0.0
        self._read_ns, self._busy_s = t_ns, busy_s
        return share, self._process.memory_info().rss / MEGABYTE

    def _busy(self) -> float:
        times = self._process.cpu_times()
        return times.user + times.system
