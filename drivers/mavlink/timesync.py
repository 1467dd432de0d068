"""Offset between the autopilot's clock and the companion's, from TIMESYNC round trips.

We ask at ts1 (our clock), the autopilot answers with tc1 (its clock), the answer arrives at t_rx (our clock):

    round_trip = t_rx - ts1        offset = ts1 + round_trip / 2 - tc1        t_companion = t_device + offset

The true offset lies within round_trip / 2 of each sample, so the samples with the shortest round trips are
the best ones: the offset is the median of the `BEST` shortest among the last `WINDOW`, without those that
took much longer than the shortest. No slope is fitted: at 4 Hz the window is 10 s long, in which crystals of
50 ppm (assumed) drift by 0.5 ms. All times in integer ns. Source:
https://mavlink.io/en/services/timesync.html; the least-delay filter is that of NTP (RFC 5905, section 10).
"""

from __future__ import annotations

from collections import deque
from statistics import median_low
from typing import NamedTuple

WINDOW = 40
BEST = 5
ALIKE_NS = 1_000_000
"""The best samples count where they took at most 1.5 times the shortest round trip and this (assumed)."""
MAX_ROUND_TRIP_NS = 250_000_000
"""Answers slower than this say too little (assumed)."""
MARGIN_NS = 5_000_000
"""What drift may add to the bound of half the round trips before a sample is called an outlier (assumed)."""
ODD_LIMIT = 3
"""So many outliers in a row are no outliers: the clock was stepped (assumed)."""
REBOOT_NS = 1_000_000_000
"""A device clock that goes back by more than this was started anew (assumed; UDP may reorder within it)."""
TWIN_REBOOTS, TWIN_NS = 3, 5_000_000_000
"""So many reboots within so long are none, for an autopilot takes seconds to start: two take turns (assumed)."""
MAX_AGE_NS = 500_000_000
"""A stamp older than this is not believed and gives way to the time of arrival (assumed)."""
SENSED_AGE_NS = 10_000_000_000
"""The same of a sensor: what a link that stood still held back is of the instant at which it was measured, however late
it comes. Assumed: TCP gives up before (`drivers.ports.tcp`)."""
_OUTSTANDING = 24
"""Questions: at 4 Hz those of six seconds, by which answers to us are known from answers to others."""


class _Sample(NamedTuple):
    round_trip_ns: int
    offset_ns: int


class ClockOffset:
    """Filter over TIMESYNC samples; converts stamps of the device into companion time.

    `offset_ns`: None before the first answer. `reboots`: how often the device clock went back; `twins`: so often that
    two devices are heard as one.
    `rejected`: answers that were not asked for, too slow, or outliers.
    """

    def __init__(self) -> None:
        self.offset_ns: int | None = None
        self.reboots = 0
        self.twins = False
        self.rejected = 0
        self._samples: deque[_Sample] = deque(maxlen=WINDOW)
        self._odd: list[_Sample] = []
        self._asked: deque[int] = deque(maxlen=_OUTSTANDING)
        self._last: dict[str, int] = {}
        self._reboots_ns: deque[int] = deque(maxlen=TWIN_REBOOTS)

    def question(self, t_ns: int) -> int:
        """Value of ts1 for a question sent at `t_ns`; its answer will be known by it."""
        self._asked.append(t_ns)
        return t_ns

    def is_ours(self, ts1_ns: int) -> bool:
        """Whether this is the answer to a question of ours that has had none."""
        return ts1_ns in self._asked

    def answer(self, tc1_ns: int, ts1_ns: int, t_rx_ns: int) -> bool:
        """Take the answer that arrived at `t_rx_ns`; False where it was rejected."""
        round_trip_ns = t_rx_ns - ts1_ns
        asked = ts1_ns in self._asked
        if asked:
            self._asked.remove(ts1_ns)
        if not asked or not 0 <= round_trip_ns <= MAX_ROUND_TRIP_NS:
            self.rejected += 1
            return False
        self._notice_reboot("TIMESYNC", tc1_ns, t_rx_ns, None)
        sample = _Sample(round_trip_ns, ts1_ns + round_trip_ns // 2 - tc1_ns)
        if not self._plausible(sample):
            self.rejected += 1
            self._odd.append(sample)
            if len(self._odd) < ODD_LIMIT:
                return False
            self._samples.clear()
            self._samples.extend(self._odd)
        else:
            self._samples.append(sample)
        self._odd.clear()
        self.offset_ns = self._estimate()
        return True

    def to_companion(
        self, stream: str | None, device_ns: int, t_rx_ns: int, wrap_ns: int | None = None, max_age_ns: int = MAX_AGE_NS
    ) -> int:
        """Companion time [ns] of a device stamp that arrived at `t_rx_ns`; the latter before the first
        answer.

        `stream`: name of the counter, to see it go back (None: it may be of another clock); `wrap_ns`: where it starts
        again from 0 (None: never). The result is never later than `t_rx_ns`, nor older by more than `max_age_ns` (then
        the stamp is not believed).
        """
        if stream is not None:
            self._notice_reboot(stream, device_ns, t_rx_ns, wrap_ns)
        if self.offset_ns is None:
            return t_rx_ns
        age_ns = t_rx_ns - self.offset_ns - device_ns
        if wrap_ns is not None:
            age_ns = (age_ns + wrap_ns // 2) % wrap_ns - wrap_ns // 2
        return t_rx_ns - age_ns if 0 <= age_ns <= max_age_ns else t_rx_ns

    def _estimate(self) -> int:
        best = sorted(self._samples)[:BEST]
        limit_ns = best[0].round_trip_ns * 3 // 2 + ALIKE_NS
        return median_low(s.offset_ns for s in best if s.round_trip_ns <= limit_ns)

    def _plausible(self, sample: _Sample) -> bool:
        """Does the interval that holds the offset, by this sample, meet that of the best sample?"""
        if not self._samples:
            return True
        best = min(self._samples)
        bound_ns = (sample.round_trip_ns + best.round_trip_ns) // 2 + MARGIN_NS
        return abs(sample.offset_ns - best.offset_ns) <= bound_ns

    def _notice_reboot(self, stream: str, device_ns: int, t_rx_ns: int, wrap_ns: int | None) -> None:
        back_ns = self._last.get(stream, device_ns) - device_ns
        if back_ns > REBOOT_NS and (wrap_ns is None or back_ns < wrap_ns // 2):
            self.reboots += 1
            self._reboots_ns.append(t_rx_ns)
            self.twins = self.twins or (self.reboots >= TWIN_REBOOTS and t_rx_ns - self._reboots_ns[0] <= TWIN_NS)
            self.offset_ns = None
            self._samples.clear()
            self._odd.clear()
            self._asked.clear()
            self._last.clear()
        self._last[stream] = device_ns
