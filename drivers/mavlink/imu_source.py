"""One inertial stream out of the several that an autopilot may send.

The estimator must see one sensor, not a mixture. The most preferred source that is alive is passed on; a
less preferred one takes over once the current one has been silent for `SILENCE_NS`.
"""

from __future__ import annotations

from collections.abc import Sequence

IMU_PREFERENCE = ("RAW_IMU", "HIGHRES_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
"""RAW_IMU first: it has microsecond stamps and exists on ArduPilot 4.6, which denies HIGHRES_IMU."""
SILENCE_NS = 1_000_000_000
"""50 samples at the wanted rate (assumed)."""


class ImuSelector:
    """`current`: source passed on at present. `preference`: message types, best first; no others pass."""

    def __init__(self, preference: Sequence[str] = IMU_PREFERENCE) -> None:
        self.current: str | None = None
        self._rank = {name: i for i, name in enumerate(preference)}
        self._last_ns = 0

    def passes(self, source: str, t_rx_ns: int) -> bool:
        """Is the sample of `source` that arrived at `t_rx_ns` to be used?"""
        rank = self._rank.get(source)
        if rank is None:
            return False
        if self.current is not None and self.current != source:
            alive = t_rx_ns - self._last_ns <= SILENCE_NS
            if alive and rank > self._rank[self.current]:
                return False
        self.current, self._last_ns = source, t_rx_ns
        return True
